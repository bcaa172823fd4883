"""What linearisation cuts off, from the exact model.

With errors d' left after a stage, r_i = y_i(d') - y_i(0) - h_i d' is what the slopes do
not tell of reading i. The machine is identified by the exact model, so r is no noise:
it belongs to the same few unknowns in all readings, and disturbs only combinations of
readings that go with it. The best linear estimate under y = h d + r + e has the
covariance

    S' = ( S^-1 + H^T (1 + C)^-1 H )^-1,        C = cov(r) over the drawn errors,
                                                whitened as the readings are:

so each drawn r, less their mean, over sqrt(m - 1), is a column of readings with an
unknown N(0, 1) of its own, which is profiled out. A fit by the exact model is at least
as good. Taken as noise of each reading by itself, r would count many times over.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.planning.known import roots
from oed.planning.option import Option

#: share of a reading's noise below which what is cut off does not matter
NEGLIGIBLE = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class CutOff:
    """rms (readings,) over machines that can read it, SI; inf where no machine reaches
    the pose.

    columns (G, readings, m) whitened, for each pattern of readings taken; None where
    nothing matters
    """

    rms: Array
    columns: Array | None


def cut_off(
    option: Option,
    chosen: Index,
    left: Array,
    patterns: Array,
    which: Index,
    each: int,
    rng: np.random.Generator,
) -> CutOff:
    """What is cut off of the chosen candidates' readings, `each` machines drawn for
    every pattern.

    left (P, w, w) covariances of parameters, set-ups' unknowns and shared errors after
    the stage; patterns (G, N) of candidates taken, `which` (P,) of them each machine
    follows.
    """
    measurement = option.measurement
    series, free = option.taken(chosen), np.flatnonzero(measurement.free)
    picked = [np.resize(np.flatnonzero(which == g), each) for g in range(len(patterns))]
    many = roots(left[np.concatenate(picked)])
    moves = np.einsum("pnm,pm->pn", many, rng.standard_normal(many.shape[:2]))
    errors = np.zeros((len(moves), len(measurement.nominal)))
    errors[:, free] = moves[:, : len(free)] * measurement.tolerance[free]
    exact = measurement.try_readings(series, measurement.nominal + errors)
    linear = errors @ measurement.jacobian(series, measurement.nominal).T
    miss = exact - measurement.readings(series, measurement.nominal) - linear
    owner = np.repeat(np.arange(len(chosen)), sizes(option, chosen))
    read = np.repeat(patterns[:, owner] > 0.0, each, axis=0) & np.isfinite(miss)
    mean_square = np.sum(np.where(read, miss, 0.0) ** 2, axis=0) / np.maximum(
        read.sum(axis=0), 1
    )
    rms = np.where((~np.isfinite(miss)).all(axis=0), np.inf, np.sqrt(mean_square))
    if not (rms > NEGLIGIBLE * measurement.sigma(series)).any():
        return CutOff(rms, None)
    white = whitened(option, chosen, np.where(read, miss, 0.0)).reshape(
        len(patterns), each, -1
    )
    centred = (white - white.mean(axis=1, keepdims=True)) / np.sqrt(each - 1.0)
    # no more columns than readings: R R^T is what counts
    short = np.linalg.qr(centred, mode="r") if each > centred.shape[2] else centred
    return CutOff(rms, np.ascontiguousarray(np.swapaxes(short, 1, 2)))


def sizes(option: Option, chosen: Index) -> Index:
    """Numbers, with all channels, that each chosen candidate (N,) reads."""
    candidates = option.candidates
    channels = np.array(
        [len(option.measurement.setups[name].sigma) for name in candidates.setups]
    )
    return np.asarray(
        candidates.members[chosen, 1] * channels[candidates.setup[chosen]]
    )


def rows(option: Option, chosen: Index) -> Array:
    """Whitened slopes (readings, w) of the chosen candidates, number by number, in
    tolerance units.
    """
    measurement, found = option.measurement, option.candidates
    slopes = (
        measurement.jacobian(option.taken(chosen), measurement.nominal)
        * measurement.tolerance
    )
    made = np.zeros((len(slopes), found.blocks.shape[2]))
    made[:, : found.columns] = whitened(option, chosen, slopes[:, measurement.free].T).T
    if found.shared_errors:  # single readings, whose rows are those of the blocks
        real = np.arange(found.blocks.shape[1]) < sizes(option, chosen)[:, None]
        made[:, found.columns :] = found.blocks[chosen][real][:, found.columns :]
    return made


def whitened(option: Option, chosen: Index, values: Array) -> Array:
    """Values (m, readings) whitened as the candidates' blocks are: whole runs with all
    they share, single readings with the noise of their own.
    """
    measurement, series = option.measurement, option.taken(chosen)
    if (option.candidates.members[:, 1] > 1).any():
        return measurement.noise(series).whiten_last(values)
    parts, start = [], 0
    for s in series:
        root = np.linalg.cholesky(measurement.own_noise(s))
        n, k = root.shape[:2]
        mine = values[:, start : start + n * k].reshape(-1, n, k).transpose(1, 2, 0)
        parts.append(
            np.linalg.solve(root, mine).transpose(2, 0, 1).reshape(len(values), -1)
        )
        start += n * k
    return np.hstack(parts)
