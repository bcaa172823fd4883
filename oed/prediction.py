"""Residual accuracy over the workspace, before and after compensation.

With parameter errors dp = dp_hat + delta, where delta ~ N(0, Sigma) is what the
identification does not determine, the pose error of the compensated machine is, to
first order,

    e = R dp_hat + A delta        (R: `remaining`, A: `raw` of the error model).

Compensatable components keep only A delta. The others keep R dp_hat as well, which is
known: a further axis (an X-Y table) can correct it, and then A delta remains there too.
Before measuring, dp_hat is itself unknown, with covariance Lambda - Sigma (Lambda:
tolerances).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.error_maps import (
    ErrorMaps,
    Reference,
    error_maps,
    maps_by_reference,
    relative_to_reference,
)
from oed.linear_algebra import covariance_root

__all__ = [
    "ErrorMaps",
    "Prediction",
    "Reference",
    "Spread",
    "error_maps",
    "error_spread",
    "maps_by_reference",
    "predict",
    "relative_to_reference",
]

#: virtual machines drawn for the 95th percentile and the largest error
VIRTUAL_MACHINES = 400
#: ends of the interval that holds 95 % of the machines
INTERVAL = (0.025, 0.975)


#: lower and upper end
Interval = tuple[float, float]
UNKNOWN_INTERVAL: Interval = (np.nan, np.nan)


@dataclasses.dataclass(frozen=True, slots=True)
class Spread:
    """Error of one pose component, SI.

    rms               root mean square over workspace and machines
    p95               95th percentile of the error's size over workspace and machines
    largest           largest error over the workspace; 95 % of the machines stay below
    rms_interval      interval that holds the rms over the workspace of 95 % of the
                      machines
    p95_interval      the same of each machine's 95th percentile
    largest_interval  the same of each machine's largest error
    """

    rms: float
    p95: float
    largest: float
    rms_interval: Interval = UNKNOWN_INTERVAL
    p95_interval: Interval = UNKNOWN_INTERVAL
    largest_interval: Interval = UNKNOWN_INTERVAL


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Residual accuracy over n workspace poses, for k pose components.

    reference        against which errors are stated
    command          (n, n_dof), SI
    names            (k,) of the components
    before           {component: Spread} without compensation
    after            {component: Spread} after compensation
    fully_corrected  {component: Spread} once a further axis corrects all that is known
    sd_before        (n, k) root mean square error at each pose before, SI
    sd_after         (n, k) the same after
    """

    reference: Reference
    command: Array
    names: tuple[str, ...]
    before: dict[str, Spread]
    after: dict[str, Spread]
    fully_corrected: dict[str, Spread]
    sd_before: Array
    sd_after: Array


def predict(
    maps: ErrorMaps,
    prior: Array,
    posterior: Array,
    rng: np.random.Generator,
    *,
    mean: Array | None = None,
    known: Array | None = None,
    draws: Array | None = None,
    reference: Reference = "home",
    variance: Array | None = None,
) -> Prediction:
    """Predict the residual accuracy from prior and posterior covariances (np, np), SI.

    mean     (np,) identified errors p_hat - p_nominal; None before measuring
    known    (n, k) exact errors that the compensated machine has if p_hat is right; R
             dp_hat by default, which misses the squares of large errors
    draws    (m, np) draws of delta from the posterior of the parameters, SI, of which
             `posterior` is the second moment; normal draws by default
    variance (n, k) of the errors that delta causes, where it is known better than by
             the maps (`oed.budget.linearisation`); draws are scaled to it
    """
    measured = mean is not None
    centre = np.zeros(len(prior)) if mean is None else mean
    unknown_estimate = np.zeros_like(prior) if measured else prior - posterior
    delta = _draw(posterior, rng) if draws is None else _choose(draws, rng)
    estimate = centre + _draw(unknown_estimate, rng)
    undetermined = _apply(maps.raw, delta)
    rms_undetermined = _rms(maps.raw, posterior, np.zeros(len(prior)))
    if variance is not None:
        linear, rms_undetermined = rms_undetermined, np.sqrt(variance)
        scale = np.ones_like(linear)
        np.divide(rms_undetermined, linear, out=scale, where=linear > 0.0)
        undetermined = undetermined * scale
    remaining = _apply(maps.remaining, estimate) if known is None else known
    errors = {
        "before": _apply(maps.raw, estimate + delta),
        "after": remaining + undetermined,
        "fully_corrected": undetermined,
    }
    rms_known = (
        _rms(maps.remaining, unknown_estimate, centre)
        if known is None
        else np.abs(known)
    )
    rms = {
        "before": _rms(maps.raw, posterior if measured else prior, centre),
        "after": np.sqrt(rms_known**2 + rms_undetermined**2),
        "fully_corrected": rms_undetermined,
    }
    spreads = {key: _spreads(maps.names, errors[key], rms[key]) for key in errors}
    return Prediction(
        reference=reference,
        command=maps.command,
        names=maps.names,
        before=spreads["before"],
        after=spreads["after"],
        fully_corrected=spreads["fully_corrected"],
        sd_before=rms["before"],
        sd_after=rms["after"],
    )


def error_spread(errors: Array) -> Spread:
    """Spread of the errors (machines, n), SI, of one pose component."""
    size = np.abs(errors)
    largest = size.max(axis=1)
    return Spread(
        rms=float(np.sqrt(np.mean(errors**2))),
        p95=float(np.quantile(size, 0.95)),
        largest=float(np.quantile(largest, 0.95)),
        rms_interval=_interval(np.sqrt(np.mean(errors**2, axis=1))),
        p95_interval=_interval(np.quantile(size, 0.95, axis=1)),
        largest_interval=_interval(largest),
    )


def _interval(values: Array) -> Interval:
    """Interval that holds 95 % of the values (machines,)."""
    low, high = np.quantile(values, INTERVAL)
    return float(low), float(high)


def _spreads(names: Sequence[str], errors: Array, rms: Array) -> dict[str, Spread]:
    """Spread by component, from drawn errors (machines, n, k) and exact rms (n, k).

    Only the percentile and the largest error need the draws.
    """
    spreads = {}
    for k, name in enumerate(names):
        exact = float(np.sqrt(np.mean(rms[:, k] ** 2)))
        spreads[name] = dataclasses.replace(error_spread(errors[:, :, k]), rms=exact)
    return spreads


def _draw(covariance: Array, rng: np.random.Generator) -> Array:
    """Draws (machines, np) of N(0, covariance)."""
    noise = rng.standard_normal((VIRTUAL_MACHINES, len(covariance)))
    return np.asarray(noise @ covariance_root(covariance).T)


def _choose(draws: Array, rng: np.random.Generator) -> Array:
    """As many of the draws (m, np) as virtual machines are wanted."""
    return np.asarray(
        rng.choice(draws, VIRTUAL_MACHINES, replace=len(draws) < VIRTUAL_MACHINES)
    )


def _apply(maps: Array, parameters: Array) -> Array:
    """Errors (machines, n, k) of machines with parameter errors (machines, np)."""
    return np.asarray(np.einsum("nkp,dp->dnk", maps, parameters, optimize=True))


def _rms(maps: Array, covariance: Array, mean: Array) -> Array:
    """Root mean square (n, k) of maps @ N(mean, covariance)."""
    variance = np.einsum("nkp,pq,nkq->nk", maps, covariance, maps, optimize=True)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + (maps @ mean) ** 2))
