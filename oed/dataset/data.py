"""The readings of a session in SI: series, values, covariates, and their CSV file."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oed import csv_text
from oed.base import Array, consecutive_slices
from oed.dataset.columns import REQUIRED, SIGMA, ReadingsColumn, cell
from oed.dataset.dialect import commented
from oed.instrument import Channel, Setup
from oed.measurement import Measurement, Series
from oed.model import Coordinate, Machine

if TYPE_CHECKING:
    import pandas as pd

# A digest of each reading, by which a session is known again in any order of rows and columns.

#: share of the smaller of two sessions that is equal in both where they are the same
SAME_SHARE = 0.9
#: bytes of a digest: two of a million readings share one by chance in 0.2 % of sessions
DIGEST_BYTES = 6


def reading_digests(
    series: Sequence[Series], y: Array, setups: Mapping[str, Setup]
) -> list[str]:
    """Sorted digests of readings y (N,), SI, that were taken: of pose or recorded
    joints, channel and value, to nine digits. A second file of a session may have other
    names, order, times and covariates.
    """
    distinct: set[str] = set()
    start = 0
    for s in series:
        channels = [c.name for c in setups[s.setup].instrument.channels]
        end = start + len(s) * len(channels)
        distinct.update(_series_digests(s, y[start:end].reshape(len(s), -1), channels))
        start = end
    return sorted(distinct)


def _series_digests(
    series: Series, values: Array, channels: Sequence[str]
) -> Iterator[str]:
    """Digests of values (n, channels) of one series."""
    pairs = zip(series.command, series.q, strict=True)
    poses = [_text(q if np.isnan(command).any() else command) for command, q in pairs]
    for index, row in zip(series.index, values, strict=True):
        text_of_poses = ";".join(poses[k] for k in index)
        for channel, value in zip(channels, row, strict=True):
            if np.isfinite(value):
                key = f"{text_of_poses}|{channel}|{_text([value])}"
                yield hashlib.blake2b(
                    key.encode(), digest_size=DIGEST_BYTES
                ).hexdigest()


def _text(values: Sequence[float] | Array) -> str:
    """Numbers to nine digits; zero has no sign."""
    return ",".join(f"{value + 0.0:.9g}" for value in values)


def is_counted(readings: Collection[str], others: Collection[str]) -> bool:
    """Whether two sets of digests are of the same session, or one is part of the other."""
    return shared(readings, others) >= SAME_SHARE


def shared(readings: Collection[str], others: Collection[str]) -> float:
    """Share of the smaller of two sets of digests that both have; 0 for an empty one."""
    smaller = min(len(readings), len(others))
    return len(set(readings) & set(others)) / smaller if smaller else 0.0


# Rows of readings files: a number, and the file where there are several.

#: column of the covariates that states the file of each reading, where there are several
FILE_COLUMN = "file"


@dataclasses.dataclass(frozen=True, order=True, slots=True)
class FileRow:
    """A row of one of several files, in their order; as text it names the file."""

    place: int
    row: int
    file: str

    def __int__(self) -> int:
        return self.row

    def __str__(self) -> str:
        return f"{self.row} of {self.file}"


Row = int | FileRow  #: a row of the only file, or of one of several


def named_rows(covariates: pd.DataFrame) -> Array:
    """The row (n,) of each reading, with its file where covariates state several."""
    rows = covariates["row"].to_numpy()
    if FILE_COLUMN not in covariates:
        return np.asarray(rows)
    import pandas as pd

    files = pd.Categorical(covariates[FILE_COLUMN])
    named = [
        FileRow(int(number), int(row), str(file))
        for number, row, file in zip(files.codes, rows, files, strict=True)
    ]
    return np.array(named, dtype=object)


def short_names(files: Sequence[str]) -> list[str]:
    """The files' names without their folders, where these differ."""
    names = [file.replace("\\", "/").rpartition("/")[2] for file in files]
    return names if len({*names}) == len(files) else list(files)


@dataclasses.dataclass(frozen=True, slots=True)
class ColumnLayout:
    """Columns of the readings of one set-up."""

    command: tuple[Coordinate, ...]  #: commanded coordinates
    joints: tuple[Coordinate, ...]  #: joints, where these were recorded instead
    channels: tuple[Channel, ...]  #: channels of the instrument
    reference: bool  #: whether the first row of a run is its reference
    #: whether the joints, as recorded, are the measurement: a closure, a contact, a
    #: constraint
    implied: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Dataset:
    """Readings in SI. Raises ValueError where the numbers of readings do not fit."""

    series: tuple[Series, ...]  #: one a set-up as read from files; a plan may have more
    #: (N,) readings as in `Measurement.readings`: series after series, channels
    #: innermost
    y: Array
    #: one row a reading of the series, in their order: setup, run, order; what the file
    #: gave of time, direction, feed, payload, temp_<body>, tension_<k> and repeat, SI,
    #: NaN where unknown; and the row in the file
    covariates: pd.DataFrame
    layouts: Mapping[str, ColumnLayout]  #: columns of each set-up
    dropped: int = 0  #: number of rows whose reading was not taken
    #: columns of the files, by stem; empty for a plan
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
        return consecutive_slices(self._sizes())

    def take(self, setups: Iterable[str]) -> Dataset:
        """The readings of these set-ups, in this order. Raises KeyError."""
        names = set(setups)
        absent = names - set(self.setups)
        if absent:
            raise KeyError(
                f"there are no readings of {sorted(absent)}; there are {list(self.setups)}"
            )
        series, values = [], [np.empty(0)]
        for s, span in zip(self.series, self.spans, strict=True):
            if s.setup in names:
                series.append(s)
                values.append(self.y[span])
        rows = self.covariates["setup"].isin(names)
        return dataclasses.replace(
            self,
            series=tuple(series),
            y=np.concatenate(values),
            covariates=self.covariates[rows].reset_index(drop=True),
            layouts={s.setup: self.layouts[s.setup] for s in series},
        )

    def _sizes(self) -> list[int]:
        return [len(s) * len(self.layouts[s.setup].channels) for s in self.series]


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
    """A dataset of planned series, y (N,), SI, or NaN where not taken, with a row of
    covariates a reading; a run's name that an earlier series of the set-up has gets a
    number.
    """
    import pandas as pd  # digests of readings need no tables

    series = _distinct_runs(series)
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


def _distinct_runs(series: Sequence[Series]) -> tuple[Series, ...]:
    """Series with a number added to run names that an earlier series uses."""
    used: set[tuple[str, str]] = set()
    distinct = []
    for s in series:
        number = 1
        run = s.run
        while used & _runs(s.setup, run):
            number += 1
            run = np.array([f"{name} ({number})" for name in s.run], dtype=np.str_)
        used |= _runs(s.setup, run)
        distinct.append(dataclasses.replace(s, run=run))
    return tuple(distinct)


def _runs(setup: str, run: Iterable[str]) -> set[tuple[str, str]]:
    return {(setup, str(name)) for name in run}


def to_csv(
    dataset: Dataset, comments: Callable[[Sequence[str]], Sequence[str]] | None = None
) -> str:
    """The text of a readings file below `comments` on its columns' names. References of
    runs are rows of their own; readings that are NaN, or joints in their stead, are
    empty cells.
    """
    rows: list[dict[str, str]] = []
    lines = consecutive_slices([len(s) for s in dataset.series])
    for s, span, line in zip(dataset.series, dataset.spans, lines, strict=True):
        values = dataset.y[span].reshape(len(s), -1)
        covariates = dataset.covariates.iloc[line].to_dict("records")
        layout = dataset.layouts[s.setup]
        rows += _rows(s, values, covariates, layout)
    header = dict.fromkeys(name for row in rows for name in row)
    names = sorted(header, key=lambda name: _rank(name, dataset))
    above = () if comments is None else comments(names)
    return commented(above) + csv_text.of_tables(names, rows)


def _rows(
    series: Series,
    values: Array,
    covariates: list[dict[Any, Any]],
    layout: ColumnLayout,
) -> Iterator[dict[str, str]]:
    """Rows of a series with values (n, channels), by column name."""
    referenced: set[str] = set()
    for i, covariate in enumerate(covariates):
        run, order = str(covariate["run"]), int(covariate["order"])
        if layout.reference and run not in referenced:
            referenced.add(run)
            labels = _labels(series.setup, run, order - 1)
            yield labels | _pose(series, series.index[i, 1], layout)
        row = _labels(series.setup, run, order)
        row |= _pose(series, series.index[i, 0], layout)
        for stem, value in covariate.items():
            column = ReadingsColumn.from_covariate(stem)
            if column is not None:
                row[column.name] = cell(value, column.unit)
        if layout.implied and np.isnan(values[i]).all():
            # the joints are recorded where a constraint holds
            names = [ReadingsColumn.of(c.name, c.unit).name for c in layout.joints]
            yield dict.fromkeys(names, "") | row
            continue
        for k, channel in enumerate(layout.channels):
            row[ReadingsColumn.of(channel.name, channel.unit).name] = cell(
                values[i, k], channel.unit
            )
            if series.sigma is not None and np.isfinite(series.sigma[:, k]).any():
                name = ReadingsColumn.of(f"{SIGMA}{channel.name}", channel.unit).name
                row[name] = cell(series.sigma[i, k], channel.unit)
        yield row


def _labels(setup: str, run: str, order: int) -> dict[str, str]:
    return {"setup": setup, "run": run, "order": str(order)}


def _pose(series: Series, k: int, layout: ColumnLayout) -> dict[str, str]:
    """Command of pose k of a series, or its joints where these were recorded."""
    coordinates, values = layout.command, series.command[k]
    if np.isnan(values).any():
        coordinates, values = layout.joints, series.q[k]
    return {
        ReadingsColumn.of(c.name, c.unit).name: cell(value, c.unit)
        for c, value in zip(coordinates, values, strict=True)
    }


def _rank(name: str, dataset: Dataset) -> tuple[int, int]:
    """Place of a column in the contract's order: labels, pose, covariates, readings."""
    pose, channels = [], []
    for layout in dataset.layouts.values():
        pose += [
            ReadingsColumn.of(c.name, c.unit).name
            for c in (*layout.command, *layout.joints)
        ]
        for c in layout.channels:
            names = c.name, f"{SIGMA}{c.name}"
            channels += [ReadingsColumn.of(name, c.unit).name for name in names]
    stated = map(ReadingsColumn.from_covariate, dataset.covariates.columns)
    covariates = [column.name for column in stated if column is not None]
    groups = [list(REQUIRED), pose, covariates, channels]
    return next((i, g.index(name)) for i, g in enumerate(groups) if name in g)
