"""Posterior of the full nonlinear model, sampled by emcee with all walkers at once.

Two kinds of moves share the work. Independent proposals from the Laplace approximation
with Student tails decide almost every step where the posterior is nearly Gaussian.
Differential evolution (ter Braak 2006) needs no such shape. (emcee's snooker move is
left out: on an 18-dimensional standard normal it returns a standard deviation of 0.91.)
Sampling goes on until every coordinate has the wanted effective sample size, by emcee's
and by ArviZ's estimate, and independent ensembles agree (R-hat), or until the steps are
used up. Directions that no reading determines are drawn from their prior. Draws out of
the bounds of parameters are left out: what stays are draws of the truncated posterior.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from oed.base.arrays import Array, Mask
from oed.base.own_files import save_own
from oed.estimation.estimate import Estimate
from oed.measurement.measurement import Measurement, Series
from oed.posterior.checkpoint import Checkpoint
from oed.posterior.ensembles import Ensembles, ensemble_sizes
from oed.posterior.log_density import LogDensity, OutOfBoundsError

if TYPE_CHECKING:
    import xarray as xr

#: steps after which chains are saved, and between checks of convergence at least
CHECK_STEPS = 50
#: steps between checks as a share of those run: a check looks at all of them
CHECK_SHARE = 0.2
#: checks before sampling may end
LEAST_CHECKS = 2
#: steps, in autocorrelation times, that must be run, and that are discarded first
LEAST_TIMES, BURN_IN_TIMES = 10, 2
#: effective sample size by emcee's estimate, over the wanted one
SPARE = 1.2
#: R-hat of independent ensembles below which they agree
MIXED_RHAT = 1.01
#: draws returned by default, over the wanted effective sample size, which counts up to
#: the largest
DRAWS_OF_ESS, LARGEST_ESS = 4.0, 5000.0


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws from the posterior, and their diagnostics.

    names            parameters of theta
    draws            (chains, draws, n) theta, SI, thinned; a chain is an ensemble, its
                     walkers in turn, or a walker where there is one ensemble alone
    z                (chains, draws, r) identifiable coordinates
    noise_law        (chains, draws, d) coordinates of the noise law, standard normal a
                     priori (`oed.noise.prior`)
    noise_names      of these coordinates
    ess              (n,) bulk effective sample size (ArviZ); NaN for held parameters
    rhat             (n,) split R-hat of the ensembles (ArviZ); NaN for held parameters
    acceptance       mean share of accepted steps
    autocorrelation  longest integrated autocorrelation time, in steps (emcee)
    walkers          of all ensembles
    steps            steps run by each
    burn_in          steps discarded
    """

    names: tuple[str, ...]
    draws: Array
    z: Array
    noise_law: Array
    noise_names: tuple[str, ...]
    ess: Array
    rhat: Array
    acceptance: float
    autocorrelation: float
    walkers: int
    steps: int
    burn_in: int

    @property
    def pooled(self) -> Array:
        """The draws of all chains (chains * draws, n), SI."""
        return self.draws.reshape(-1, self.draws.shape[2])

    @property
    def theta(self) -> Array:
        """Means of the draws (n,), SI."""
        mean: Array = self.pooled.mean(axis=0)
        return mean

    @property
    def covariance(self) -> Array:
        """Covariance of the draws (n, n), SI."""
        return np.cov(self.pooled, rowvar=False)

    @property
    def sd(self) -> Array:
        """Standard deviations of the draws (n,), SI."""
        return np.sqrt(np.diag(self.covariance))


def import_samplers() -> None:
    """Import emcee and ArviZ now: it takes seconds.

    An interruption during an import would be reported by other people's code.
    """
    import emcee  # noqa: F401

    _arviz()


def sample(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    estimate: Estimate,
    rng: np.random.Generator,
    *,
    walkers: int | None = None,
    ess: float = 1000.0,
    max_steps: int = 20_000,
    max_draws: int | None = None,
    thin: int = 1,
    progress: Callable[[float], None] | None = None,
    checkpoint: Checkpoint | None = None,
    resumed: Callable[[int], None] | None = None,
) -> Posterior:
    """Sample the posterior of readings y (N,), SI, about an estimate.

    walkers     of all ensembles; as many as are needed by default
    ess         effective sample size wanted of every parameter
    max_steps   of every walker
    max_draws   returned at most: the chains are thinned; four times `ess` by default
    thin        each so many-th step is returned, or fewer
    progress    called with the share done
    checkpoint  where the unfinished chain is saved, and resumed from
    resumed     called with the steps of a chain that is resumed

    Raises KeyboardInterrupt where Ctrl-C arrives, OSError where the checkpoint cannot
    be written, OutOfBoundsError where readings and bounds contradict each other.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from oed.posterior import sample
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> posterior = sample(measurement, [series], y, estimate, rng, ess=400)
    >>> bool(np.nanmin(posterior.ess) > 400)
    True
    >>> shift = np.abs(posterior.theta - estimate.theta)
    >>> bool(np.all(shift < estimate.sd))
    True
    """
    target = LogDensity(measurement, series, y, estimate)
    sizes = ensemble_sizes(walkers, target.dimensions)
    determining = (y, target.centre, target.root, *_bounds(measurement))
    ensembles = Ensembles(target, sizes, rng, checkpoint, determining)
    if ensembles.saved > 0 and resumed is not None:
        resumed(ensembles.saved)
    autocorrelation, burn_in = _run(ensembles, target, ess, max_steps, progress)
    draws = max_draws or int(DRAWS_OF_ESS * min(ess, LARGEST_ESS))
    return _posterior(
        target, ensembles, autocorrelation, burn_in, rng, max_draws=draws, thin=thin
    )


def _bounds(measurement: Measurement) -> tuple[Array, ...]:
    """The bounds, where there are any."""
    return (measurement.bounds,) if measurement.bounded.size else ()


def _run(
    ensembles: Ensembles,
    target: LogDensity,
    ess: float,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[float, int]:
    """Run until the chains have converged; autocorrelation time and burn-in, in steps.

    Chains that are resumed are judged before they go on, as the unbroken ones were.
    """
    checks = _checks(max_steps)
    while True:
        begin = ensembles.iteration
        is_due = begin in checks or begin >= max_steps
        if is_due and begin == ensembles.saved:
            autocorrelation = ensembles.autocorrelation()
            burn_in = min(int(BURN_IN_TIMES * autocorrelation), begin // 2)
            reached = ensembles.walkers * (begin - burn_in) / autocorrelation
            if progress is not None:
                progress(min(1.0, reached / (SPARE * ess)))
            enough = (
                reached > SPARE * ess
                and begin >= LEAST_CHECKS * CHECK_STEPS
                and begin > LEAST_TIMES * autocorrelation
            )
            if enough and _has_converged(target, ensembles, burn_in, ess):
                return autocorrelation, burn_in
            if begin >= max_steps:
                return autocorrelation, burn_in
        block = begin - begin % CHECK_STEPS + CHECK_STEPS
        ensembles.run_to(min(block, max_steps))


def _checks(max_steps: int) -> set[int]:
    """Numbers of steps at which convergence is checked, the last one among them."""
    checks, steps = set(), 0
    while steps < max_steps:
        apart = int(CHECK_SHARE * steps) // CHECK_STEPS * CHECK_STEPS
        steps = min(steps + max(apart, CHECK_STEPS), max_steps)
        checks.add(steps)
    return checks


def _has_converged(
    target: LogDensity, ensembles: Ensembles, burn_in: int, ess: float
) -> bool:
    chain = ensembles.chains(burn_in)
    moving = target.coordinates.to_theta(chain[..., : target.r])[..., target.moving]
    if np.min(_ess(moving)) <= ess:
        return False
    return bool(np.max(_rhat(ensembles.by_ensemble(moving))) < MIXED_RHAT)


def _ess(chain: Array) -> Array:
    """Bulk effective sample size (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(_arviz().ess(chain, chain_axis=0, draw_axis=1))


def _rhat(chain: Array) -> Array:
    """Rank-normalised split R-hat (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(_arviz().rhat(chain, chain_axis=0, draw_axis=1))


def _arviz() -> Any:
    """ArviZ's functions of arrays; imported late, as it takes seconds."""
    from arviz_stats import base

    return base.array_stats


def _posterior(
    target: LogDensity,
    ensembles: Ensembles,
    autocorrelation: float,
    burn_in: int,
    rng: np.random.Generator,
    *,
    max_draws: int,
    thin: int,
) -> Posterior:
    """Thinned draws, with null directions from their prior, and their diagnostics.

    Diagnostics are those of all steps; of thinned draws they would be rougher.
    """
    coordinates, r = target.coordinates, target.r
    chain = ensembles.chains(burn_in)
    every = max(thin, -(-chain.shape[0] * chain.shape[1] // max_draws))
    thinned = chain[:, ::every]
    null = coordinates.null_basis
    change = rng.standard_normal((*thinned.shape[:2], null.shape[1])) @ null.T
    theta = coordinates.to_theta(thinned[..., :r])
    theta = target.move_along_null(theta, change)
    ess, rhat = _diagnostics(target, ensembles, chain, theta)
    draws, points = ensembles.by_ensemble(theta), ensembles.by_ensemble(thinned)
    inside = target.in_bounds(draws)
    draws, points = _accepted(draws, inside), _accepted(points, inside)
    if not draws.size:
        raise OutOfBoundsError(target.measurement, theta.reshape(-1, theta.shape[2]))
    return Posterior(
        names=target.measurement.names,
        draws=draws,
        z=points[..., :r],
        noise_law=points[..., r:],
        noise_names=target.noise_names,
        ess=ess * inside.mean(),
        rhat=rhat,
        acceptance=ensembles.acceptance,
        autocorrelation=autocorrelation,
        walkers=ensembles.walkers,
        steps=ensembles.iteration,
        burn_in=burn_in,
    )


def _accepted(values: Array, inside: Mask) -> Array:
    """Values (chains, k, m) of those (chains, draws) inside, as many of each chain.

    All in one chain where that would leave out half of them.
    """
    least = int(inside.sum(axis=1).min())
    if least * len(values) < 0.5 * inside.sum():
        return values[inside][None]
    chains = zip(values, inside, strict=True)
    return np.stack([chain[within][:least] for chain, within in chains])


def _diagnostics(
    target: LogDensity, ensembles: Ensembles, chain: Array, theta: Array
) -> tuple[Array, Array]:
    """Effective sample size and R-hat (n,); NaN for parameters that are held.

    Of directions that no reading determines draws are independent: parameters that
    nothing else moves count as the drawn theta.
    """
    n, moving = theta.shape[2], target.moving
    ess, rhat = np.full(n, np.nan), np.full(n, np.nan)
    varying = np.flatnonzero(np.ptp(theta.reshape(-1, n), axis=0) > 0)
    only_null = np.setdiff1d(varying, moving)
    sampled = target.coordinates.to_theta(chain[..., : target.r])
    for members, values in ((moving, sampled), (only_null, theta)):
        if members.size:
            ess[members] = _ess(values[..., members])
            rhat[members] = _rhat(ensembles.by_ensemble(values[..., members]))
    return ess, rhat


def to_arviz(posterior: Posterior) -> xr.DataTree:
    """The draws, SI, as ArviZ and xarray read them: groups posterior and sample_stats.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from oed.posterior import sample, to_arviz
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> posterior = sample(measurement, [series], y, estimate, rng, ess=400)
    >>> to_arviz(posterior)["posterior"]["theta"].dims
    ('chain', 'draw', 'parameter')
    """
    import arviz_base

    groups = {
        "posterior": {"theta": posterior.draws, "noise_law": posterior.noise_law},
        "sample_stats": {
            "ess": posterior.ess[None, None],
            "rhat": posterior.rhat[None, None],
        },
    }
    tree: xr.DataTree = arviz_base.from_dict(
        groups,
        # a chain of a single ensemble is a walker, and may be short
        check_conventions=False,
        coords={
            "parameter": list(posterior.names),
            "noise_coordinate": list(posterior.noise_names),
        },
        dims={
            "theta": ["parameter"],
            "noise_law": ["noise_coordinate"],
            "ess": ["parameter"],
            "rhat": ["parameter"],
        },
    )
    return tree


def save(posterior: Posterior, path: Path, attributes: dict[str, str]) -> Path:
    """Write the draws, SI, as NetCDF for xarray and ArviZ, whole or not at all.

    Returns the path: one with a number where the user changed the file.
    """
    tree = to_arviz(posterior)
    tree.attrs.update(attributes)
    return save_own(path, lambda part: tree.to_netcdf(part, engine="h5netcdf"))
