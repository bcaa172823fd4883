"""Predicts accuracy against the number of readings, and the fewest that suffice."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.design import Choice, DesignProblem, SizeCurve
from oed.result import HowManySummary
from pkm_studies import quantities
from pkm_studies.base import Location, Stream
from pkm_studies.stages.design.criteria import StudyCriteria
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
    components = {x.name: x.unit for x in c.measurement.machine.components}
    wanted = quantities.read_values(table.wanted, components, location.key("wanted"))
    scale = wanted or _reached_accuracy(study_criteria, problem, chosen)
    names, factors = _factors(study_criteria, problem, scale)
    seed_key = Stream.HOW_MANY.key(seed)
    size_curve = problem.size_curve(chosen, names, factors, seed_key)
    count = len(size_curve.blocks)
    points = size_curve.curve([n for n in table.readings if n <= count])
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
    return _fewest_sentences(summary, size_curve, min(table.most, count))


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
    accuracy = problem.accuracy(factors, chosen)
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
