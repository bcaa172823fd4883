"""How large an effect must be to be seen, and how far its forms depart from the
textbook: a table for people.

For each effect and machine, medians over drawn forms on one "full" plan with white
noise:

    um        largest addition at a joint, a place or a reading that gives sqrt(lambda)
              = 10
    own       share of sqrt(lambda) that the effect's own textbook form leaves
    nearest   share that the best textbook form of any known effect leaves, and most
              often whose
"""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np

from benchmarks.blind.generator import effects, noise, plans, scene, severity, textbook
from benchmarks.blind.generator.effects import Stage
from benchmarks.blind.generator.effects.thermal import climate
from benchmarks.blind.generator.machines import Array


@dataclasses.dataclass(frozen=True)
class Row:
    """A line of the table; see the module."""

    effect: str
    machine: str
    um: float
    own: float
    nearest: float
    name: str


def rows(machine: str, draws: int, seed: int) -> list[Row]:
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
            change = base.response(
                form(np.random.default_rng([seed, k]), stage).push(1e-6)
            )
            size = metric.size(change)
            if size > 1e-3:  # some forms leave no trace on some plans
                drawn.append((name, size, change / size))
    left = textbook.left(base, stage, metric, known, [change for _, _, change in drawn])
    found = []
    for name in dict.fromkeys(n for n, _, _ in drawn):
        mine = [
            (size, rest)
            for (n, size, _), rest in zip(drawn, left, strict=True)
            if n == name
        ]
        best = [min(rest, key=rest.__getitem__) for _, rest in mine]
        found.append(
            Row(
                effect=name,
                machine=machine,
                um=float(np.median([10.0 / size for size, _ in mine])),
                own=float(np.median([rest.get(name, 1.0) for _, rest in mine])),
                nearest=float(
                    np.median(
                        [rest[b] for (_, rest), b in zip(mine, best, strict=True)]
                    )
                ),
                name=Counter(best).most_common(1)[0][0],
            )
        )
    return found


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
            r = table[m].get(name)
            cells.append(
                "-"
                if r is None
                else f"{r.um:.3g} um, {r.own:.2f}, {r.nearest:.2f} {r.name}"
            )
        lines.append(f"| {name} | {' | '.join(cells)} |")
    return "\n".join(lines)
