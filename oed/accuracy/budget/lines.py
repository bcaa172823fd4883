"""The budget's lines: each source's share, and the accuracy without it or with half.

The lines add up to the predicted variance. They are what each source costs when those
before it are gone; the accuracy without one source alone is computed on its own.

The slopes of readings and poses change with the machine. The mean variance over drawn
machines less that about the nominal one is what linearisation leaves out.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

import numpy as np

from oed.accuracy.budget.model import (
    EFFECTS,
    SETUP,
    BudgetModel,
    Kind,
    Part,
    budget_model,
)
from oed.accuracy.maps import ErrorMaps, Reference, maps_by_reference
from oed.base import Array
from oed.measurement import Measurement, Series, draw_parameters
from oed.mechanism import NO_TOOL, AssemblyError

#: factor on the standard deviation of an error that is gone: its covariance stays
#: regular
GONE = 1e-4
#: share of the variance below which a line is rounding
ROUNDING = 1e-10
#: name of what a linear calculation leaves out
LINEARISATION = "linearisation"
#: name of what is not known of the noise
NOISE_LAW = "estimated noise"

LineKind = Kind | Literal["linearisation"]
#: machines drawn
MACHINES = 48


@dataclasses.dataclass(frozen=True, eq=False)
class Line:
    """A source of the errors that remain, for k pose components, SI.

    source    its name
    kind      what sort of source it is
    variance  (k,) mean over the workspace; below 0 where the linear calculation
              predicts too much
    without   (k,) rms error of the whole without it; None where nobody can remove it
    halved    (k,) rms error of the whole with half its standard deviation, or None
    """

    source: str
    kind: LineKind
    variance: Array
    without: Array | None = None
    halved: Array | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Budget:
    """Sources of the errors of the compensated machine.

    names     (k,) of the pose components
    variance  (k,) predicted, SI, mean over the workspace; the lines add up to it
    lines     of what the prediction contains
    """

    names: tuple[str, ...]
    variance: Array
    lines: tuple[Line, ...]


def mean_products(maps: Array) -> Array:
    """Products (k, p, p) of the rows of maps (n, k, p), their mean over n poses."""
    by_component = maps.transpose(1, 2, 0)
    return by_component @ by_component.transpose(0, 2, 1) / len(maps)


def mean_variance(products: Array, covariance: Array) -> Array:
    """Mean variances (k,) of maps @ N(0, covariance) by the maps' `mean_products`."""
    return np.asarray((products * covariance).sum(axis=(1, 2)))


def budget_of(
    model: BudgetModel,
    maps: ErrorMaps,
    *,
    estimated: Array | None = None,
    predicted: Array | None = None,
) -> Budget:
    """The budget of errors `maps.raw` (n, k, p) @ delta.

    estimated  covariance (p, p), SI, of the estimate, where the noise was integrated
               over; that of the model by default
    predicted  (k,) variance that is predicted with what is not linear, mean over the
               workspace, SI
    """
    products = mean_products(maps.raw)
    lines = [_line(model, products, part) for part in model.parts()]
    variance = mean_variance(products, model.covariance())
    if estimated is not None:
        of_estimate = mean_variance(products, estimated)
        lines.append(Line(NOISE_LAW, "noise law", of_estimate - variance))
        variance = of_estimate
    if predicted is not None:
        lines.append(Line(LINEARISATION, "linearisation", predicted - variance))
        variance = predicted
    return Budget(maps.names, variance, _with_remainder(lines, variance))


def _with_remainder(lines: Sequence[Line], variance: Array) -> tuple[Line, ...]:
    """The lines with `without` and `halved` of the whole.

    They were computed for the linear model; what it leaves out stays as it is.
    """
    linear = np.sum([li.variance for li in lines if li.without is not None], axis=0)
    beyond = variance - linear

    def whole(rms: Array | None) -> Array | None:
        if rms is None:
            return None
        return np.asarray(np.sqrt(np.maximum(rms**2 + beyond, 0.0)))

    def plain(part: Array) -> Array:
        return np.where(np.abs(part) > ROUNDING * variance, part, 0.0)

    return tuple(
        dataclasses.replace(
            li,
            variance=plain(li.variance),
            without=whole(li.without),
            halved=whole(li.halved),
        )
        for li in lines
    )


def _line(model: BudgetModel, products: Array, part: Part) -> Line:
    """A line with the rms errors of the linear model without it and with half."""
    variance = mean_variance(products, part.covariance)

    def rms(covariance: Array) -> Array:
        # the difference of two large covariances may be negative by its rounding
        return np.sqrt(np.maximum(mean_variance(products, covariance), 0.0))

    changed = _alternatives(model, part)
    without, halved = (None if change is None else rms(change()) for change in changed)
    return Line(part.source, part.kind, variance, without, halved)


def _alternatives(
    model: BudgetModel, part: Part
) -> tuple[Callable[[], Array], Callable[[], Array] | None]:
    """Covariances without a source, and with half its standard deviation."""
    source = part.source
    if part.kind in ("instrument", "run", "course", "noise law"):
        return (
            lambda: model.covariance({source: GONE}),
            lambda: model.covariance({source: 0.5}),
        )
    known = {SETUP: model.setup, EFFECTS: model.effect}
    if source in known:
        return lambda: model.covariance(known=known[source]), None
    whole = model.covariance()
    return lambda: whole - part.covariance, lambda: model.covariance(prior=0.5)


def shares(budget: Budget) -> Mapping[str, dict[str, float]]:
    """Share of the variance by component and source."""
    table: dict[str, dict[str, float]] = {}
    for k, name in enumerate(budget.names):
        total = budget.variance[k]
        table[name] = {
            line.source: float(line.variance[k] / total) if total > 0.0 else 0.0
            for line in budget.lines
        }
    return table


# -- what linearisation leaves out -----------------------------------------------------


def variance_over_machines(
    measurement: Measurement,
    series: Sequence[Series],
    command: Array,
    references: Sequence[Reference],
    rng: np.random.Generator,
    tool: Array = NO_TOOL,
) -> dict[Reference, Array]:
    """Variances (n, k), SI, at commands (n, n_dof) of what calibration leaves.

    They are means over machines drawn from the tolerances, by reference; none where
    hardly one of them can be assembled.
    """
    count = len(measurement.machine.parameters)
    sums: dict[Reference, Array] = {}
    assembled = 0
    for truth in draw_parameters(measurement, rng, MACHINES):
        try:
            covariance = budget_model(measurement, series, truth).covariance()
            by_reference = maps_by_reference(
                measurement.kinematics,
                command,
                references,
                tool,
                parameters=truth[:count],
            )
        except AssemblyError:
            continue
        assembled += 1
        for reference, maps in by_reference.items():
            carried = maps.raw @ covariance
            variance = np.einsum("nkp,nkp->nk", carried, maps.raw)
            sums[reference] = sums.get(reference, 0.0) + variance
    if assembled < MACHINES // 2:
        return {}
    return {reference: total / assembled for reference, total in sums.items()}
