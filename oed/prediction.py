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
import re
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Mask
from oed.error_maps import ErrorMaps, Reference, error_maps, relative_to_reference
from oed.linear_algebra import covariance_root, right_singular

__all__ = [
    "ErrorMaps",
    "Prediction",
    "Reference",
    "Spread",
    "budget_sources",
    "error_maps",
    "error_spread",
    "parameter_kind",
    "predict",
    "relative_to_reference",
]

#: virtual machines drawn for the 95th percentile and the largest error
VIRTUAL_MACHINES = 400
#: name of the part of the budget that the readings' noise makes
NOISE_SOURCE = "readings' noise"


@dataclasses.dataclass(frozen=True, slots=True)
class Spread:
    """Error of one pose component, SI.

    rms      root mean square over workspace and machines
    p95      95th percentile of the error's size over workspace and machines
    largest  largest error over the workspace; 95 % of the machines stay below
    """

    rms: float
    p95: float
    largest: float


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
    budget           {component: {source: share of the variance of `fully_corrected`}}
    """

    reference: Reference
    command: Array
    names: tuple[str, ...]
    before: dict[str, Spread]
    after: dict[str, Spread]
    fully_corrected: dict[str, Spread]
    sd_before: Array
    sd_after: Array
    budget: dict[str, dict[str, float]]


def predict(
    maps: ErrorMaps,
    prior: Array,
    posterior: Array,
    rng: np.random.Generator,
    *,
    mean: Array | None = None,
    draws: Array | None = None,
    reference: Reference = "home",
    sources: Sequence[tuple[str, Array]] = (),
) -> Prediction:
    """Predict the residual accuracy from prior and posterior covariances (np, np), SI.

    mean     (np,) identified errors p_hat - p_nominal; None before measuring
    draws    (m, np) draws of delta from the posterior of the parameters, SI, of which
             `posterior` is the second moment; normal draws by default
    sources  (name, covariance (np, np)) parts that add up to `posterior`, for the
             uncertainty budget
    """
    measured = mean is not None
    centre = np.zeros(len(prior)) if mean is None else mean
    unknown_estimate = np.zeros_like(prior) if measured else prior - posterior
    delta = _draw(posterior, rng) if draws is None else _choose(draws, rng)
    estimate = centre + _draw(unknown_estimate, rng)
    undetermined = _apply(maps.raw, delta)
    errors = {
        "before": _apply(maps.raw, estimate + delta),
        "after": _apply(maps.remaining, estimate) + undetermined,
        "fully_corrected": undetermined,
    }
    rms_undetermined = _rms(maps.raw, posterior, np.zeros(len(prior)))
    rms_known = _rms(maps.remaining, unknown_estimate, centre)
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
        budget=_budget(maps, sources),
    )


def error_spread(errors: Array) -> Spread:
    """Spread of the errors (machines, n), SI, of one pose component."""
    size = np.abs(errors)
    return Spread(
        rms=float(np.sqrt(np.mean(errors**2))),
        p95=float(np.quantile(size, 0.95)),
        largest=float(np.quantile(size.max(axis=1), 0.95)),
    )


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


def _budget(
    maps: ErrorMaps, sources: Sequence[tuple[str, Array]]
) -> dict[str, dict[str, float]]:
    """Share of the variance by component and source."""
    zero = np.zeros(maps.raw.shape[2])
    parts = {}
    for source, covariance in sources:
        parts[source] = np.mean(_rms(maps.raw, covariance, zero) ** 2, axis=0)
    total = np.sum(list(parts.values()), axis=0)
    budget = {}
    for k, name in enumerate(maps.names):
        budget[name] = {s: float(part[k] / total[k]) for s, part in parts.items()}
    return budget


def budget_sources(
    h: Array, tolerance: Array, names: Sequence[str], machine_size: int
) -> list[tuple[str, Array]]:
    """Parts of the posterior covariance by source, over the machine's parameters, SI.

    h             (N, n) whitened slopes in "tolerance" scaling
    tolerance     (n,) prior standard deviations, SI; 0 for held parameters
    names         (n,) of the parameters
    machine_size  number of leading parameters that are the machine's

    With S = (I + H^T H)^-1 in tolerance units, S = S H^T H S + S S. The first part
    comes from the readings' noise, the second from the tolerances, split by the
    parameters' kinds.
    """
    values, vectors = right_singular(h)
    gain = values**2
    covariance = (vectors.T / (1.0 + gain)) @ vectors
    noise = (vectors.T * (gain / (1.0 + gain) ** 2)) @ vectors
    machine = slice(machine_size)
    scale = np.outer(tolerance[machine], tolerance[machine])
    parts = [(NOISE_SOURCE, noise[machine, machine] * scale)]
    kinds = np.array([parameter_kind(name) for name in names])
    for kind in dict.fromkeys(kinds.tolist()):
        members: Mask = (kinds == kind) & (tolerance > 0)
        if members.any():
            part = covariance[machine, members] @ covariance[members, machine]
            parts.append((f"tolerance of {kind}", part * scale))
    return parts


def parameter_kind(name: str) -> str:
    """Kind of a parameter, a source of the budget: `da1x` is `da`, `cup_x` is `cup`.

    The kind is the name without set-up, limb number and axis.
    """
    return re.sub(r"(_[xyz]|\d+[xyz]?)$", "", name.rpartition(".")[2])
