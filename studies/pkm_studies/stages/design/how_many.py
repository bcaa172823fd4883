"""How many readings: predicted accuracy against their number with its bound, and the
fewest for a wanted accuracy.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed import result, units
from oed.arrays import Array
from oed.design.blocks import information
from oed.design.exchange import Choice
from oed.design.how_many import AccuracyGoal, SizeCurve
from pkm_studies.errors import Place
from pkm_studies.resolve import quantities
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.design.search import DesignProblem
from pkm_studies.study.tables import HowManyTable


def curve(
    problem: DesignProblem,
    aims: StudyCriteria,
    chosen: Choice,
    said: HowManyTable,
    seed: int,
    place: Place,
) -> result.HowManySummary:
    """The curve over the candidates (over the chosen set-ups', where not all can be
    mounted).

    Raises InputError for a component that the machine does not have.
    """
    c = problem.candidates
    pool, basis = np.arange(len(c)), np.eye(c.blocks.shape[2])
    if problem.limited:
        pool = np.flatnonzero(np.isin(c.setup, c.setup[chosen.indices]))
        basis = problem.columns(np.unique(c.setup[chosen.indices]))
    components = {x.name: x.unit for x in c.measurement.machine.components}
    wanted = quantities.read_values(said.wanted, components, place.key("wanted"))
    unit = wanted or _reached(aims, problem, chosen)
    names, factors = _factors(aims, problem, unit)
    rules = dataclasses.replace(
        problem.rules.subset(pool),
        most_setups=None,
        budget=None,
        cost=None,
        setup_cost=None,
    )
    asked = SizeCurve(
        c.blocks[pool] @ basis,
        basis.T @ c.prior_information @ basis,
        AccuracyGoal(names, factors @ basis),
        (seed,),
        rules=rules,
    )
    points = asked.curve([n for n in said.readings if n <= len(pool)])
    fine = {n: units.FINE[components[n]] for n in names}

    def column(table: Array, k: int) -> list[float]:
        return [
            float(units.number(float(v) * unit[names[k]], fine[names[k]]))
            for v in table[:, k]
        ]

    reached, bounds = (
        np.array([p.accuracy for p in points]),
        np.array([p.bound for p in points]),
    )
    keys = [f"{n}_{fine[n]}" for n in names]
    told = result.HowManySummary(
        wanted={f"{n}_{fine[n]}": units.number(v, fine[n]) for n, v in wanted.items()},
        sizes=[p.size for p in points],
        accuracy={key: column(reached, k) for k, key in enumerate(keys)},
        bound={key: column(bounds, k) for k, key in enumerate(keys)},
    )
    return _fewest(told, asked, min(said.most, len(pool))) if wanted else told


def _fewest(
    told: result.HowManySummary, asked: SizeCurve, most: int
) -> result.HowManySummary:
    found = asked.fewest(most)
    if found.size is None:
        short = [
            n
            for n, a in zip(asked.goal.names, found.best.accuracy, strict=True)
            if a > 1.0
        ]
        never = (
            "no plan of so many can: the bound says so"
            if found.at_least > most
            else "none was found"
        )
        words = (
            f"{most} readings do not reach it in {', '.join(short)}; {never}. Add a"
            " set-up or another instrument."
        )
    elif found.proven:
        words = f"{found.size} readings reach it, and no plan of fewer can."
    else:
        words = (
            f"{found.size} readings reach it; no plan of fewer than {found.at_least}"
            " can."
        )
    return result.HowManySummary(
        told.wanted,
        told.sizes,
        told.accuracy,
        told.bound,
        found.size,
        found.at_least,
        most,
        words,
    )


def _reached(
    aims: StudyCriteria, problem: DesignProblem, chosen: Choice
) -> dict[str, float]:
    """Accuracy, SI, that the chosen plan reaches in each component that moves at all."""
    names, factors = _factors(aims, problem, {})
    c = problem.candidates
    told = AccuracyGoal(names, factors).accuracy(
        c.prior_information + information(c.blocks[chosen.indices])
    )
    return {n: float(v) for n, v in zip(names, told, strict=True)}


def _factors(
    aims: StudyCriteria, problem: DesignProblem, unit: dict[str, float]
) -> tuple[tuple[str, ...], Array]:
    """Components with factors (K, r, n) over the candidates' columns, in units of
    `unit` (SI where none is told).
    """
    maps, c = aims.maps, problem.candidates
    assert maps is not None
    measurement = c.measurement
    moved = [n for k, n in enumerate(maps.names) if maps.raw[:, k].any()]
    names = [n for n in moved if n in unit] if unit else moved
    tables = []
    for name in names:
        wide = np.zeros((len(maps.raw), len(measurement.names)))
        wide[:, : maps.raw.shape[2]] = maps.raw[:, maps.names.index(name)] / (
            unit.get(name, 1.0) * np.sqrt(len(maps.raw))
        )
        rows = (wide * measurement.tolerance)[:, measurement.free]
        triangle = np.linalg.qr(rows, mode="r") if len(rows) > rows.shape[1] else rows
        tables.append(np.pad(triangle, ((0, 0), (0, c.shared_errors))))
    return tuple(names), np.array(tables)
