"""Measurements which a plan can order: set-ups, candidate readings, times and travel.

An instrument with travel (a ball bar: +-1 mm) reads a machine only while the machine is
close to where the controller believes it to be.
"""

import dataclasses
import math
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from oed.base import Array, Index
from oed.design import Candidates, Nuisances
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.model import Machine


@dataclasses.dataclass(frozen=True, eq=False)
class Option:
    """One measurement of the catalogue."""

    name: str
    #: readings or whole runs (C), in units of tolerance and noise. Their columns: the
    #: machine's, effects beside the geometry, set-ups', and errors that runs share
    candidates: Candidates
    #: numbers of candidates to try, ascending; the last is the limit
    counts: tuple[int, ...]
    mounting_seconds: float  #: time to mount all set-ups, s
    candidate_seconds: Array  #: time of each candidate, (C,), s
    #: largest distance between a reading and its expected value, m or rad, at which it
    #: is still captured; infinite: unlimited
    travel: float = math.inf
    price: float = 0.0  #: cost in money, in addition to the time
    operator: str = ""  #: who can carry it out

    @property
    def limits_travel(self) -> bool:
        """Whether readings can be lost beyond the travel."""
        return math.isfinite(self.travel)

    @property
    def measurement(self) -> Measurement:
        """The set-ups on the machine."""
        return self.candidates.measurement

    @property
    def machine_columns(self) -> int:
        """Number of columns of the blocks that belong to the machine, with its effects."""
        return _machine_parameters(self.measurement) + self.effects

    @property
    def effects(self) -> int:
        """Number of effects beside the geometry, after the machine's parameters."""
        return self.candidates.nuisance_columns

    @property
    def setup_columns(self) -> int:
        """Number of free parameters of the set-ups."""
        free = int(self.measurement.free.sum())
        return free - _machine_parameters(self.measurement)

    @property
    def parameter_columns(self) -> Index:
        """Columns of the blocks that belong to parameters, in the measurement's order."""
        columns = np.arange(int(self.measurement.free.sum()))
        columns[_machine_parameters(self.measurement) :] += self.effects
        return columns

    @property
    def unknowns(self) -> int:
        """Number of all columns: machine, set-ups, and errors that a run shares."""
        return int(self.candidates.blocks.shape[2])

    @cached_property
    def first_channel_jacobian(self) -> Array:
        """Jacobian (readings, n) of first channels, SI over tolerance."""
        measurement, nuisances = self.measurement, self.candidates.nuisances
        jacobian = self.jacobian[self._first_numbers] * measurement.tolerance
        of_parameters = jacobian[:, measurement.free]
        if nuisances is None:
            return of_parameters
        of_effects = nuisances.columns[self._first_numbers]
        machine_count = _machine_parameters(measurement)
        parts = [
            of_parameters[:, :machine_count],
            of_effects,
            of_parameters[:, machine_count:],
        ]
        return np.hstack(parts)

    @cached_property
    def weight(self) -> Array:
        """Share (numbers,) of their weight that scatter by effects leaves."""
        nuisances = self.candidates.nuisances
        if nuisances is None:
            return np.ones(len(self.nominal_readings))
        return nuisances.weight(self.measurement.sigma(self.series))

    @cached_property
    def jacobian(self) -> Array:
        """Jacobian (numbers, p), SI, of all numbers that candidates read, at nominal."""
        return self.measurement.jacobian(self.series, self.measurement.nominal)

    @cached_property
    def nominal_readings(self) -> Array:
        """All numbers (numbers,) that candidates read of the nominal machine, SI."""
        return self.measurement.readings(self.series, self.measurement.nominal)

    def numbers_of(self, chosen: Index) -> Index:
        """Which of all numbers the chosen candidates read, in order of `series_of`."""
        first, count = self.candidates.members[chosen].T
        ends = np.cumsum([len(s) for s in self.series])
        by_series = np.argsort(np.searchsorted(ends, first, "right"), kind="stable")
        reading = _ranges(first[by_series], count[by_series])
        return _ranges(self._first_numbers[reading], self._channels[reading])

    @cached_property
    def _channels(self) -> Index:
        setups = self.measurement.setups
        counts = [np.full(len(s), len(setups[s.setup].sigma)) for s in self.series]
        return np.concatenate(counts)

    @cached_property
    def _first_numbers(self) -> Index:
        """Position of each reading's first channel among all numbers."""
        return np.cumsum(self._channels) - self._channels

    def without_effects(self) -> "Option":
        """The same measurement of a machine without effects beside the geometry."""
        pool = Candidates.build(
            self.measurement,
            self.series,
            self.measurement.nominal,
            "tolerance",
            whole_runs=bool((self.candidates.members[:, 1] > 1).any()),
        )
        return dataclasses.replace(self, candidates=pool)

    @property
    def series(self) -> tuple[Series, ...]:
        """All candidate readings."""
        return self.candidates.series

    def series_of(self, chosen: Index) -> tuple[Series, ...]:
        """The readings of the chosen candidates."""
        return self.candidates.readings_of(chosen)

    def shortest_seconds(self, count: int) -> float:
        """Time (s) of the `count` shortest candidates, without mounting."""
        return float(np.sort(self.candidate_seconds)[:count].sum())

    @property
    def least_seconds(self) -> float:
        """Time (s) of the shortest stage with this measurement, mounting included."""
        return self.mounting_seconds + self.shortest_seconds(self.counts[0])

    def affordable_counts(self, seconds: float) -> list[int]:
        """Counts to try that `seconds` pay for, mounting included, and the largest."""
        time = np.cumsum(np.sort(self.candidate_seconds))
        reading_time = seconds - self.mounting_seconds
        affordable = int(np.searchsorted(time, reading_time, side="right"))
        largest = min(affordable, self.counts[-1])
        if largest < self.counts[0]:
            return []
        return sorted({*(c for c in self.counts if c <= affordable), largest})


def _machine_parameters(measurement: Measurement) -> int:
    """Number of free parameters of the machine."""
    return int(measurement.free[: len(measurement.machine.parameters)].sum())


def _effects_after_machine(pool: Candidates) -> Candidates:
    """Candidates whose nuisances come after the machine's columns."""
    total = pool.blocks.shape[2]
    machine_count = _machine_parameters(pool.measurement)
    first = total - pool.nuisance_columns
    order = np.r_[:machine_count, first:total, machine_count:first]
    return dataclasses.replace(
        pool,
        blocks=pool.blocks[:, :, order],
        prior_information=pool.prior_information[np.ix_(order, order)],
    )


def _ranges(first: Index, count: Index) -> Index:
    """The numbers from each of `first` on, `count` of each, one range after the other."""
    starts = np.cumsum(count) - count
    return np.repeat(first - starts, count) + np.arange(count.sum())


def build_option(
    machine: Machine,
    setups: Sequence[Setup],
    series: Sequence[Series],
    *,
    name: str,
    counts: Sequence[int],
    travel: float = math.inf,
    whole_runs: bool = False,
    mounting_seconds: float | None = None,
    reading_seconds: float | None = None,
    price: float = 0.0,
    operator: str = "",
    nuisances: Nuisances | None = None,
) -> Option:
    """Build an option from set-ups and candidate readings.

    nuisances  effects beside the geometry; knowledge of them is carried from stage to
               stage

    Without `mounting_seconds` or `reading_seconds`, the instruments' times count.

    Raises ValueError where no count lies between one and the number of candidates, or
    where a candidate takes no time.
    """
    measurement = Measurement(machine, setups)
    pool = Candidates.build(
        measurement,
        series,
        measurement.nominal,
        "tolerance",
        whole_runs=whole_runs,
        nuisances=nuisances,
    )
    pool = _effects_after_machine(pool)
    possible = tuple(sorted({int(c) for c in counts if 1 <= c <= len(pool)}))
    if not possible:
        raise ValueError(
            f"measurement {name}: no count in {list(counts)} lies between 1 and the"
            f" {len(pool)} candidates"
        )
    seconds = pool.cost
    if reading_seconds is not None:
        seconds = reading_seconds * pool.members[:, 1].astype(float)
    if not (seconds > 0.0).all():
        raise ValueError(
            f"measurement {name}: every reading takes some time, but one takes"
            f" {float(seconds.min()):g} s"
        )
    if mounting_seconds is None:
        mounting_seconds = float(pool.setup_cost.sum())
    return Option(
        name=name,
        candidates=pool,
        counts=possible,
        mounting_seconds=mounting_seconds,
        candidate_seconds=np.asarray(seconds, dtype=float),
        travel=travel,
        price=price,
        operator=operator,
    )
