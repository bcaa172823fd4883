"""Residual accuracy over the workspace, before and after compensation.

Compensatable components keep only A delta. The others keep R dp_hat as well, which is
known: an additional axis (an X-Y table) can correct it, and then A delta remains there
too. Before measuring, dp_hat is itself unknown, with covariance Lambda - Sigma (Lambda:
tolerances).
"""

import dataclasses
from collections.abc import Collection, Mapping
from typing import NamedTuple

import numpy as np

from oed.accuracy.maps import ErrorMaps, Reference
from oed.base import Array
from oed.linear_algebra import covariance_root
from oed.result import CompensationName, SpreadRecord

#: virtual machines drawn for the 95th percentile and the largest error
N_MACHINES = 2000
MAX_ERRORS = 12_000_000  #: errors of all machines, poses and components, at most
INTERVAL = (0.025, 0.975)  #: ends of the interval that holds 95 % of the machines

Interval = tuple[float, float]  #: lower and upper end
UNKNOWN_INTERVAL: Interval = (np.nan, np.nan)


@dataclasses.dataclass(frozen=True, slots=True)
class Spread:
    """Error of one pose component, SI."""

    rms: float  #: root mean square over workspace and machines
    p95: float  #: 95th percentile of the error's size over workspace and machines
    largest: float  #: largest error over the workspace; 95 % of the machines stay below
    #: interval that holds the rms over the workspace of 95 % of the machines
    rms_interval: Interval = UNKNOWN_INTERVAL
    #: the same of each machine's 95th percentile
    p95_interval: Interval = UNKNOWN_INTERVAL
    #: the same of each machine's largest error
    largest_interval: Interval = UNKNOWN_INTERVAL
    #: of the rms over the workspace of one machine, at the probabilities
    #: `oed.result.SpreadRecord.LEVELS`
    rms_quantiles: tuple[float, ...] = ()
    #: {figure: standard errors that the number of machines leaves}: of `rms` where it
    #: is drawn, of `p95`, `largest`, and of both ends of the intervals
    monte_carlo: Mapping[str, tuple[float, ...]] = dataclasses.field(
        default_factory=dict
    )

    @classmethod
    def of_errors(cls, errors: Array, worth: float | None = None) -> "Spread":
        """Spread of the errors (machines, n), SI, of one pose component.

        worth  number of independent machines that these are worth; all by default
        """
        size = np.abs(errors)
        of_machine = {
            "rms": np.sqrt(np.mean(size**2, axis=1)),
            "p95": np.quantile(size, 0.95, axis=1),
            "largest": size.max(axis=1),
        }
        rms = root_mean_square(size, worth)
        p95 = pooled_quantile(size, 0.95, worth)
        largest = quantile(of_machine["largest"], 0.95, worth)
        intervals: dict[str, Interval] = {}
        errors_of: dict[str, tuple[float, ...]] = {
            "rms": (rms.error,),
            "p95": (p95.error,),
            "largest": (largest.error,),
        }
        for name, values in of_machine.items():
            low, high = (quantile(values, end, worth) for end in INTERVAL)
            intervals[f"{name}_interval"] = (low.value, high.value)
            errors_of[f"{name}_interval"] = (low.error, high.error)
        return cls(
            rms=rms.value,
            p95=p95.value,
            largest=largest.value,
            rms_quantiles=tuple(
                np.quantile(of_machine["rms"], SpreadRecord.LEVELS).tolist()
            ),
            monte_carlo=errors_of,
            **intervals,
        )


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Residual accuracy over n workspace poses, for k pose components."""

    reference: Reference  #: against which errors are stated
    command: Array  #: (n, n_dof), SI
    names: tuple[str, ...]  #: (k,) of the components
    before: dict[str, Spread]  #: {component: Spread} without compensation
    after: dict[str, Spread]  #: {component: Spread} after compensation
    #: {component: Spread} once an additional axis corrects all that is known
    fully_corrected: dict[str, Spread]
    sd_before: Array  #: (n, k) root mean square error at each pose before, SI
    sd_after: Array  #: (n, k) the same after


def predict(
    maps: ErrorMaps,
    prior: Array,
    posterior: Array,
    rng: np.random.Generator,
    *,
    mean: Array | None = None,
    centre: Array | None = None,
    known: Array | None = None,
    before: Array | None = None,
    draws: Array | None = None,
    estimates: Array | None = None,
    worth: float | None = None,
    reference: Reference = "home",
    variance: Array | None = None,
) -> Prediction:
    """Predict the residual accuracy from prior and posterior covariances (np, np), SI.

    mean     (np,) identified errors p_hat - p_nominal; None before measuring
    centre   (np,) errors that are expected before measuring; 0 by default
    known    (n, k) exact errors that the compensated machine has if p_hat is right; R
             dp_hat by default, which misses the squares of large errors
    before   (n, k) exact errors under the controller as it is, if p_hat is right; by
             default those under one with nominal parameters, A dp_hat
    draws    (m, np) draws of delta from the posterior of the parameters, SI, of which
             `posterior` is the second moment; normal draws by default
    estimates  (m, np) of p_hat - p_nominal before measuring, one for each of the draws,
             all of which are taken then; normal draws by default
    worth    number of independent draws that these are worth; m by default
    variance (n, k) of the errors that delta causes, where it is known better than by
             the maps (`oed.accuracy.budget`); draws are scaled to it

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.accuracy import ErrorMaps, predict
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> maps = ErrorMaps.of(measurement.kinematics, np.array([[-1.0, 0.5], [1.0, 0.5]]))
    >>> prior = np.diag(measurement.tolerance[:7] ** 2)
    >>> halved = predict(maps, prior, prior / 4.0, np.random.default_rng(1))
    >>> round(halved.after["z"].rms / halved.before["z"].rms, 2)
    0.5
    """
    measured = mean is not None
    if mean is not None or centre is None:
        centre = np.zeros(len(prior)) if mean is None else mean
    unknown_estimate = np.zeros_like(prior) if measured else prior - posterior
    if draws is not None and estimates is not None:
        delta, estimate = draws, estimates
    else:
        delta, worth = _errors_of_estimate(maps, posterior, rng, draws, worth)
        estimate = centre + _draw(unknown_estimate, rng, len(delta))
    linear = _rms(maps.raw, posterior, 0.0)
    rms_undetermined = linear if variance is None else np.sqrt(variance)
    scale = _ratio(rms_undetermined, linear)
    uncorrected = maps.raw @ centre
    start = uncorrected if before is None else before
    rms_known = (
        _rms(maps.remaining, unknown_estimate, maps.remaining @ centre)
        if known is None
        else np.abs(known)
    )
    rms = {
        "before": np.hypot(linear, start) if measured else _rms(maps.raw, prior, start),
        "after": np.sqrt(rms_known**2 + rms_undetermined**2),
        "fully_corrected": rms_undetermined,
    }
    spreads: dict[str, dict[str, Spread]] = {kind: {} for kind in rms}
    for k, name in enumerate(maps.names):
        raw = maps.raw[:, k]
        undetermined = scale[:, k] * (delta @ raw.T)
        remaining = estimate @ maps.remaining[:, k].T if known is None else known[:, k]
        uncompensated = (estimate + delta) @ raw.T + (start - uncorrected)[:, k]
        corrected = _spread(undetermined, rms_undetermined[:, k], worth)
        spreads["before"][name] = _spread(uncompensated, rms["before"][:, k], worth)
        spreads["fully_corrected"][name] = spreads["after"][name] = corrected
        if remaining.any():
            after = remaining + undetermined
            spreads["after"][name] = _spread(after, rms["after"][:, k], worth)
    return Prediction(
        reference=reference,
        command=maps.command,
        names=maps.names,
        **spreads,
        sd_before=rms["before"],
        sd_after=rms["after"],
    )


def spread_after(
    maps: ErrorMaps,
    posterior: Array,
    rng: np.random.Generator,
    remaining: Array,
    draws: Array | None = None,
    worth: float | None = None,
) -> dict[str, Spread]:
    """`Prediction.after` alone, of a machine that was measured; arguments as there.

    remaining  (n, k) errors that the compensated machine has if the estimate is right
    """
    delta, worth = _errors_of_estimate(maps, posterior, rng, draws, worth)
    rms = _rms(maps.raw, posterior, remaining)
    spreads = {}
    for k, name in enumerate(maps.names):
        errors = remaining[:, k] + delta @ maps.raw[:, k].T
        spreads[name] = _spread(errors, rms[:, k], worth)
    return spreads


def least_error(
    before: Mapping[str, Spread],
    after: Mapping[str, Mapping[str, Spread]],
    driven: Collection[str],
) -> str:
    """Name of the compensation of least expected error, the first of equals; or CompensationName.NOTHING.

    before  {component: Spread} with nothing sent
    after   {compensation: {component: Spread}}, over the same draws
    driven  components that the controller corrects: the others do not decide

    Mean squares of the components add up in units of those with nothing sent, so that
    lengths and angles count alike.
    """
    units = {name: before[name].rms for name in driven if before[name].rms > 0.0}
    errors = {
        candidate: sum((spreads[n].rms / unit) ** 2 for n, unit in units.items())
        for candidate, spreads in {**after, CompensationName.NOTHING: before}.items()
    }
    return min(errors, key=lambda candidate: errors[candidate])


def _errors_of_estimate(
    maps: ErrorMaps,
    posterior: Array,
    rng: np.random.Generator,
    draws: Array | None,
    worth: float | None,
) -> tuple[Array, float | None]:
    """Errors (machines, np) of the parameters, and the machines that they are worth."""
    count = _machines(maps)
    if draws is None:
        return _draw(posterior, rng, count), worth
    return _choose(draws, rng, count, worth)


def _ratio(exact: Array, linear: Array) -> Array:
    """Exact over linear errors; 1 where the maps have none."""
    scale = np.ones_like(linear)
    np.divide(exact, linear, out=scale, where=linear > 0.0)
    return scale


def _spread(errors: Array, rms: Array, worth: float | None) -> Spread:
    """Spread of a component's drawn errors (machines, n), of exact rms (n,)."""
    drawn = Spread.of_errors(errors, worth)
    exact = float(np.sqrt(np.mean(rms**2)))
    others = {n: e for n, e in drawn.monte_carlo.items() if n != "rms"}
    return dataclasses.replace(drawn, rms=exact, monte_carlo=others)


def _machines(maps: ErrorMaps) -> int:
    """Number of virtual machines whose errors at all poses fit into the memory."""
    of_machine = maps.raw.shape[0] * maps.raw.shape[1]
    return int(np.clip(MAX_ERRORS // of_machine, 400, N_MACHINES))


def _draw(covariance: Array, rng: np.random.Generator, count: int) -> Array:
    """Draws (count, np) of N(0, covariance)."""
    noise = rng.standard_normal((count, len(covariance)))
    if not covariance.any():  # as after measuring; effects have thousands of columns
        return np.zeros_like(noise)
    return noise @ covariance_root(covariance).T


def _choose(
    draws: Array, rng: np.random.Generator, count: int, worth: float | None
) -> tuple[Array, float]:
    """`count` of the draws (m, np) or all, and how many independent ones they are worth.

    Draws of a chain are worth fewer than they are; some of them apart lose less.
    """
    chosen = draws
    if len(draws) > count:
        chosen = rng.choice(draws, count, replace=False)
    alone, whole = 1.0 / len(chosen), 1.0 / len(draws)
    related = 0.0 if worth is None else max(1.0 / max(worth, 1.0) - whole, 0.0)
    return np.asarray(chosen), 1.0 / (alone + related)


def _rms(maps: Array, covariance: Array, mean: Array | float) -> Array:
    """Root mean square (n, k) of maps @ N(0, covariance) + mean (n, k)."""
    variance = np.einsum("nkp,nkp->nk", maps @ covariance, maps)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0) + np.square(mean)))


class Drawn(NamedTuple):
    """A figure of draws, and its standard error."""

    value: float
    error: float


def quantile(values: Array, share: float, worth: float | None = None) -> Drawn:
    """A quantile of independent values (m,).

    worth  number of independent values that they are worth; m by default

    The error is half the distance between the quantiles that lie one standard error of
    the share to either side: it needs no density.
    """
    count = len(values) if worth is None else worth
    step = np.sqrt(share * (1.0 - share) / count)
    return _quantile(values, share, step)


def pooled_quantile(values: Array, share: float, worth: float | None = None) -> Drawn:
    """A quantile of the values (m, n) of m machines together.

    Machines are independent, their values are not: what counts is how the share beyond
    the quantile differs between machines.
    """
    machines = len(values) if worth is None else worth
    beyond = (values > np.quantile(values, share)).mean(axis=1)
    return _quantile(values, share, beyond.std() / np.sqrt(machines))


def root_mean_square(values: Array, worth: float | None = None) -> Drawn:
    """The root mean square of the values (m, n) of m machines together."""
    machines = len(values) if worth is None else worth
    squares = (values**2).mean(axis=1)
    size = float(np.sqrt(squares.mean()))
    error = squares.std() / np.sqrt(machines) / (2.0 * size) if size > 0.0 else 0.0
    return Drawn(size, float(error))


def _quantile(values: Array, share: float, step: float) -> Drawn:
    low, high = np.clip([share - step, share + step], 0.0, 1.0)
    value, below, above = np.quantile(values, [share, low, high])
    return Drawn(float(value), float(0.5 * (above - below)))
