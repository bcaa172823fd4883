"""Noise of readings under one estimated law, whole or split into errors that add up to it.

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
from scipy import sparse

from oed.base.arrays import Array, Index, Mask
from oed.noise.covariance import FactoredNoise, Noise
from oed.noise.factor import Errors, LinearFactor, WideFactor
from oed.noise.process import Laws, Whitening, common_columns
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
COURSE = "course of the session"
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


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class LawNoise(FactoredNoise):
    """Noise of N readings under a law, SI.

    structure  of the readings
    law        the law, one of some laws
    """

    structure: ReadingStructure
    law: Laws

    def of_runs(self) -> tuple[Noise, Array]:
        """As in `Noise`: effects and the course apart."""
        structure, law = self.structure, self.law
        (columns,) = common_columns(structure, law)
        if not columns.size:
            return super().of_runs()
        alone = dataclasses.replace(law, course=np.zeros(len(law)))
        bare = dataclasses.replace(structure, effects=np.zeros((0, 0)))
        return noise_under(bare, alone), structure.restore(columns.T).T

    def draw(self, rng: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Draws (..., N)."""
        laws = self.law.take([0] * int(np.prod(shape[:-1])))
        errors = Whitening(self.structure, laws).draw(rng)
        return self.structure.restore(errors).reshape(shape)


def noise_under(structure: ReadingStructure, laws: Laws) -> LawNoise:
    """Noise of readings under the first of some laws, SI."""
    law = laws.take([0])
    shared = (structure.columns * law.sizes[0, structure.kinds]) ** 2
    sd = law.scale[0, structure.group] * np.sqrt(1.0 + shared.sum(axis=1))
    (common,) = common_columns(structure, law)
    if common.size:
        sd = np.sqrt(sd**2 + (common**2).sum(axis=1))
    alone = LinearFactor(errors_in_units(structure, law))
    factor: LinearFactor | WideFactor = alone
    if structure.has_effects:
        factor = WideFactor(alone, structure.restore(structure.effects.T).T)
    return LawNoise(structure.unit * sd, factor=factor, structure=structure, law=law)


def factor_of(structure: ReadingStructure, laws: Laws) -> LinearFactor:
    """Root of the covariance under the first of the laws, over the stated noise."""
    return LinearFactor(errors_of(structure, laws))


def errors_in_units(
    structure: ReadingStructure, laws: Laws, rows: Index | None = None
) -> Errors:
    """Errors as in `errors_of`, in the units of the readings and with their channels."""
    errors = errors_of(structure, laws, rows)
    order = errors.order
    if structure.decouple is None:
        return dataclasses.replace(errors, scale=errors.scale * structure.unit[order])
    unmix = sparse.csr_array(structure.decouple[order][:, order])
    return dataclasses.replace(errors, unmix=unmix)


def errors_of(
    structure: ReadingStructure, laws: Laws, rows: Index | None = None
) -> Errors:
    """Errors of readings under the first of the laws, in units of the stated noise.

    rows  (k,) readings that are taken, all by default

    Their shared columns are those of the structure, times their sizes. With a course all
    readings are one segment, and each run has columns of its own.
    """
    chain = structure.chain
    order = np.lexsort((structure.position, chain))
    if rows is not None:
        order = order[np.isin(order, rows)]
    ordered, position = chain[order], structure.position[order]
    first = np.diff(ordered, prepend=-1) > 0
    steps = np.diff(position, prepend=0.0)
    carried = np.full(len(order), laws.carried[0])
    decay = np.exp(-np.where(first, np.inf, steps) / laws.reach[0])
    new_run = np.diff(structure.run[ordered], prepend=-1) > 0
    starts = np.flatnonzero(new_run)
    shared = (structure.columns * laws.sizes[0, structure.kinds])[order]
    if structure.course.size and laws.course[0]:
        course = laws.course[0] * structure.course[order]
        shared = np.hstack([_by_run(shared, starts), course])
        starts = starts[:1]
    return Errors(
        order=order,
        starts=starts,
        decay=decay if carried.any() else np.zeros(len(order)),
        single=1.0 - carried,
        carried=carried,
        shared=shared,
        scale=laws.scale[0, structure.group][order],
    )


def _by_run(shared: Array, starts: Index) -> Array:
    """Columns (N, K) of errors that a run shares as columns (N, R K) of all readings."""
    count, kinds = shared.shape
    columns = np.zeros((count, len(starts), kinds))
    for number, start in enumerate(starts):
        end = starts[number + 1] if number + 1 < len(starts) else count
        columns[start:end, number] = shared[start:end]
    return columns.reshape(count, -1)


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
        carried = factors.get(CARRIED, 1.0) ** 2 * whole.carried
        changed = dataclasses.replace(
            whole,
            single=variance / whole.scale**2,
            carried=carried,
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
    names, whole = np.asarray(instruments), errors_of(structure, laws)
    scale = laws.scale[0, structure.group]
    single = (1.0 - laws.carried[0]) * scale**2
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
    if errors.whole.carried.any():
        by_reading[CARRIED] = np.ones(len(structure), dtype=bool)
    names: dict[str, None] = {}
    for number in np.unique(run):
        members = run == number
        names |= {n: None for n, has in by_reading.items() if has[members].any()}
    return tuple(names)
