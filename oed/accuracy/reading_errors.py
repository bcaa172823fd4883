"""Errors of readings that add up to their noise under a law, each with a name.

The stated noise is the instrument's. A scale above 1 is noise beyond its statement. What
a run's readings share (level, stated shared error, a set-up seated anew, an error carried
along) are run-to-run errors.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.base import Array, Index, Mask
from oed.noise import Errors, Laws, LinearFactor, ReadingStructure, SharedError

#: names of the errors of readings
BEYOND = "noise beyond the stated one"
COURSE = "course of the session"
LEVELS = "run-to-run level"
SHARED = "error shared by a run"
SEAT = "set-up seated anew"
CARRIED = "error carried along a run"
#: kinds of the errors that a run shares, by name
SHARED_KINDS = {
    LEVELS: (SharedError.LEVEL,),
    SHARED: (SharedError.KNOWN, SharedError.STATED_LEVEL),
    SEAT: (SharedError.RENEWED, SharedError.STATED_SEAT),
}


def instrument_source(name: str) -> str:
    """Name of the noise that an instrument states."""
    return f"noise of {name}"


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingErrors:
    """Errors of N readings that add up, each with a factor on its standard deviation.

    whole      all errors together, in units of the stated noise
    variances  {error: (N,)} of errors that are independent
    shared     {error: (K,) columns of `whole.shared`}
    names      of all errors
    """

    whole: Errors
    variances: Mapping[str, Array]
    shared: Mapping[str, Index]
    names: tuple[str, ...]

    def factor(self, factors: Mapping[str, float]) -> LinearFactor:
        """Root of the sum, each standard deviation times its factor (1 by default)."""
        whole = self.whole
        terms = [factors.get(n, 1.0) ** 2 * v for n, v in self.variances.items()]
        variance = np.sum(terms, axis=0)[whole.order]
        amounts = np.ones(whole.shared.shape[1])
        for name, columns in self.shared.items():
            amounts[columns] = factors.get(name, 1.0)
        carried = factors.get(CARRIED, 1.0) ** 2 * whole.correlated
        changed = dataclasses.replace(
            whole,
            single=variance / whole.scale**2,
            correlated=carried,
            decay=whole.decay if carried.any() else np.zeros(len(whole.decay)),
            shared=(whole.shared * amounts)[:, amounts > 0.0],
        )
        return LinearFactor(changed)

    def whiten(self, values: Array, factors: Mapping[str, float]) -> Array:
        """W Y (N, m), in an order of its own, with W C W^T = 1, for Y (N, m)."""
        return self.factor(factors).whiten(values)

    def weigh(self, values: Array, factors: Mapping[str, float]) -> Array:
        """C^-1 Y (N, m), for Y (N, m)."""
        return self.factor(factors).precision(values)

    def between(self, name: str, weighed: Array) -> Array:
        """K^T C_j K (n, n) of one independent error, for K (N, n)."""
        return weighed.T @ (weighed * self.variances[name][:, None])


def errors_of_readings(
    structure: ReadingStructure, laws: Laws, instruments: Sequence[str]
) -> ReadingErrors:
    """Errors of the readings of a structure under the first of the laws.

    instruments  (N,) name of the instrument of each reading
    """
    names, whole = np.asarray(instruments), laws.errors(structure)
    scale = laws.scale[0, structure.group]
    single = (1.0 - laws.correlated[0]) * scale**2
    stated = np.minimum(single, 1.0)
    variances = {
        instrument_source(name): np.where(names == name, stated, 0.0)
        for name in dict.fromkeys(instruments)
    }
    if (single > 1.0).any():
        variances[BEYOND] = single - stated
    errors = ReadingErrors(
        whole, variances, _columns_by_name(structure, laws, whole), ()
    )
    return dataclasses.replace(errors, names=_names(structure, errors))


def _columns_by_name(
    structure: ReadingStructure, laws: Laws, whole: Errors
) -> dict[str, Index]:
    """Columns of `whole.shared` that each shared error has."""
    terms = len(structure.course.T) if laws.course[0] else 0
    of_runs = whole.shared.shape[1] - terms
    repeats = of_runs // max(len(structure.kinds), 1)
    kinds = np.tile(structure.kinds, repeats)
    amounts = laws.sizes[0, kinds]
    columns = {
        name: np.flatnonzero(np.isin(kinds, some) & (amounts > 0.0))
        for name, some in SHARED_KINDS.items()
    }
    columns[COURSE] = np.arange(of_runs, of_runs + terms)
    return {name: some for name, some in columns.items() if some.size}


def _names(structure: ReadingStructure, errors: ReadingErrors) -> tuple[str, ...]:
    """Names of the errors, in the order in which runs have them first."""
    run = structure.run[structure.chain]
    by_reading: dict[str, Mask] = {
        name: np.asarray(v > 0.0) for name, v in errors.variances.items()
    }
    for name, columns in errors.shared.items():
        has = np.zeros(len(structure), dtype=bool)
        has[errors.whole.order] = errors.whole.shared[:, columns].any(axis=1)
        by_reading[name] = has
    if errors.whole.correlated.any():
        by_reading[CARRIED] = np.ones(len(structure), dtype=bool)
    names: dict[str, None] = {}
    for number in np.unique(run):
        members = run == number
        names |= {n: None for n, has in by_reading.items() if has[members].any()}
    return tuple(names)
