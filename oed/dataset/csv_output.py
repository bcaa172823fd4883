"""Readings to a CSV file that `load` reads back; lengths in mm, angles in deg."""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from oed import csv_text
from oed.base import Array, consecutive_slices
from oed.dataset.columns import REQUIRED, SIGMA, ReadingsColumn, cell
from oed.dataset.data import ColumnLayout, Dataset
from oed.dataset.dialect import commented
from oed.measurement import Series


def to_csv(
    dataset: Dataset, comments: Callable[[Sequence[str]], Sequence[str]] | None = None
) -> str:
    """The text of a readings file.

    References of runs are rows of their own. Readings that are NaN give empty cells, to
    be filled in; where the joints are the measurement, these are the joints' cells.

    comments  lines above the header, from the names of the columns
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
            column = ReadingsColumn.of_covariate(stem)
            if column is not None:
                row[column.name] = cell(value, column.unit)
        if layout.implied and np.isnan(values[i]).all():
            row = _joint_cells(layout) | row
            yield row
            continue
        for k, channel in enumerate(layout.channels):
            row[ReadingsColumn.of(channel.name, channel.unit).name] = cell(
                values[i, k], channel.unit
            )
            if series.sigma is not None and np.isfinite(series.sigma[:, k]).any():
                name = ReadingsColumn.of(f"{SIGMA}{channel.name}", channel.unit).name
                row[name] = cell(series.sigma[i, k], channel.unit)
        yield row


def _joint_cells(layout: ColumnLayout) -> dict[str, str]:
    """Empty cells for the joints, which are recorded where a constraint holds."""
    return {ReadingsColumn.of(c.name, c.unit).name: "" for c in layout.joints}


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
    stated = map(ReadingsColumn.of_covariate, dataset.covariates.columns)
    covariates = [column.name for column in stated if column is not None]
    groups = [list(REQUIRED), pose, covariates, channels]
    return next((i, g.index(name)) for i, g in enumerate(groups) if name in g)
