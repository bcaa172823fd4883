"""A board of real machines: what a calibration predicts of readings that it did not see.

    python -m benchmarks.real_data --data ../shared/data --out out/real_data.md

Plain least squares, beside it, is that of SciPy: the same parameters, readings over their
stated noise, no tolerances, from nominal. Of held-out readings each set-up's own unknowns
are adjusted, also without tolerances, for both.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import dataclasses
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np
from scipy.optimize import least_squares

from oed import units
from oed.base import Array, Mask
from oed.dataset import Dataset
from oed.estimation import identify
from oed.measurement import Measurement, Series
from oed.result import HeldOutSection, StudyResult
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.importers import import_files
from pkm_studies.resolve import resolve

# -- machines --------------------------------------------------------------------------


ROOT = Path(__file__).resolve().parents[1]
STUDIES = ROOT / "studies"
V400 = "https://github.com/fzechert/FLSun-V400"
SR = "https://github.com/danorder/Flsun-super-racer-Full-klipper-config-"
HANGPRINTER = "https://github.com/tobbelobb/auto-calibration-simulation-for-hangprinter"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A machine with readings of its own.

    name     of the row
    source   repository and licence
    fetch    how a user gets the files
    folder   of them, in the data folder
    study    name of a shipped study; "" where `file` is imported
    file     configuration with readings, for `oed import klipper`
    fitted   what is fitted, in words
    blind    what is predicted, in words
    """

    name: str
    source: str
    fetch: str
    folder: str
    fitted: str
    blind: str
    study: str = ""
    file: str = ""


def _printer(
    name: str, file: str, source: str, fetch: str, fitted: str, blind: str
) -> Entry:
    return Entry(name, source, fetch, "klipper_delta", fitted, blind, file=file)


SEVEN, MESH = "7 heights", "bed meshes of the same file"
ENTRIES = (
    Entry(
        "FLSun V400, S04 to S03",
        f"{V400} at 221f53d, CC0",
        f"`git clone {V400}`; readings of all versions of `printer-config/printer*.cfg`",
        "delta_v400",
        "heights and 12 distances of a session",
        "those of another session",
        study="delta_v400",
    ),
    Entry(
        "FLSun V400, S03 to S04",
        f"{V400} at 221f53d, CC0",
        "as above",
        "delta_v400",
        "heights and 12 distances of a session",
        "those of another session",
        study="delta_v400_reverse",
    ),
    Entry(
        "Hangprinter HP4",
        f"{HANGPRINTER} at 790dca2, MIT",
        f"`git clone -b hp_mark_adjusted {HANGPRINTER}`; tables of `simulation.py`",
        "hangprinter_hp4",
        "9 poses seen by a camera",
        "whether the lines meet at 35 others",
        study="hangprinter_hp4",
    ),
    Entry(
        "Jugglebot",
        "https://github.com/Project-DeepBlue-Juggling/Jugglebot at 553f1a7, MIT",
        "`git clone`; `experimenting/platform_calibration/zOld/108_calibration_poses.csv`",
        "jugglebot",
        "54 poses by motion capture",
        "the other 54",
        study="jugglebot",
    ),
    _printer(
        "FLSun SR, danorder",
        "flsun_sr_danorder_mesh.cfg",
        f"{SR} at 5694c06, CC0",
        f"`git clone {SR}`; `printer.cfg`",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun SR, danorder, earlier",
        "flsun_sr_danorder_mesh_2.cfg",
        f"{SR} before 5694c06, CC0",
        "as above, an earlier version",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun SR, cupsster",
        "flsun_sr_cupsster.cfg",
        "https://github.com/cupsster/FLSUN-SR---Klipper-Config at 684183a, CC0",
        "`git clone`; `printer.cfg`",
        SEVEN,
        MESH,
    ),
    _printer(
        "FLSun V400, phnxdrgn",
        "flsun_v400_phnxdrgn.cfg",
        "https://github.com/phnxdrgn536/FLSun-v400 of 2023-01-04, CC0",
        "`git clone`; `printer.cfg`",
        "heights and 12 distances",
        MESH,
    ),
    _printer(
        "FLSun V400, fzechert",
        "flsun_v400_fzechert.cfg",
        f"{V400} at 221f53d, CC0",
        "as above; `printer.cfg`",
        "heights",
        MESH,
    ),
)


# -- what others leave -----------------------------------------------------------------


#: (set-up, channel): rms in its fine unit
Figures = dict[tuple[str, str], float]


def plain_least_squares(measurement: Measurement, fitted: Dataset) -> Array:
    """Parameters (n,), SI; what the readings do not see stays near nominal."""
    free = np.flatnonzero(_free(measurement, fitted))
    sigma = measurement.sigma(fitted.series)
    start = measurement.nominal
    scale = measurement.tolerance[free]

    def theta(step: Array) -> Array:
        value = start.copy()
        value[free] += scale * step
        return value

    def residuals(step: Array) -> Array:
        return (measurement.readings(fitted.series, theta(step)) - fitted.y) / sigma

    def slopes(step: Array) -> Array:
        jacobian = measurement.jacobian(fitted.series, theta(step))[:, free]
        return np.asarray(jacobian * scale / sigma[:, None])

    found = least_squares(residuals, np.zeros(len(free)), jac=slopes, method="trf")
    return theta(found.x)


def _free(measurement: Measurement, fitted: Dataset) -> Mask:
    """Parameters that are fitted (n,): of the machine, and of set-ups that were read."""
    size = len(measurement.machine.parameters)
    read = {s.setup for s in fitted.series}
    setups = np.array([n.partition(".")[0] in read for n in measurement.names])
    machine = np.arange(len(measurement.names)) < size
    return np.asarray(measurement.free & (machine | setups))


def held_out_rms(measurement: Measurement, held_out: Dataset, theta: Array) -> Figures:
    """Rms of held-out readings at machine parameters, by set-up and channel."""
    figures: Figures = {}
    start = 0
    for series in held_out.series:
        channels = measurement.setups[series.setup].instrument.channels
        stop = start + len(series) * len(channels)
        residual = _adjusted(measurement, series, held_out.y[start:stop], theta)
        start = stop
        for k, channel in enumerate(channels):
            members = residual[k :: len(channels)]
            rms = float(np.sqrt(np.mean(members**2)))
            unit = units.FINE[channel.unit]
            figures[series.setup, channel.name] = units.number(rms, unit)
    return figures


def _adjusted(
    measurement: Measurement, series: Series, y: Array, theta: Array
) -> Array:
    """Residuals without what the set-up's own unknowns explain."""
    own = np.array([n.startswith(f"{series.setup}.") for n in measurement.names])
    columns = np.flatnonzero(own & measurement.free)
    residual = y - measurement.readings([series], theta)
    if not len(columns):
        return residual
    sigma = measurement.sigma([series])
    slopes = measurement.jacobian([series], theta)[:, columns]
    change = np.linalg.lstsq(slopes / sigma[:, None], residual / sigma, rcond=None)[0]
    return np.asarray(residual - slopes @ change)


# -- an entry --------------------------------------------------------------------------


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
        study = studies.Study.load(path)
    else:
        study = studies.Study.load(STUDIES / f"{entry.study}.study.toml")
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


# -- page ------------------------------------------------------------------------------


HEAD = """\
# Real machines

What does a calibration predict of readings of a real machine that it did not see? This page is written by

```console
$ python -m benchmarks.real_data --data ../shared/data --out out/real_data.md
```

No data are in the project: fetch them as the second table says, and name their folder. An entry whose data are absent
is left out. The studies `delta_v400`, `delta_v400_reverse`, `hangprinter_hp4` and `jugglebot` are shipped; the others
are what `oed import klipper` makes of a `printer.cfg`.

- *predicted*: rms of the held-out readings against the prediction; *inside*: share inside their 95 % intervals.
- *least squares*: what plain least squares of SciPy leaves of them, with the same parameters and no tolerances;
  *nominal*: what the nominal numbers leave. Unknowns of the held-out set-up itself, such as a probe's offset, are
  adjusted in all three.
- *needed*: readings, of all that were fitted, with which the prediction is within 10 % of that with all. A quarter, a
  half, three quarters and all of each set-up were tried.

| machine | fitted | predicted blind | readings | predicted | inside | least squares | nominal | needed |
|---|---|---|---|---|---|---|---|---|
"""
SOURCES = """
## Data

| machine | source and licence | fetch | fit |
|---|---|---|---|
"""


def markdown(outcomes: Sequence[Outcome]) -> str:
    """The whole page."""
    lines = [line for outcome in outcomes for line in _lines(outcome)]
    sources = [_source(outcome) for outcome in outcomes]
    return HEAD + "\n".join(lines) + "\n" + SOURCES + "\n".join(sources) + "\n"


def _lines(outcome: Outcome) -> list[str]:
    entry = outcome.entry
    if not outcome.rows:
        cells = [entry.name, entry.fitted, "nothing", *["–"] * 6]
        return [_joined(cells)]
    return [_joined(_cells(outcome, row)) for row in outcome.rows]


def _cells(outcome: Outcome, row: Row) -> list[str]:
    blind, entry = row.blind, outcome.entry
    return [
        entry.name,
        entry.fitted,
        f"{entry.blind}: {blind.name}, {blind.channel}",
        str(blind.n),
        f"{blind.rms:.3g} {blind.unit}",
        f"{100 * blind.coverage:.0f} %",
        f"{row.least_squares:.3g}",
        f"{row.nominal:.3g}",
        f"{row.needed} of {row.fitted}",
    ]


def _source(outcome: Outcome) -> str:
    entry, estimate = outcome.entry, outcome.result.estimate
    fit = ""
    if estimate is not None:
        fit = "; ".join(
            f"{channel} {rms:.3g} {estimate.units[channel]} rms"
            for channel, rms in estimate.rms_after.items()
        )
    return _joined([entry.name, entry.source, entry.fetch, fit])


def _joined(cells: Sequence[str]) -> str:
    return "| " + " | ".join(cells) + " |"


# -- command ---------------------------------------------------------------------------


def main() -> None:
    """Run the entries whose data are there, and write the page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data")
    parser.add_argument("--out", type=Path, help="page to write; printed without")
    given = parser.parse_args()
    outcomes: list[Outcome] = []
    for entry in ENTRIES:
        if not (given.data / entry.folder).is_dir():
            print(f"{entry.name}: no data in {given.data / entry.folder}")
            continue
        with tempfile.TemporaryDirectory() as work:
            outcomes.append(run(entry, given.data, Path(work)))
        print(f"{entry.name}: {len(outcomes[-1].rows)} predicted channels", flush=True)
    text = markdown(outcomes)
    if given.out is None:
        print(text)
    else:
        given.out.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
