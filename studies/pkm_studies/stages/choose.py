"""The design: choose readings from the candidates, score given plans beside them, map the condition number."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from oed import criteria, explain, information
from oed.design import exchange
from oed.instrument import Setup
from oed.measurement import Index, Measurement, Series
from pkm_studies import grids, quantities, result
from pkm_studies.errors import Place
from pkm_studies.grids import Circles
from pkm_studies.resolve import Resolved
from pkm_studies.stages import describe

Scaling = Literal["length", "tolerance"]


@dataclasses.dataclass(frozen=True)
class Chosen:
    """The chosen readings, in working order, and how they were found."""

    series: tuple[Series, ...]
    choice: exchange.Choice
    candidates: int


def choose(resolved: Resolved, rng: np.random.Generator) -> Chosen | None:
    """The best plan found, or None where the study asks for none. Raises InputError for what exchange cannot do."""
    design = resolved.study.design
    if design is None or not resolved.candidates:
        return None
    place = resolved.study.place.key("design")
    if design.criterion not in ("D", "E"):
        raise place.key("criterion").error("exchange designs know D and E", 'write "D" or "E"', design.criterion)
    measurement, candidates = resolved.measurement, resolved.candidates
    instruments = [measurement.setups[s.setup].instrument for s in candidates]
    if any(c.shared for i in instruments for c in i.channels):
        problem = "exchange takes readings with noise of their own, not told against a run's reference"
        raise place.key("candidates").error(problem, "give the plan as [[design.reference]]")
    channels = {len(i.channels) for i in instruments}
    if len(channels) > 1:
        problem = f"the candidates' instruments have {' and '.join(map(str, sorted(channels)))} channels"
        raise place.key("candidates").error(problem, "take candidates with equally many")
    free = measurement.free
    rows = information.scaled(measurement, candidates, measurement.nominal, design.scaling)[:, free]
    rows = rows.reshape(-1, channels.pop(), rows.shape[1])  # one block a reading
    prior = np.eye(rows.shape[2]) if design.prior else None
    if prior is not None and design.scaling != "tolerance":
        raise place.key("prior").error("tolerances enter in their own unit", 'write scaling = "tolerance" beside it')
    try:
        choice = exchange.choose(rows, design.readings, rng, _known(design.criterion), prior, design.starts)
    except ValueError as error:
        raise place.key("readings").error(str(error), "ask for more readings, or give more candidates") from error
    return Chosen(_split(measurement, candidates, choice.indices), choice, len(rows))


def _known(criterion: str) -> Literal["D", "E"]:
    return "E" if criterion == "E" else "D"


def _split(measurement: Measurement, candidates: Sequence[Series], indices: Index) -> tuple[Series, ...]:
    """The chosen readings of each candidate series, one level after the other so that little is travelled."""
    chosen, start = [], 0
    for s in candidates:
        mine = indices[(indices >= start) & (indices < start + len(s))] - start
        start += len(s)
        if not mine.size:
            continue
        command = s.commands()[mine]
        order = np.lexsort(command.T[::-1]) if s.index.shape[1] == 1 or _one_run(s) else np.arange(len(mine))
        taken = s.take(mine[order])
        if _one_run(s):
            first = measurement.machine.command[0].name
            labels = grids.labels(taken.commands(), first, measurement.machine.command, Place(""))
            taken = dataclasses.replace(taken, run=np.array(labels, dtype=np.str_))
        chosen.append(taken)
    return tuple(chosen)


def _one_run(series: Series) -> bool:
    return len(set(series.run)) == 1


def section(resolved: Resolved, chosen: Chosen, seen: explain.Seen) -> result.Design:
    """The design with the given plans scored beside it."""
    design = resolved.study.design
    assert design is not None
    choice = chosen.choice
    plans = [_score("chosen", seen, choice.criterion)]
    for plan in resolved.references:
        if set(plan.setups) <= set(resolved.measurement.setups):
            other = explain.look(resolved.measurement, plan.series, design.scaling)
            if other.verdict.rank == seen.verdict.rank:
                plans.append(_score(plan.name, other, choice.criterion))
    plans = _against_first(plans, seen.verdict.rank)
    return result.Design(
        criterion=choice.criterion,
        n=plans[0].n,
        value=choice.value,
        bound=choice.bound,
        efficiency=choice.efficiency,
        kappa=plans[0].kappa,
        observability=plans[0].observability,
        poses=poses(resolved.measurement, chosen.series),
        scaling=design.scaling,
        candidates=chosen.candidates,
        plans=plans,
    )


def _score(name: str, seen: explain.Seen, criterion: str) -> result.PlanScore:
    s = seen.verdict.identifiable
    n = sum(len(x) for x in seen.series)
    logdet = 2.0 * float(np.log(s).sum())
    return result.PlanScore(
        name=name,
        n=n,
        criterion=criterion,
        value=logdet if criterion == "D" else float(s[-1] ** 2),
        logdet=logdet,
        efficiency=1.0,
        kappa=criteria.kappa(s),
        observability=criteria.observability(s, n),
    )


def _against_first(plans: list[result.PlanScore], directions: int) -> list[result.PlanScore]:
    """D-efficiency per reading of each plan against the first."""
    best = plans[0]
    return [
        result.PlanScore(
            name=p.name,
            n=p.n,
            criterion=p.criterion,
            value=p.value,
            logdet=p.logdet,
            efficiency=float(np.exp((p.logdet - best.logdet) / directions) * best.n / p.n),
            kappa=p.kappa,
            observability=p.observability,
        )
        for p in plans
    ]


def poses(measurement: Measurement, series: Sequence[Series]) -> list[result.Pose]:
    """The readings as poses to command, in working order."""
    table = []
    nominal = measurement.nominal
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        y = measurement.readings([s], nominal).reshape(len(s), len(channels))
        seen: dict[str, int] = {}
        for k, run in enumerate(s.run):
            seen[run] = seen.get(run, 0) + 1
            read = {
                quantities.column(c.name, c.unit): describe.shown(float(v), c.unit)
                for c, v in zip(channels, y[k], strict=True)
            }
            table.append(
                result.Pose(s.setup, str(run), seen[run], describe.command(measurement.machine, s.commands()[k]), read)
            )
    return table


def kappa_map(circles: Circles, scaling: Scaling) -> result.KappaMap:
    """Condition number over circles and points on each."""
    table = []
    for m in circles.circles:
        row = []
        for n in circles.points:
            seen = explain.look(circles.measurement, [circles.series(m, n)], scaling)
            row.append(criteria.kappa(seen.verdict.identifiable))
        table.append(row)
    return result.KappaMap(circles.title, list(circles.circles), list(circles.points), table)


def _seconds(setup: Setup) -> float:
    """Time of one planned reading with all passes that are averaged into it."""
    passes = len(setup.protocol.passes) if setup.protocol.average else 1
    return setup.instrument.cost.reading * passes


def plan(resolved: Resolved, seen: explain.Seen, predicted: Mapping[str, float]) -> result.Plan:
    """The readings as one stage, with its cost in minutes."""
    measurement = seen.measurement
    setups = list(dict.fromkeys(s.setup for s in seen.series))
    cost = sum(measurement.setups[n].instrument.cost.setup for n in setups)
    cost += sum(_seconds(measurement.setups[s.setup]) * len(s) for s in seen.series)
    stage = result.Stage(
        measurement=", ".join(dict.fromkeys(measurement.setups[n].instrument.name for n in setups)),
        setups=setups,
        readings=sum(len(s) for s in seen.series),
        identifies=seen.verdict.rank,
        cost=cost / 60.0,
        kappa=criteria.kappa(seen.verdict.identifiable),
        predicted=dict(predicted),
    )
    return result.Plan([stage], stage.cost, [p.name for p in resolved.references])
