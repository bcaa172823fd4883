"""Draws of the posterior by emcee: ensembles run until they agree, or steps are used up.

Two kinds of moves share the work. Independent proposals from the Laplace approximation
with Student tails decide almost every step where the posterior is nearly Gaussian.
Differential evolution (ter Braak 2006) needs no such shape. (emcee's snooker move is
left out: on an 18-dimensional standard normal it returns a standard deviation of 0.91.)
Sampling goes on until every coordinate has the wanted effective sample size, by emcee's
and by ArviZ's estimate, and independent ensembles agree (R-hat), or until the steps are
used up.

The walkers of one ensemble propose from each other, so they are no independent chains:
only ensembles with starts and random numbers of their own show whether sampling agrees
with itself.
"""

import contextlib
import dataclasses
import hashlib
import io
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from oed.base import Array, Mask
from oed.posterior.draws import Posterior
from oed.posterior.log_density import LogDensity, OutOfBoundsError
from oed.safe_files import whole_file

N_ENSEMBLES = 4  #: ensembles of independent random numbers
MIN_WALKERS = 16  #: walkers of an ensemble at least
LAPLACE_SHARE = 0.6  #: share of steps that are proposed from the Laplace approximation
EVOLUTION_SHARE = 0.4  #: share of steps by differential evolution
CHECK_STEPS = 50  #: steps between checks of convergence at least
#: steps between checks as a share of those run: a check looks at all of them
CHECK_SHARE = 0.2
MIN_CHECKS = 2  #: checks before sampling may end
MIN_TIMES = 10  #: steps that must be run, in autocorrelation times
BURN_IN_TIMES = 2  #: steps of the burn-in, in autocorrelation times
SPARE_ESS = 1.2  #: effective sample size by emcee's estimate, over the wanted one
MIXED_RHAT = 1.01  #: R-hat of independent ensembles below which they agree

#: points (count, dimensions) to start from
Starts = Callable[[np.random.Generator, int], Array]


@dataclasses.dataclass(frozen=True, slots=True)
class Checkpoint:
    """Where an unfinished chain is saved, so that an interrupted run goes on from there."""

    folder: Path  #: of the file; other files in it stay
    key: str  #: text about what is sampled: a chain of another key is not resumed

    @property
    def file(self) -> Path:
        """The file of the chain."""
        return self.folder / "chain.npz"

    def save(self, arrays: Mapping[str, Any]) -> None:
        """Write arrays, whole; where the disk refuses, an earlier chain stays."""
        content = io.BytesIO()
        np.savez(content, **arrays)
        with contextlib.suppress(OSError):
            self.folder.mkdir(parents=True, exist_ok=True)
            with whole_file(self.file) as part:
                part.write_bytes(content.getvalue())

    def load(self) -> dict[str, Array]:
        """The saved arrays; none where there is no file, or a broken one."""
        try:
            with (
                self.file.open("rb") as file,
                np.load(file, allow_pickle=False) as arrays,
            ):
                return dict(arrays)
        except (OSError, ValueError, EOFError, TypeError, zipfile.BadZipFile):
            return {}

    def clear(self) -> None:
        """Remove the chain once the result holds its draws, and the folder if empty."""
        with contextlib.suppress(OSError):
            self.file.unlink()
            self.folder.rmdir()


def ensemble_sizes(walkers: int | None, dimensions: int) -> list[int]:
    """Walkers of each ensemble: as many in all as given, wanted, or span the space."""
    if walkers is None:
        return [max(2 * (dimensions + 2), MIN_WALKERS)] * N_ENSEMBLES
    walkers = max(walkers, 2 * dimensions + 2)
    count = max(1, min(N_ENSEMBLES, walkers // (2 * dimensions)))
    return [len(part) for part in np.array_split(np.arange(walkers), count)]


class Ensembles:
    """Ensembles of one density, all after the same number of steps.

    They go on where a checkpoint of the same key, starts and random numbers ends: the
    resumed chain is the unbroken one, bit by bit.
    """

    def __init__(
        self,
        target: LogDensity,
        sizes: Sequence[int],
        rng: np.random.Generator,
        starts: Starts,
        checkpoint: Checkpoint | None = None,
    ) -> None:
        import emcee

        self._target, self._checkpoint = target, checkpoint
        moves = [
            (emcee.moves.MHMove(target.propose), LAPLACE_SHARE),
            (emcee.moves.DEMove(), EVOLUTION_SHARE),
        ]
        self._states, self._samplers = [], []
        for size in sizes:
            start = starts(rng, size)
            random: Any = np.random.RandomState(rng.integers(2**31)).get_state()
            self._states.append(emcee.State(start, random_state=random))
            sampler = emcee.EnsembleSampler(
                *start.shape, target, vectorize=True, moves=moves
            )
            self._samplers.append(sampler)
        self._fingerprint = self._digest()
        #: steps of a chain that is resumed
        self.resumed = self._resume()

    @property
    def iteration(self) -> int:
        """Steps so far."""
        return int(self._samplers[0].iteration)

    @property
    def walkers(self) -> int:
        """Walkers of all ensembles."""
        return sum(sampler.nwalkers for sampler in self._samplers)

    @property
    def acceptance(self) -> float:
        """Mean share of accepted steps."""
        shares = [sampler.acceptance_fraction for sampler in self._samplers]
        return float(np.mean(np.concatenate(shares)))

    def run_to(self, steps: int) -> None:
        """Let ensembles run to so many steps, and save. Raises KeyboardInterrupt."""
        more = steps - self.iteration
        if more <= 0:
            return
        for k, sampler in enumerate(self._samplers):
            for state in sampler.sample(self._states[k], iterations=more):
                self._states[k] = state
                if self._target.interrupted:
                    raise KeyboardInterrupt
        if self._checkpoint is not None:
            self._checkpoint.save(self._saved())

    def _saved(self) -> dict[str, Any]:
        """Chains, with the random numbers after them."""
        arrays = {"fingerprint": np.array(self._fingerprint)}
        for k, sampler in enumerate(self._samplers):
            _, keys, *rest = sampler.backend.random_state
            arrays[f"chain_{k}"] = sampler.get_chain()
            arrays[f"log_prob_{k}"] = sampler.get_log_prob()
            arrays[f"accepted_{k}"] = sampler.backend.accepted
            arrays[f"random_keys_{k}"] = keys
            arrays[f"random_{k}"] = np.array(rest)
        return arrays

    def _resume(self) -> int:
        """Take up the saved chains of this fingerprint; the number of their steps."""
        saved = {} if self._checkpoint is None else self._checkpoint.load()
        if saved.get("fingerprint", "") != self._fingerprint:
            return 0
        for k, sampler in enumerate(self._samplers):
            backend, chain = sampler.backend, saved[f"chain_{k}"]
            backend.grow(len(chain), None)
            backend.chain[:] = chain
            backend.log_prob[:] = saved[f"log_prob_{k}"]
            backend.accepted = saved[f"accepted_{k}"]
            position, has_gauss, gauss = saved[f"random_{k}"]
            keys = saved[f"random_keys_{k}"]
            backend.random_state = (
                "MT19937", keys, int(position), int(has_gauss), gauss
            )  # fmt: skip
            backend.iteration = len(chain)
            self._states[k] = sampler.get_last_sample()
        return self.iteration

    def _digest(self) -> str:
        """Digest of what determines the chains: key, starts, random numbers."""
        key = "" if self._checkpoint is None else self._checkpoint.key
        digest = hashlib.sha256(key.encode())
        for state in self._states:
            digest.update(np.ascontiguousarray(state.coords).tobytes())
            digest.update(state.random_state[1].tobytes())
        return digest.hexdigest()

    def chains(self, burn_in: int) -> Array:
        """Points (walkers, steps, dimensions) of all ensembles after the burn-in."""
        parts = [
            np.swapaxes(sampler.get_chain(discard=burn_in), 0, 1)
            for sampler in self._samplers
        ]
        return np.concatenate(parts)

    def group_by_ensemble(self, values: Array) -> Array:
        """Values (walkers, steps, k) as (ensembles, steps times walkers, k).

        Each ensemble has as many walkers as the smallest one. A single ensemble's
        walkers stay chains of their own.
        """
        sizes = [sampler.nwalkers for sampler in self._samplers]
        if len(sizes) == 1:
            return values
        starts, least = np.cumsum([0, *sizes[:-1]]), min(sizes)
        parts = [np.swapaxes(values[s : s + least], 0, 1) for s in starts]
        shape = (len(parts), least * values.shape[1], values.shape[2])
        return np.stack(parts).reshape(shape)

    def autocorrelation(self) -> float:
        """Longest integrated autocorrelation time, in steps (emcee)."""
        import emcee

        chain = np.swapaxes(self.chains(0), 0, 1)
        with warnings.catch_warnings():
            # Chains that are too short go on; they need no warning.
            warnings.simplefilter("ignore")
            times = emcee.autocorr.integrated_time(chain, tol=0)
        return float(np.nanmax(np.where(np.isfinite(times), times, self.iteration)))


def run(
    ensembles: Ensembles,
    target: LogDensity,
    ess: float,
    max_steps: int,
    progress: Callable[[float], None] | None,
) -> tuple[float, int]:
    """Run to convergence, judged on resuming too; correlation and burn-in, steps."""
    for steps in _checks(max_steps):
        if steps < min(ensembles.iteration, max_steps):
            continue
        ensembles.run_to(steps)
        autocorrelation = ensembles.autocorrelation()
        burn_in = min(int(BURN_IN_TIMES * autocorrelation), steps // 2)
        reached = ensembles.walkers * (steps - burn_in) / autocorrelation
        if progress is not None:
            progress(min(1.0, reached / (SPARE_ESS * ess)))
        enough = (
            reached > SPARE_ESS * ess
            and steps >= MIN_CHECKS * CHECK_STEPS
            and steps > MIN_TIMES * autocorrelation
        )
        if enough and _has_converged(target, ensembles, burn_in, ess):
            break
    return autocorrelation, burn_in


def _checks(max_steps: int) -> list[int]:
    """Numbers of steps at which convergence is checked, the last one among them."""
    checks = []
    steps = 0
    while steps < max_steps:
        apart = int(CHECK_SHARE * steps) // CHECK_STEPS * CHECK_STEPS
        steps = min(steps + max(apart, CHECK_STEPS), max_steps)
        checks.append(steps)
    return checks


def _has_converged(
    target: LogDensity, ensembles: Ensembles, burn_in: int, ess: float
) -> bool:
    chain = ensembles.chains(burn_in)
    moving = target.coordinates.to_theta(chain[..., : target.r])[..., target.moving]
    if np.min(_ess(moving)) <= ess:
        return False
    return bool(np.max(_rhat(ensembles.group_by_ensemble(moving))) < MIXED_RHAT)


def _ess(chain: Array) -> Array:
    """Bulk effective sample size (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(arviz().ess(chain, chain_axis=0, draw_axis=1))


def _rhat(chain: Array) -> Array:
    """Rank-normalised split R-hat (n,) of chains (chains, draws, n)."""
    return np.atleast_1d(arviz().rhat(chain, chain_axis=0, draw_axis=1))


def arviz() -> Any:
    """ArviZ's functions of arrays; imported late, as it takes seconds."""
    from arviz_stats import base

    return base.array_stats


def collect(
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
    r = target.r
    chain = ensembles.chains(burn_in)
    every = max(thin, -(-chain.shape[0] * chain.shape[1] // max_draws))
    thinned = chain[:, ::every]
    theta = target.draw_theta(rng, thinned[..., :r])
    ess, rhat = _diagnostics(target, ensembles, chain, theta)
    draws = ensembles.group_by_ensemble(theta)
    points = ensembles.group_by_ensemble(thinned)
    inside = target.measurement.in_bounds(draws)
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
    )


def _accepted(values: Array, inside: Mask) -> Array:
    """Values (chains, k, m) inside, equally many, or one chain if half would go."""
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
            rhat[members] = _rhat(ensembles.group_by_ensemble(values[..., members]))
    return ess, rhat
