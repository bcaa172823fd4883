"""Splits the covariance of readings into the errors that add up to it, run by run.

In units of the stated noise, with the names of `oed.noise.process`,

    C = s^2 [(1 - f) 1 + f R + sum of shared errors].

The stated noise is the instrument's. A scale s above 1 is noise beyond its statement.
What a run's readings share (level, stated shared error, a set-up seated anew, an error
carried along) are run-to-run errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.noise.process import Laws
from oed.noise.process_noise import dense_covariance
from oed.noise.structure import (
    KNOWN,
    LEVEL,
    RENEWED,
    STATED_LEVEL,
    STATED_SEAT,
    ReadingStructure,
)

#: names of the errors of readings
BEYOND = "noise beyond the stated one"
LEVELS = "run-to-run level"
SHARED = "error shared by a run"
SEAT = "set-up seated anew"
CARRIED = "error carried along a run"
#: kinds of the errors that a run shares, by name
SHARED_KINDS = {
    LEVELS: (LEVEL,),
    SHARED: (KNOWN, STATED_LEVEL),
    SEAT: (RENEWED, STATED_SEAT),
}


def instrument_source(name: str) -> str:
    """Name of the noise that an instrument states."""
    return f"noise of {name}"


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorsOfRun:
    """Covariance of the readings of one run, in units of the stated noise.

    members  (k,) the readings
    parts    {error: covariance (k, k), or variances (k,) where all are independent}
    """

    members: Index
    parts: Mapping[str, Array]

    def covariance(self, factors: Mapping[str, float]) -> Array:
        """Sum of the parts, each standard deviation times its factor (1 by default)."""
        terms = [factors.get(n, 1.0) ** 2 * part for n, part in self.parts.items()]
        return np.asarray(np.sum(terms, axis=0))

    def weigh(self, slopes: Array, factors: Mapping[str, float]) -> Array:
        """C^-1 times slopes (k, n)."""
        covariance = self.covariance(factors)
        if covariance.ndim == 1:
            return np.asarray(slopes / covariance[:, None])
        return np.asarray(np.linalg.solve(covariance, slopes), dtype=float)

    def between(self, name: str, weighed: Array) -> Array:
        """K^T C_j K (n, n) of one error, for K (k, n)."""
        part = self.parts.get(name)
        if part is None:
            return np.zeros((weighed.shape[1], weighed.shape[1]))
        applied = weighed * part[:, None] if part.ndim == 1 else part @ weighed
        return np.asarray(weighed.T @ applied)


def errors_of_runs(
    structure: ReadingStructure, laws: Laws, instruments: Sequence[str]
) -> tuple[ErrorsOfRun, ...]:
    """The runs of a structure under the first of the laws.

    instruments  (N,) name of the instrument of each reading
    """
    run = structure.run[structure.chain]
    names = np.asarray(instruments)
    return tuple(
        _errors_of_run(structure, laws, np.flatnonzero(run == number), names)
        for number in np.unique(run)
    )


def _errors_of_run(
    structure: ReadingStructure, laws: Laws, members: Index, instruments: np.ndarray
) -> ErrorsOfRun:
    scale = laws.scale[0, structure.group[members]]
    single = (1.0 - laws.carried[0]) * scale**2
    stated = np.minimum(single, 1.0)
    of_run = instruments[members]
    parts = {
        instrument_source(name): np.where(of_run == name, stated, 0.0)
        for name in dict.fromkeys(of_run.tolist())
    }
    if (single > 1.0).any():
        parts[BEYOND] = single - stated
    shared = _shared(structure, laws, members, scale)
    if not shared and laws.carried[0] == 0.0:
        return ErrorsOfRun(members, parts)
    matrices = {name: np.diag(variances) for name, variances in parts.items()} | shared
    carried = _dense(structure, laws, members) - np.sum(list(matrices.values()), axis=0)
    if laws.carried[0] > 0.0:
        matrices[CARRIED] = carried
    return ErrorsOfRun(members, matrices)


def _shared(
    structure: ReadingStructure, laws: Laws, members: Index, scale: Array
) -> dict[str, Array]:
    """Covariances (k, k) of what the readings of a run share."""
    shared: dict[str, Array] = {}
    errors = structure.columns[members] * laws.sizes[0, structure.kinds]
    errors *= scale[:, None]
    for name, kinds in SHARED_KINDS.items():
        columns = errors[:, np.isin(structure.kinds, kinds)]
        if columns.any():
            shared[name] = columns @ columns.T
    return shared


def _dense(structure: ReadingStructure, laws: Laws, members: Index) -> Array:
    """Covariance (k, k) of one run, as the noise model has it."""
    return dense_covariance(structure.take(members), laws)
