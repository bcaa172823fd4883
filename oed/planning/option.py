"""A catalogue of measurements to plan with.

An option is a measurement as it can be ordered: set-ups to mount, candidate readings in
them, what it costs, and how far the instrument can follow a machine that is not yet
calibrated (a ball bar has +-1 mm of travel).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property

import numpy as np

from oed.arrays import Array, Index
from oed.design import candidates
from oed.design.candidates import Candidates
from oed.instrument import Setup
from oed.machine import Machine
from oed.measurement import Measurement, Series


@dataclasses.dataclass(frozen=True, eq=False)
class Option:
    """One measurement of the catalogue.

    candidates  readings (or whole runs) over its own set-ups, in units of tolerance and
                noise
    counts      numbers of candidates worth trying, ascending; no plan takes more than
                the last
    mounting    time to mount all its set-ups, s;  seconds (C,) time of each candidate
    travel      m or rad: a reading is lost where it lies farther from the expected one
                (None: any range)
    price       of doing it, in money, beside the time; operator: who can do it
    """

    name: str
    candidates: Candidates
    counts: tuple[int, ...]
    mounting: float
    seconds: Array
    travel: float | None = None
    price: float = 0.0
    operator: str = ""

    @property
    def measurement(self) -> Measurement:
        """Its set-ups on the machine."""
        return self.candidates.measurement

    @property
    def machine_columns(self) -> int:
        """Columns of the blocks that are the machine's parameters; the others are the
        option's own unknowns.
        """
        return int(
            self.measurement.free[: len(self.measurement.machine.parameters)].sum()
        )

    @cached_property
    def first_channels(self) -> Array:
        """Slopes (readings, free) of every reading's first channel, SI over tolerances:
        what the travel is about.
        """
        measurement, places, start = self.measurement, [], 0
        for s in self.series:
            channels = len(measurement.setups[s.setup].sigma)
            places.append(start + channels * np.arange(len(s)))
            start += channels * len(s)
        rows = (
            measurement.jacobian(self.series, measurement.nominal)
            * measurement.tolerance
        )
        return np.asarray(rows[np.concatenate(places)][:, measurement.free])

    @property
    def series(self) -> tuple[Series, ...]:
        """All candidate readings."""
        return self.candidates.series

    def taken(self, chosen: Index) -> tuple[Series, ...]:
        """The chosen candidates' readings."""
        return self.candidates.take(chosen)


def option(
    machine: Machine,
    setups: Sequence[Setup],
    series: Sequence[Series],
    *,
    name: str,
    counts: Sequence[int],
    travel: float | None = None,
    whole_runs: bool = False,
    mounting: float | None = None,
    reading: float | None = None,
    price: float = 0.0,
    operator: str = "",
) -> Option:
    """An option from set-ups and candidate readings; times (s) are the instruments'
    unless told.

    Raises ValueError where no count is between one and the number of candidates.
    """
    measurement = Measurement(machine, setups)
    found = candidates.of(
        measurement, series, measurement.nominal, "tolerance", whole_runs=whole_runs
    )
    possible = tuple(sorted({int(c) for c in counts if 1 <= c <= len(found)}))
    if not possible:
        raise ValueError(
            f"measurement {name}: none of {list(counts)} readings can be taken out of"
            f" {len(found)}"
        )
    seconds = (
        found.cost if reading is None else reading * found.members[:, 1].astype(float)
    )
    if not (seconds > 0.0).all():
        raise ValueError(
            f"measurement {name}: every reading takes some time, but"
            f" {float(seconds.min()):g} s are told"
        )
    return Option(
        name=name,
        candidates=found,
        counts=possible,
        mounting=float(found.setup_cost.sum()) if mounting is None else mounting,
        seconds=np.asarray(seconds, dtype=float),
        travel=travel,
        price=price,
        operator=operator,
    )
