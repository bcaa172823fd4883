"""The readings of a session in SI: series, values and covariates."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
import pandas as pd

from oed.base import Array
from oed.dataset.columns import ReadingsColumn
from oed.instrument import Channel, Setup
from oed.measurement import Measurement, Series
from oed.model import Coordinate, Machine


@dataclasses.dataclass(frozen=True, slots=True)
class ColumnLayout:
    """Columns of the readings of one set-up.

    command    commanded coordinates
    joints     joints, where these were recorded instead
    channels   channels of the instrument
    reference  whether the first row of a run is its reference
    implied    whether the joints, as recorded, are the measurement: a closure, a contact,
               a constraint
    """

    command: tuple[Coordinate, ...]
    joints: tuple[Coordinate, ...]
    channels: tuple[Channel, ...]
    reference: bool
    implied: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dataset:
    """Readings in SI. Raises ValueError where the numbers of readings do not fit.

    series      one a set-up as read from files; a plan may have more
    y           (N,) readings as in `Measurement.readings`: series after series,
                channels innermost
    covariates  one row a reading of the series, in their order: setup, run, order; what
                the file gave of time, direction, feed, payload, temp_<body>,
                tension_<k> and repeat, SI, NaN where unknown; and the row in the file
    layouts     columns of each set-up
    dropped     number of rows whose reading was not taken
    columns     columns of the files, by stem; empty for a plan
    """

    series: tuple[Series, ...]
    y: Array
    covariates: pd.DataFrame
    layouts: Mapping[str, ColumnLayout]
    dropped: int = 0
    columns: Mapping[str, ReadingsColumn] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        values, rows = sum(self._sizes()), sum(len(s) for s in self.series)
        if self.y.shape != (values,) or len(self.covariates) != rows:
            raise ValueError(
                f"{values} readings are planned, {self.y.shape} and"
                f" {len(self.covariates)} rows given"
            )

    def __len__(self) -> int:
        return len(self.y)

    @property
    def setups(self) -> tuple[str, ...]:
        """Names of the set-ups, in order."""
        return tuple(dict.fromkeys(s.setup for s in self.series))

    @property
    def spans(self) -> tuple[slice, ...]:
        """Where the readings of each series are in y."""
        return consecutive(self._sizes())

    def take(self, setups: Iterable[str]) -> Dataset:
        """The readings of these set-ups, in this dataset's order.

        Raises KeyError for a set-up without readings.
        """
        wanted = set(setups)
        absent = wanted - set(self.setups)
        if absent:
            raise KeyError(
                f"there are no readings of {sorted(absent)}; there are"
                f" {list(self.setups)}"
            )
        series, values = [], [np.empty(0)]
        for s, span in zip(self.series, self.spans, strict=True):
            if s.setup in wanted:
                series.append(s)
                values.append(self.y[span])
        rows = self.covariates["setup"].isin(wanted)
        return dataclasses.replace(
            self,
            series=tuple(series),
            y=np.concatenate(values),
            covariates=self.covariates[rows].reset_index(drop=True),
            layouts={s.setup: self.layouts[s.setup] for s in series},
        )

    def _sizes(self) -> list[int]:
        """Number of values of each series."""
        return [len(s) * len(self.layouts[s.setup].channels) for s in self.series]


def consecutive(sizes: Sequence[int]) -> tuple[slice, ...]:
    """Slices of these sizes, one after the other."""
    ends = np.cumsum(sizes, dtype=int).tolist()
    return tuple(slice(end - size, end) for size, end in zip(sizes, ends, strict=True))


def column_layout(machine: Machine, setup: Setup) -> ColumnLayout:
    """Columns of a set-up's readings on a machine."""
    instrument = setup.instrument
    return ColumnLayout(
        command=machine.command,
        joints=machine.joints,
        channels=instrument.channels,
        reference=instrument.reference == "run",
        implied=instrument.implied is not None,
    )


def column_layouts(
    measurement: Measurement, series: Sequence[Series]
) -> dict[str, ColumnLayout]:
    """Columns of the set-ups of these series, by name."""
    setups = dict.fromkeys(s.setup for s in series)
    machine = measurement.machine
    return {n: column_layout(machine, measurement.setups[n]) for n in setups}


def from_series(
    series: Sequence[Series],
    y: Array,
    measurement: Measurement,
    covariates: pd.DataFrame | None = None,
) -> Dataset:
    """Make a dataset of planned series.

    y           (N,) readings, SI, NaN where not taken
    covariates  one row a reading

    The order counts within each run. Where several series of one set-up use a run name,
    the later ones get a number.
    """
    series = _with_distinct_runs(series)
    layouts = column_layouts(measurement, series)
    frames = []
    for s in series:
        run = s.run.astype(object)
        frames.append(pd.DataFrame({"setup": s.setup, "run": run}))
    rows = pd.concat(frames, ignore_index=True)
    first = np.array([2 if layouts[name].reference else 1 for name in rows["setup"]])
    count = rows.groupby(["setup", "run"], sort=False).cumcount()
    rows["order"] = count.to_numpy() + first
    if covariates is not None:
        rows = rows.join(covariates.reset_index(drop=True))
    values = np.asarray(y, dtype=float)
    return Dataset(series=series, y=values, covariates=rows, layouts=layouts)


def _with_distinct_runs(series: Sequence[Series]) -> tuple[Series, ...]:
    """Series with a number added to run names that an earlier series uses."""
    used: set[tuple[str, str]] = set()
    distinct = []
    for s in series:
        number, run = 1, s.run
        while used & _runs(s.setup, run):
            number += 1
            run = np.array([f"{name} ({number})" for name in s.run], dtype=np.str_)
        used |= _runs(s.setup, run)
        distinct.append(dataclasses.replace(s, run=run))
    return tuple(distinct)


def _runs(setup: str, run: Iterable[str]) -> set[tuple[str, str]]:
    return {(setup, str(name)) for name in run}
