"""Runs an entry of the board: fit, blind prediction, baselines, readings needed."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from benchmarks.real_data.baselines import (
    Figures,
    held_out_rms,
    plain_least_squares,
)
from benchmarks.real_data.entries import STUDIES, Entry
from oed.base import Array
from oed.dataset import Dataset
from oed.estimation import identify
from oed.measurement import Measurement, Series
from oed.result import HeldOutSection, StudyResult
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.importers import import_files
from pkm_studies.resolve import resolve

#: shares of the fitted readings that are tried, and the loss that counts as none
SHARES, LOSS = (0.25, 0.5, 0.75), 1.1


@dataclasses.dataclass(frozen=True)
class Row:
    """A kind of held-out readings, in their fine unit; `needed` of `fitted` readings."""

    blind: HeldOutSection
    nominal: float
    least_squares: float
    fitted: int
    needed: int


@dataclasses.dataclass(frozen=True)
class Outcome:
    """An entry that ran. Without held-out readings it has no rows."""

    entry: Entry
    result: StudyResult
    rows: list[Row]


def run(entry: Entry, data: Path, work: Path) -> Outcome:
    """Run an entry with the data folder; files go to `work`."""
    study = _study(entry, data, work)
    result = stages.run_study(study, work / "out")
    rows = list(_rows(study, result)) if result.held_out else []
    return Outcome(entry, result, rows)


def _study(entry: Entry, data: Path, work: Path) -> studies.Study:
    """The study of an entry without sampling and report."""
    if entry.file:
        files = [data / entry.folder / entry.file]
        path, _ = import_files("klipper", files, work, name="printer")
        study = studies.load(path)
    else:
        study = studies.load(STUDIES / f"{entry.study}.study.toml")
        folder = str((data / entry.folder).resolve())
        readings = msgspec.structs.replace(study.readings, path=folder)
        study = msgspec.structs.replace(study, readings=readings)
    posterior = msgspec.structs.replace(study.posterior, enabled=False)
    report = msgspec.structs.replace(study.report, html=False, pdf=False)
    return msgspec.structs.replace(study, posterior=posterior, report=report)


def _rows(study: studies.Study, result: StudyResult) -> Iterator[Row]:
    """The held-out readings, with what others leave of them."""
    machine = resolve(study)
    measurement = machine.measurement_with(machine.setups)
    data = machine.dataset
    assert data is not None
    blind = list(dict.fromkeys(section.name for section in result.held_out))
    held_out = data.take(blind)
    fitted = data.take([name for name in _fitted(study, data) if name not in blind])
    nominal = held_out_rms(measurement, held_out, measurement.nominal)
    plain = plain_least_squares(measurement, fitted)
    squares = held_out_rms(measurement, held_out, plain)
    needed = _needed(study, measurement, fitted, held_out)
    for section in result.held_out:
        key = (section.name, section.channel)
        count = len(fitted.y)
        yield Row(section, nominal[key], squares[key], count, needed[key])


def _fitted(study: studies.Study, data: Dataset) -> list[str]:
    """Set-ups whose readings are fitted."""
    chosen = study.readings.fit
    return list(data.setups) if chosen is None else list(chosen)


def _needed(
    study: studies.Study, measurement: Measurement, fitted: Dataset, held_out: Dataset
) -> dict[tuple[str, str], int]:
    """Readings with which the prediction is as good as with all, by kind of reading.

    The smallest of some shares of each set-up's runs or rows, evenly chosen.
    """
    estimated = bool(study.noise.estimate)
    figures: dict[int, Figures] = {}
    for share in (*SHARES, 1.0):
        series, y = [], []
        for part in _each(measurement, fitted):
            taken, values = _share(part, share)
            series.append(taken)
            y.append(values)
        fit = identify(measurement, series, np.concatenate(y), estimate_noise=estimated)
        figures[len(fit.residuals)] = held_out_rms(measurement, held_out, fit.theta)
    best = figures[max(figures)]
    return {
        key: min(n for n, f in figures.items() if f[key] <= LOSS * best[key])
        for key in best
    }


class _Part(NamedTuple):
    """A series with its readings (n, channels)."""

    series: Series
    y: Array


def _each(measurement: Measurement, data: Dataset) -> Iterator[_Part]:
    start = 0
    for series in data.series:
        channels = len(measurement.setups[series.setup].instrument.channels)
        stop = start + len(series) * channels
        yield _Part(series, data.y[start:stop].reshape(-1, channels))
        start = stop


def _share(part: _Part, share: float) -> tuple[Series, Array]:
    """Evenly chosen readings of a series, at least one."""
    count = len(part.series)
    most = max(1, round(share * count))
    rows = np.unique(np.linspace(0, count - 1, most).round().astype(int))
    return part.series.take(rows), part.y[rows].ravel()
