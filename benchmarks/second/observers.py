"""Detectors that know the second generator: the log Bayes factor of an effect over none.

Three observers know ever less of the effect, and none knows the noise law of the case but only
the generator's distribution of laws:

- `EXACT` knows the change of the readings up to its size, which bounds every detector;
- `NAMED` knows the effect's name, and draws what the generator hides of it;
- `ANY` knows that one effect of the generator may act.

The last two replace the effect's distribution by Gaussian ones of the same second moment,
over all draws and over the draws that sit in one leg, and so are attainable: what they
detect can be detected.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import special

from benchmarks.second import noise_laws
from benchmarks.second.noise_laws import Law, LawModel
from benchmarks.second.replay import Generator, Replay
from oed.base import Array, Index

EXACT, NAMED, ANY = "exact", "named", "any"
#: draws of an effect on a machine of few legs, and of each further leg
DRAWS, DRAWS_PER_LEG = 40, 8
#: least draws of one leg that make a distribution of their own
FEW = 4


@dataclasses.dataclass(frozen=True)
class DrawnEffects:
    """Fresh draws of each effect.

    columns   (n, M) changes of the readings
    groups    {effect: [(columns, prior share)]}, a Gaussian distribution each
    shares    {effect: prior probability that it is the one that acts}
    """

    columns: Array
    groups: Mapping[str, Sequence[tuple[Index, float]]]
    shares: Mapping[str, float]


def draw_effects(
    generator: Generator, replay: Replay, machine: str, rng: np.random.Generator
) -> DrawnEffects:
    """Draw each effect of a machine as often as its legs ask for."""
    legs = replay.case.m.K
    count = DRAWS + DRAWS_PER_LEG * legs
    shares = generator.names(machine)
    columns: list[Array] = []
    groups = {}
    for name in shares:
        where = []
        for _ in range(count):
            change, sits = generator.drawn_change(replay, name, rng)
            columns.append(change)
            where.append(sits)
        groups[name] = _groups(len(columns) - count, where)
    return DrawnEffects(np.array(columns).T, groups, shares)


def _groups(start: int, where: Sequence[tuple[int, ...]]) -> list[tuple[Index, float]]:
    """All draws with half of the prior, and those of each leg, by their number."""
    every = np.arange(start, start + len(where), dtype=np.intp)
    by_leg: dict[tuple[int, ...], list[int]] = {}
    for number, sits in enumerate(where, start=start):
        by_leg.setdefault(sits, []).append(number)
    apart = [np.array(v, dtype=np.intp) for v in by_leg.values() if len(v) >= FEW]
    if len(apart) < 2:
        return [(every, 1.0)]
    total = sum(len(v) for v in apart)
    return [(every, 0.5), *((v, 0.5 * len(v) / total) for v in apart)]


def log_factors(
    replay: Replay,
    data: Array,
    drawn: DrawnEffects | None,
    named: Sequence[str],
    sizes: Array,
    grid: Sequence[Law],
) -> dict[str, Array]:
    """Log Bayes factor (S, R) of each observer on data (n, R), for each size s.

    named   effects that act, for the observer that knows their names; none for several
    grid    laws that an observer holds possible, with their log priors
    """
    models = [LawModel(replay, law) for law in grid]
    none, exact, any_effect, of_names = [], [], [], []
    for model in models:
        log_density, white = model.scores(data)
        none.append(log_density)
        exact.append(model.along(data, replay.change, sizes))
        if drawn is not None:
            ratios = _ratios(model, white, drawn, sizes)
            any_effect.append(log_density + _mixture(ratios, drawn.shares))
            if len(named) == 1:
                of_names.append(log_density + ratios[named[0]])
    base = noise_laws.over_laws(none, grid)
    factors = {EXACT: noise_laws.over_laws(exact, grid) - base}
    if any_effect:
        factors[ANY] = noise_laws.over_laws(any_effect, grid) - base
    if of_names:
        factors[NAMED] = noise_laws.over_laws(of_names, grid) - base
    return factors


def _mixture(ratios: Mapping[str, Array], shares: Mapping[str, float]) -> Array:
    logs = np.array([np.log(shares[name]) + ratios[name] for name in ratios])
    return np.asarray(special.logsumexp(logs, axis=0))


def _ratios(
    model: LawModel, white: Array, drawn: DrawnEffects, sizes: Array
) -> dict[str, Array]:
    """Log density ratio (S, R) of each effect over none under one law."""
    columns = model.whiten(drawn.columns)
    norms = np.linalg.norm(columns, axis=0)
    columns = columns / np.maximum(norms, 1e-9 * norms.max())
    slopes = columns.T @ white
    ratios = {}
    for name, groups in drawn.groups.items():
        logs = []
        for members, share in groups:
            part = columns[:, members]
            gain, log_det = _gaussian_ratio(part, slopes[members], sizes)
            log_ratio = model.log_ratio(white, gain) - 0.5 * log_det
            logs.append(np.log(share) + log_ratio)
        ratios[name] = np.asarray(special.logsumexp(np.array(logs), axis=0))
    return ratios


def _gaussian_ratio(columns: Array, slopes: Array, sizes: Array) -> tuple[Array, Array]:
    """Half the energy (S, R) by which N(0, I + s^2 U U^T / m) is below N(0, I).

    U are unit columns. The second result are the log determinants (S, 1).
    """
    count = columns.shape[1]
    values, axes = np.linalg.eigh(columns.T @ columns / count)
    clear = values > 1e-9
    energy = (axes[:, clear].T @ slopes) ** 2 / count
    square = sizes[:, None] ** 2
    inflation = 1.0 + square * values[clear]
    gain = 0.5 * (square / inflation) @ energy
    return np.asarray(gain), np.log(inflation).sum(axis=1, keepdims=True)
