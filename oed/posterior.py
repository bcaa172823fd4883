"""Posterior by emcee: the full nonlinear model in identifiable coordinates, all walkers
evaluated at once.

    log p(z, t | y) = -|z|^2 / 2 - sum_g [ N_g t_g + exp(-2 t_g) |(y - f(theta(z))) /
    sigma|_g^2 / 2 + t_g^2 / (2 s^2) ]

z are the coordinates of `oed.identification`; t_g = log of the noise factor of set-up g,
sampled where the noise is to be estimated, so that few readings give wide tails.
Directions that no reading sees are drawn from their prior. Two kinds of moves share the
work: independent proposals from the Laplace approximation with Student tails, which
decide almost every step where the posterior is nearly Gaussian, and differential
evolution (ter Braak 2006), which needs no such luck. (emcee's snooker move is left out:
on an 18-dimensional standard normal it returns a standard deviation of 0.91.) Sampling
goes on until every coordinate has the wanted effective sample size, by emcee's and by
ArviZ's estimate, and R-hat is low, or until the steps are used up.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oed.arrays import Array
from oed.identification import Estimate, IdentifiableCoordinates
from oed.measurement import Measurement, Series

#: prior standard deviation of a log noise factor
LOG_NOISE_SD = 1.0
#: steps between looks at the effective sample size
LOOK = 250
#: R-hat (each walker a chain) below which the walkers count as mixed
MIXED = 1.01
#: degrees of freedom of the independent proposals' Student tails
TAILS = 20.0


@dataclasses.dataclass(frozen=True)
class Posterior:
    """Draws and their diagnostics.

    names            parameters of theta
    draws            (chains, draws, n) theta, SI; one chain a walker, thinned
    z                (chains, draws, r) identifiable coordinates
    log_noise        (chains, draws, groups) log noise factors; groups in `noise_groups`
    ess, rhat        (n,) bulk effective sample size and split R-hat (ArviZ); NaN for
                     held parameters
    acceptance       mean acceptance share
    autocorrelation  longest integrated autocorrelation time, in steps (emcee)
    steps, burn_in   steps run and thrown away
    """

    names: tuple[str, ...]
    draws: Array
    z: Array
    log_noise: Array
    noise_groups: tuple[str, ...]
    ess: Array
    rhat: Array
    acceptance: float
    autocorrelation: float
    steps: int
    burn_in: int

    @property
    def pooled(self) -> Array:
        """All draws (chains * draws, n), SI."""
        return self.draws.reshape(-1, self.draws.shape[2])


def import_samplers() -> None:
    """Import what sampling needs: seconds, in which an interruption would be told by
    other people's code.
    """
    import emcee  # noqa: F401

    _diagnostics()


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
    max_draws: int = 20_000,
    progress: Callable[[float], None] | None = None,
) -> Posterior:
    """Sample about `estimate`; at most `keep` draws are returned. `progress` is told
    the share done.
    """
    import emcee

    estimated = tuple(estimate.noise_scale) if estimate.noise_estimated else ()
    target = _Target(measurement, series, y, estimate, estimated)
    dimensions = target.dimensions
    count = walkers or max(2 * (dimensions + 2), 32)
    moves = [(emcee.moves.MHMove(target.laplace), 0.6), (emcee.moves.DEMove(), 0.4)]
    sampler = emcee.EnsembleSampler(
        count, dimensions, target, vectorize=True, moves=moves
    )
    start = target.centre + rng.standard_normal((count, dimensions)) @ target.root.T
    state = emcee.State(
        start, random_state=np.random.RandomState(rng.integers(2**31)).get_state()
    )
    while sampler.iteration < max_steps:
        for latest in sampler.sample(
            state, iterations=min(LOOK, max_steps - sampler.iteration)
        ):
            state = latest
            if target.interrupted:
                raise KeyboardInterrupt
        longest = _longest(sampler)
        burn_in = min(int(2 * longest), sampler.iteration // 2)
        reached = count * (sampler.iteration - burn_in) / longest
        if progress is not None:
            progress(min(1.0, reached / (1.2 * ess)))
        if (
            reached > 1.2 * ess
            and sampler.iteration >= 2 * LOOK
            and sampler.iteration > 10 * longest
        ):
            chain = np.swapaxes(sampler.get_chain(discard=burn_in), 0, 1)
            moving = target.local.to_theta(chain[..., : target.r])[..., target.moving]
            if np.min(_ess(moving)) > ess and np.max(_rhat(moving)) < MIXED:
                break
    chain = np.swapaxes(sampler.get_chain(discard=burn_in), 0, 1)
    thin = max(1, -(-chain.shape[0] * chain.shape[1] // max_draws))
    return _gather(target, chain, thin, rng, sampler, longest, burn_in)


def _ess(chain: Array) -> Array:
    """Bulk effective sample size of each column of (chains, draws, n)."""
    return np.atleast_1d(_diagnostics().ess(chain, chain_axis=0, draw_axis=1))


def _rhat(chain: Array) -> Array:
    """Rank-normalised split R-hat of each column of (chains, draws, n)."""
    return np.atleast_1d(_diagnostics().rhat(chain, chain_axis=0, draw_axis=1))


def _diagnostics() -> Any:
    """ArviZ's array functions; imported late, they take seconds."""
    from arviz_stats import base

    return base.array_stats


def _longest(sampler: Any) -> float:
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore"
        )  # short chains are met by going on, not by a warning
        times = sampler.get_autocorr_time(tol=0)
    return float(np.nanmax(np.where(np.isfinite(times), times, sampler.iteration)))


class _Target:
    """The log density, vectorised over walkers."""

    def __init__(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        y: Array,
        estimate: Estimate,
        noise_groups: tuple[str, ...],
    ) -> None:
        self.measurement, self.y, self.estimate, self.noise_groups = (
            measurement,
            y,
            estimate,
            noise_groups,
        )
        self.local: IdentifiableCoordinates = estimate.coordinates
        self.readings = measurement.readings_near(series, estimate.theta)
        labels = np.array(measurement.setup_of_readings(series))
        self.interrupted = False
        self._members = [labels == g for g in noise_groups]
        self.r = self.local.basis.shape[1]
        self.moving = np.flatnonzero(np.abs(self.local.basis).max(axis=1) > 0)
        self.dimensions = self.r + len(noise_groups)
        jacobian = estimate.noise.whiten(measurement.jacobian(series, estimate.theta))
        self.slope = jacobian @ self.local.basis
        self.centre, self.root = self._laplace()
        self._stated = estimate.noise.scaled(
            np.array([1.0 / estimate.noise_scale[g] for g in labels])
        )

    def __call__(self, points: Array) -> Array:
        """Log density (walkers,). emcee prints a traceback of whatever is raised here,
        so Ctrl-C is only noted.
        """
        try:
            return self._density(points)
        except KeyboardInterrupt:
            self.interrupted = True
            return np.full(len(points), -np.inf)

    def _density(self, points: Array) -> Array:
        z, log_noise = points[:, : self.r], points[:, self.r :]
        white = self._stated.whiten_last(self.readings(self.local.to_theta(z)) - self.y)
        square, count = white**2, np.zeros(len(points))
        for k, members in enumerate(self._members):
            square[:, members] *= np.exp(-2.0 * log_noise[:, k])[:, None]
            count += members.sum() * log_noise[:, k]
        value = -0.5 * (
            square.sum(axis=1)
            + np.sum(z**2, axis=1)
            + np.sum((log_noise / LOG_NOISE_SD) ** 2, axis=1)
        )
        return np.where(np.isfinite(value), value - count, -np.inf)

    def carried(self, theta: Array, unseen: Array) -> Array:
        """Draws (..., n) moved along unseen directions, seen ones following so that the
        readings stay as they were.

        A lost direction is straight to first order only: turning joints by a
        millimetre's tolerance moves a reading by a micrometre to second order. Two
        Gauss-Newton steps take that out.
        """
        if not self.local.null_basis.size:
            return theta
        before = theta.reshape(-1, theta.shape[-1])
        wanted = self.readings(before)
        after = before + unseen.reshape(before.shape)
        back = np.linalg.pinv(self.slope).T @ self.local.basis.T
        for _ in range(2):
            after = (
                after
                - self.estimate.noise.whiten_last(self.readings(after) - wanted) @ back
            )
        return after.reshape(theta.shape)

    def laplace(
        self, points: Array, random: np.random.RandomState
    ) -> tuple[Array, Array]:
        """Independent proposals (Student about the Laplace approximation) and log
        q(old) - log q(new).
        """
        white = random.standard_normal(points.shape) / np.sqrt(
            random.chisquare(TAILS, size=(len(points), 1)) / TAILS
        )
        proposed = self.centre + white @ self.root.T
        old = np.linalg.solve(self.root, (points - self.centre).T).T
        power = -0.5 * (TAILS + self.dimensions)
        log_old, log_new = (
            power * np.log1p(np.sum(w**2, axis=1) / TAILS) for w in (old, white)
        )
        return proposed, log_old - log_new

    def _laplace(self) -> tuple[Array, Array]:
        """Centre (dimensions,) and a root of the covariance of the Laplace
        approximation.
        """
        values, vectors = np.linalg.eigh(self.slope.T @ self.slope + np.eye(self.r))
        spread = [0.7 / np.sqrt(max(1.0, members.sum())) for members in self._members]
        root = np.zeros((self.dimensions, self.dimensions))
        root[: self.r, : self.r] = vectors / np.sqrt(values)
        root[self.r :, self.r :] = np.diag(spread)
        log_noise = np.log([self.estimate.noise_scale[g] for g in self.noise_groups])
        return np.concatenate([self.estimate.z, log_noise]), root


def _gather(
    target: _Target,
    chain: Array,
    thin: int,
    rng: np.random.Generator,
    sampler: Any,
    longest: float,
    burn_in: int,
) -> Posterior:
    local, r = target.local, target.local.basis.shape[1]
    unseen = (
        rng.standard_normal((*chain.shape[:2], local.null_basis.shape[1]))
        @ local.null_basis.T
    )
    theta = target.carried(local.to_theta(chain[:, ::thin, :r]), unseen[:, ::thin])
    moved = np.flatnonzero(np.ptp(theta.reshape(-1, theta.shape[2]), axis=0) > 0)
    ess, rhat = np.full(theta.shape[2], np.nan), np.full(theta.shape[2], np.nan)
    ess[moved] = _ess(theta[..., moved])
    rhat[moved] = _rhat(theta[..., moved])
    return Posterior(
        names=target.measurement.names,
        draws=theta,
        z=chain[:, ::thin, :r],
        log_noise=chain[:, ::thin, r:],
        noise_groups=target.noise_groups,
        ess=ess,
        rhat=rhat,
        acceptance=float(np.mean(sampler.acceptance_fraction)),
        autocorrelation=longest,
        steps=int(sampler.iteration),
        burn_in=burn_in,
    )


def save(posterior: Posterior, path: Path, attributes: dict[str, str]) -> None:
    """Write the draws as NetCDF, readable by xarray and ArviZ; SI."""
    import arviz_base

    tree = arviz_base.from_dict(
        {
            "posterior": {"theta": posterior.draws, "log_noise": posterior.log_noise},
            "sample_stats": {
                "ess": posterior.ess[None, None],
                "rhat": posterior.rhat[None, None],
            },
        },
        coords={
            "parameter": list(posterior.names),
            "setup": list(posterior.noise_groups),
        },
        dims={
            "theta": ["parameter"],
            "log_noise": ["setup"],
            "ess": ["parameter"],
            "rhat": ["parameter"],
        },
    )
    tree.attrs.update(attributes)
    partial = path.with_name(path.name + ".part")
    tree.to_netcdf(partial, engine="h5netcdf")
    partial.replace(path)
