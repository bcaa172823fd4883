"""Predicts accuracy against the number of readings, and the fewest that suffice."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import msgspec
import numpy as np

from oed import units
from oed.base import Array, Index
from oed.design.blocks import information
from oed.design.exchange import Choice
from oed.design.how_many import AccuracyGoal, SizeCurve
from oed.design.rules import Rules
from oed.result import HowManySummary
from pkm_studies import quantities
from pkm_studies.base import Location, Stream
from pkm_studies.stages.design.criteria import StudyCriteria
from pkm_studies.stages.design.search import DesignProblem
from pkm_studies.tables import HowManyTable


def accuracy_by_size(
    problem: DesignProblem,
    study_criteria: StudyCriteria,
    chosen: Choice,
    table: HowManyTable,
    seed: int,
    location: Location,
) -> HowManySummary:
    """The curve over the candidates, with bounds, and the fewest readings wanted.

    Where not all set-ups can be mounted, over those of the chosen plan. Raises
    InputError for a component that the machine does not have.
    """
    c = problem.candidates
    pool, basis = chosen_pool(problem, chosen)
    components = {x.name: x.unit for x in c.measurement.machine.components}
    wanted = quantities.read_values(table.wanted, components, location.key("wanted"))
    scale = wanted or _reached_accuracy(study_criteria, problem, chosen)
    names, factors = _factors(study_criteria, problem, scale)
    size_curve = SizeCurve(
        c.blocks[pool] @ basis,
        basis.T @ c.prior_information @ basis,
        AccuracyGoal(names, factors @ basis),
        tuple(Stream.HOW_MANY.key(seed)),
        rules=_free_of_cost(problem, pool),
    )
    points = size_curve.curve([n for n in table.readings if n <= len(pool)])
    fine = {n: units.FINE[components[n]] for n in names}
    reached = np.array([p.accuracy for p in points])
    bounds = np.array([p.bound for p in points])

    def by_component(shares: Array) -> dict[str, list[float]]:
        """Shares (sizes, components) of the scale, by component in its fine unit."""
        columns = {}
        for k, name in enumerate(names):
            si = [float(share) * scale[name] for share in shares[:, k]]
            columns[f"{name}_{fine[name]}"] = [units.number(v, fine[name]) for v in si]
        return columns

    summary = HowManySummary(
        wanted={f"{n}_{fine[n]}": units.number(v, fine[n]) for n, v in wanted.items()},
        sizes=[p.size for p in points],
        accuracy=by_component(reached),
        bound=by_component(bounds),
    )
    if not wanted:
        return summary
    return _fewest_sentences(summary, size_curve, min(table.most, len(pool)))


def chosen_pool(problem: DesignProblem, chosen: Choice) -> tuple[Index, Array]:
    """Candidates of the chosen plan's set-ups, and a basis (n, r) of their columns.

    All candidates and columns, where the search did not have to choose set-ups.
    """
    c = problem.candidates
    if not problem.selects_setups:
        return np.arange(len(c)), np.eye(c.blocks.shape[2])
    used = c.setup[chosen.indices]
    return np.flatnonzero(np.isin(c.setup, used)), problem.columns(np.unique(used))


def _free_of_cost(problem: DesignProblem, pool: Index) -> Rules:
    """The rules over a pool of candidates, without time and number of set-ups."""
    rules, setups = problem.rules.subset(pool), None
    if rules.setups is not None:
        setups = dataclasses.replace(rules.setups, seconds=None, most=None)
    return dataclasses.replace(rules, time=None, setups=setups)


def _fewest_sentences(
    summary: HowManySummary, size_curve: SizeCurve, most: int
) -> HowManySummary:
    """The summary with the fewest readings that reach the wanted accuracy."""
    fewest = size_curve.fewest(most)
    if fewest.size is None:
        pairs = zip(size_curve.goal.names, fewest.best.accuracy, strict=True)
        missed = ", ".join(name for name, share in pairs if share > 1.0)
        reason = "the search found no plan that does"
        if fewest.at_least > most:
            reason = "by the bound, no plan of that size can"
        phrase = (
            f"{most} readings do not reach it in {missed}; {reason}. Add a set-up or"
            " another instrument."
        )
    elif fewest.proven:
        phrase = f"{fewest.size} readings reach it, and no plan of fewer can."
    else:
        phrase = (
            f"{fewest.size} readings reach it; no plan of fewer than {fewest.at_least}"
            " can."
        )
    return msgspec.structs.replace(
        summary,
        fewest=fewest.size,
        at_least=fewest.at_least,
        most=most,
        words=phrase,
    )


def _reached_accuracy(
    study_criteria: StudyCriteria, problem: DesignProblem, chosen: Choice
) -> dict[str, float]:
    """Accuracy, SI, that the chosen plan reaches in each component that moves."""
    names, factors = _factors(study_criteria, problem, {})
    c = problem.candidates
    total = c.prior_information + information(c.blocks[chosen.indices])
    accuracy = AccuracyGoal(names, factors).accuracy(total)
    return {n: float(v) for n, v in zip(names, accuracy, strict=True)}


def _factors(
    study_criteria: StudyCriteria, problem: DesignProblem, scale: Mapping[str, float]
) -> tuple[tuple[str, ...], Array]:
    """Components, and factors (K, r, n) over the candidates' columns, by `scale`.

    Only components in the scale; with an empty one, all that move, in SI.
    """
    maps, c = study_criteria.needed_maps, problem.candidates
    measurement = c.measurement
    poses, _, machine_parameters = maps.raw.shape
    moving = [n for k, n in enumerate(maps.names) if maps.raw[:, k].any()]
    names = [n for n in moving if n in scale] if scale else moving
    factors = []
    for name in names:
        raw = maps.raw[:, maps.names.index(name)]
        slopes = np.zeros((poses, len(measurement.names)))
        slopes[:, :machine_parameters] = raw / (scale.get(name, 1.0) * np.sqrt(poses))
        rows = (slopes * measurement.tolerance)[:, measurement.free]
        triangle = np.linalg.qr(rows, mode="r") if len(rows) > rows.shape[1] else rows
        factors.append(np.pad(triangle, ((0, 0), (0, c.shared_errors))))
    return tuple(names), np.array(factors)
