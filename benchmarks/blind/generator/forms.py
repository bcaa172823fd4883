"""Table of how large effects must be to be visible, and how far from the textbook.

For each effect and machine, medians over drawn forms on one "full" plan with white
noise:

    um          largest addition at a joint, a place or a reading that gives
                sqrt(lambda) = 10
    textbook    share of sqrt(lambda) that the effect's textbook form cannot absorb
    nearest     share that the best textbook form of any known effect cannot absorb, and
                most often whose
"""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np

from benchmarks.blind.generator import effects, noise, plans, scene, severity, textbook
from benchmarks.blind.generator.effects import Stage
from benchmarks.blind.generator.effects.thermal import climate
from benchmarks.blind.generator.machine import Array


@dataclasses.dataclass(frozen=True)
class FormRow:
    """A line of the table; see the module."""

    effect: str
    machine: str
    um: float
    textbook: float
    nearest: float
    name: str


def rows(machine: str, draws: int, seed: int) -> list[FormRow]:
    """The table of one machine."""
    rng = np.random.default_rng([seed, 77])
    plan = plans.draw(rng, machine, "full")
    base = scene.draw(rng, plan)
    stage = Stage(plan, base.motion, base.layout, climate(rng, plan))
    sigma = noise.covariance(noise.Law(name="white"), noise.grouping(plan, base.layout))
    metric = severity.Metric(sigma, base.J, base.prior)
    known = effects.known_on(machine)
    drawn: list[tuple[str, float, Array]] = []
    for name in known + effects.unknown_on(machine):
        form = effects.KNOWN[name] if name in known else effects.UNKNOWN[name]
        for k in range(draws):
            effect = form(np.random.default_rng([seed, k]), stage)
            change = base.response(effect.push(1e-6))
            size = metric.size(change)
            if size > 1e-3:  # some forms leave no trace on some plans
                drawn.append((name, size, change / size))
    changes = [change for _, _, change in drawn]
    distances = textbook.distances(base, stage, metric, known, changes)
    table = []
    for name in dict.fromkeys(n for n, _, _ in drawn):
        numbers = [k for k, (n, _, _) in enumerate(drawn) if n == name]
        by_draw = [distances[k] for k in numbers]
        best = [min(by_form, key=by_form.__getitem__) for by_form in by_draw]
        least = [min(by_form.values()) for by_form in by_draw]
        row = FormRow(
            effect=name,
            machine=machine,
            um=float(np.median([10.0 / drawn[k][1] for k in numbers])),
            textbook=float(np.median([d.get(name, 1.0) for d in by_draw])),
            nearest=float(np.median(least)),
            name=Counter(best).most_common(1)[0][0],
        )
        table.append(row)
    return table


def markdown(machines: tuple[str, ...], draws: int, seed: int) -> str:
    """The table: a line an effect, a column a machine."""
    table = {m: {r.effect: r for r in rows(m, draws, seed)} for m in machines}
    lines = [
        f"| effect | {' | '.join(machines)} |",
        f"| --- {'| --- ' * len(machines)}|",
    ]
    for name in (*effects.KNOWN, *effects.UNKNOWN):
        cells = []
        for m in machines:
            cells.append(_cell(table[m].get(name)))
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)


def _cell(row: FormRow | None) -> str:
    if row is None:
        return "-"
    figures = f"{row.um:.3g} um, {row.textbook:.2f}, {row.nearest:.2f}"
    return f"{figures} {row.name}"
