"""Noise laws of readings: white, correlated along a run, heavy-tailed, run-to-run, and
all of these together.

Covariance and draws come from the same few numbers (`Law`), which the truth files keep.
For heavy tails the covariance is that of the normal law with the same Fisher
information about a shift, so that sqrt(lambda) means what it says: of a Student t of nu
degrees, scale^2 (nu + 3) / (nu + 1); of a mixture with a share of outliers, sigma^2 /
(1 - share).
"""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from benchmarks.blind.generator.machines import Array
from benchmarks.blind.generator.plans import REFERENCE, Index, Plan
from benchmarks.blind.generator.scene import Layout

LAWS = ("white", "correlated", "heavy", "run", "combined")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Law:
    """A law, everything in units of a channel's sigma.

    level      standard deviation of the white part (scale of the t, sigma of the core)
    dof        degrees of a Student t; 0: normal
    outliers   share of readings that are wild, by `wild` times level
    along      standard deviation of an Ornstein-Uhlenbeck part along a run, with
               correlation length `length` readings
    offset     run-to-run: a constant;  wave: amplitude's standard deviation of a first
               harmonic over the run's path
    reference  noise of the reference reading that a run is told against
    """

    name: str
    level: float = 1.0
    dof: float = 0.0
    outliers: float = 0.0
    wild: float = 0.0
    along: float = 0.0
    length: float = 1.0
    offset: float = 0.0
    wave: float = 0.0
    reference: float = 1.0


def draw(rng: Generator, name: str) -> Law:
    """A law of a kind. Raises ValueError for an unknown kind."""
    level = float(rng.uniform(0.85, 1.2))

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    if name == "white":
        return Law(name=name, level=level)
    if name == "correlated":
        along, length = between(0.6, 1.2), between(2.0, 8.0)
        return Law(name=name, level=0.7 * level, along=along, length=length)
    if name == "heavy":
        return Law(name=name, **_tail(rng, level))
    if name == "run":
        offset, wave = between(0.5, 1.6), between(0.0, 0.6)
        return Law(name=name, level=level, offset=offset, wave=wave)
    if name == "combined":
        return Law(
            name=name,
            **_tail(rng, 0.75 * level),
            along=between(0.3, 0.8),
            length=between(2.0, 6.0),
            offset=between(0.3, 1.0),
            wave=between(0.0, 0.4),
        )
    raise ValueError(f"there is no noise law {name!r}; there are {', '.join(LAWS)}")


def _tail(rng: Generator, level: float) -> dict[str, float]:
    if rng.random() < 0.5:
        return {"level": 0.8 * level, "dof": float(rng.choice([2.5, 3.0, 4.0]))}
    return {
        "level": level,
        "outliers": float(rng.uniform(0.006, 0.02)),
        "wild": float(rng.uniform(6.0, 15.0)),
    }


@dataclasses.dataclass(frozen=True, kw_only=True)
class Grouping:
    """What covariance needs to know of N readings: channel's sigma (m), run, channel,
    phase (rad); `relative`: read against another reading of their run.
    """

    sigma: Array
    run: Index
    channel: Index
    phase: Array
    relative: NDArray[np.bool_]

    def groups(self) -> list[Index]:
        """Readings of each run and channel."""
        return [
            np.flatnonzero((self.run == r) & (self.channel == c))
            for r in np.unique(self.run)
            for c in np.unique(self.channel[self.run == r])
        ]


def grouping(plan: Plan, layout: Layout) -> Grouping:
    """The grouping of a plan's readings."""
    return Grouping(
        sigma=layout.sigma,
        run=plan.run[layout.row],
        channel=layout.channel,
        phase=plan.phase[layout.row],
        relative=plan.kind[layout.ref] == REFERENCE,
    )


def covariance(law: Law, group: Grouping) -> Array:
    """Sigma (N, N) of the readings, m^2."""
    variance = law.level**2
    if law.dof:
        variance *= (law.dof + 3.0) / (law.dof + 1.0)
    matrix = np.diag(variance / (1.0 - law.outliers) * group.sigma**2)
    for at in group.groups():
        matrix[np.ix_(at, at)] += group.sigma[at[0]] ** 2 * _shared(law, group, at)
    return matrix


def _shared(law: Law, group: Grouping, at: Index) -> Array:
    """What the readings of one run and channel share, in units of sigma^2."""
    phase = group.phase[at]
    shared = law.offset**2 + law.wave**2 * np.cos(phase[:, None] - phase[None])
    if group.relative[at[0]]:
        shared += (law.reference * law.level) ** 2
    if law.along:
        step = np.abs(np.arange(len(at))[:, None] - np.arange(len(at))[None])
        shared += law.along**2 * np.exp(-step / law.length)
    return np.asarray(shared)


def sample(rng: Generator, law: Law, group: Grouping) -> Array:
    """Noise (N,) of the readings, m."""
    size = len(group.sigma)
    noise = rng.standard_t(law.dof, size) if law.dof else rng.normal(size=size)
    wild = rng.random(size) < law.outliers
    noise = np.where(wild, noise * law.wild, noise) * law.level
    for at in group.groups():
        shared = _shared(law, group, at)
        if shared.any():
            root = np.linalg.cholesky(shared + 1e-12 * np.eye(len(at)))
            noise[at] += root @ rng.normal(size=len(at))
    return np.asarray(noise * group.sigma)
