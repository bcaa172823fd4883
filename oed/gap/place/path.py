"""Regions of the path: single runs, sectors of the phase, directions of travel."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.arrays import Array, Mask
from oed.gap.data.problem import GapProblem
from oed.gap.place.regions import Region, channel_offsets, runs

#: cells of the phase that sectors are made of, and the longest sector in cells
SECTORS, WIDEST = 12, 6
#: readings that a run must have for its waves and its phase to mean something
WAVES = 8


def single_runs(problem: GapProblem) -> Iterator[Region]:
    """An offset of each run, and harmonics in it where it is long enough."""
    offsets, waves = channel_offsets(problem), _waves(problem)
    least = WAVES * offsets.shape[1]
    for k, (place, inside) in enumerate(runs(problem)):
        cells = frozenset({k})
        yield Region("run", place, inside[:, None] * offsets, cells)
        if inside.sum() >= least:
            yield Region("run", place, inside[:, None] * waves, cells)


def sectors(problem: GapProblem) -> Iterator[Region]:
    """Bumps in sectors of the phase: the same both ways, or with the direction's sign."""
    phase = _phase(problem)
    valid = _has_phase(problem, phase)
    if not valid.any():
        return
    number = (phase / (2.0 * np.pi) * SECTORS).astype(int)
    number = np.minimum(number, SECTORS - 1)
    offsets, direction = channel_offsets(problem), _direction(problem)
    signs = [np.ones(len(problem))]
    if direction.min() < 0.0 < direction.max():
        signs.append(direction)
    for start in range(SECTORS):
        for length in range(1, WIDEST + 1):
            cells = frozenset((start + k) % SECTORS for k in range(length))
            inside = valid & np.isin(number, list(cells))
            place = _sector_name(start, length)
            for sign in signs:
                basis = (inside * sign)[:, None] * offsets
                yield Region("phase", place, basis, cells)


def _has_phase(problem: GapProblem, phase: Array) -> Mask:
    """Whether a reading's run has places enough along it (N,)."""
    valid = np.zeros(len(problem), dtype=bool)
    for members in problem.members:
        places = np.unique(np.round(phase[members], 9))
        valid[members] = len(places) >= WAVES
    return valid


def _sector_name(start: int, length: int) -> str:
    last = (start + length - 1) % SECTORS
    begin, end = 360 * start // SECTORS, 360 * (last + 1) // SECTORS
    return f"phase {begin}-{end}"


def directions(problem: GapProblem) -> Iterator[Region]:
    """Offset and harmonics of all readings of a direction, where both were taken."""
    direction = _direction(problem)
    both = direction.min(initial=0.0) < 0.0 < direction.max(initial=0.0)
    if not both:
        return
    for sign in (1, -1):
        inside = (direction == sign)[:, None]
        basis, place = inside * _waves(problem), f"direction {sign:+d}"
        yield Region("direction", place, basis, frozenset({sign}))


def _phase(problem: GapProblem) -> Array:
    return np.asarray(problem.rows["phase"].to_numpy(dtype=float))


def _waves(problem: GapProblem) -> Array:
    """Offset and harmonics of the phase (N, k) in each kind of reading.

    Two harmonics, or one where there are several kinds of readings.
    """
    phase, offsets = _phase(problem), channel_offsets(problem)
    forms = [np.ones_like(phase)]
    for order in (1, 2) if offsets.shape[1] == 1 else (1,):
        forms += [np.cos(order * phase), np.sin(order * phase)]
    return np.hstack([form[:, None] * offsets for form in forms])


def _direction(problem: GapProblem) -> Array:
    """Direction (N,) of each reading's run, +1 or -1; 0 where unknown."""
    if "direction" not in problem.rows.columns:
        return np.zeros(len(problem))
    direction = problem.rows["direction"].to_numpy(dtype=float)
    return np.asarray(np.sign(np.nan_to_num(direction)))
