"""A board of real machines: what a calibration predicts of readings that it did not see.

    python -m benchmarks.real_data --data ../shared/data

Plain least squares, beside it, is that of SciPy: the same parameters, readings over their
stated noise, no tolerances, from nominal. Of held-out readings each set-up's own unknowns
are adjusted, also without tolerances, for both. docs/benchmarks/real_data.md says where the
data come from.
"""

from __future__ import annotations

import argparse
import dataclasses
import tempfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import numpy as np
from scipy.optimize import least_squares

from benchmarks.harness import tables
from oed import units
from oed.base import Array, Mask
from oed.dataset import Dataset
from oed.measurement import Measurement, Series
from oed.result import HeldOutSection, StudyResult
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.importers import import_files
from pkm_studies.resolve import resolve

# -- machines --------------------------------------------------------------------------
ROOT = Path(__file__).resolve().parents[1]
STUDIES = ROOT / "studies"


@dataclasses.dataclass(frozen=True)
class Entry:
    """A machine with readings of its own."""

    name: str  #: of the row
    folder: str  #: of its files, in the data folder
    fitted: str  #: what is fitted, in words
    blind: str  #: what is predicted, in words
    study: str = ""  #: name of a shipped study; "" where `file` is imported
    file: str = ""  #: configuration with readings, for `oed import klipper`


def _printer(name: str, file: str, fitted: str) -> Entry:
    blind = "bed meshes of the same file"
    return Entry(name, "klipper_delta", fitted, blind, file=f"{file}.cfg")


HEIGHTS, DISTANCES = "7 heights", "heights and 12 distances"
SESSION, OTHER = f"{DISTANCES} of a session", "those of another session"
CAMERA, CAPTURE = "9 poses seen by a camera", "54 poses by motion capture"
LINES = "whether the lines meet at 35 others"
ENTRIES = (
    Entry("FLSun V400, S04 to S03", "delta_v400", SESSION, OTHER, "delta_v400"),
    Entry("FLSun V400, S03 to S04", "delta_v400", SESSION, OTHER, "delta_v400_reverse"),
    Entry("Hangprinter HP4", "hangprinter_hp4", CAMERA, LINES, "hangprinter_hp4"),
    Entry("Jugglebot", "jugglebot", CAPTURE, "the other 54", "jugglebot"),
    _printer("FLSun SR, danorder", "flsun_sr_danorder_mesh", HEIGHTS),
    _printer("FLSun SR, danorder, earlier", "flsun_sr_danorder_mesh_2", HEIGHTS),
    _printer("FLSun SR, cupsster", "flsun_sr_cupsster", HEIGHTS),
    _printer("FLSun V400, phnxdrgn", "flsun_v400_phnxdrgn", DISTANCES),
    _printer("FLSun V400, fzechert", "flsun_v400_fzechert", "heights"),
)


# -- what others leave -----------------------------------------------------------------
Figures = dict[tuple[str, str], float]  #: (set-up, channel): rms in its fine unit


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
@dataclasses.dataclass(frozen=True)
class Row:
    """A kind of held-out readings, in their fine unit."""

    blind: HeldOutSection
    nominal: float
    least_squares: float


def run(entry: Entry, data: Path, work: Path) -> list[Row]:
    """Run an entry with the data folder; files go to `work`."""
    study = _study(entry, data, work)
    result = stages.run_study(study, work / "out")
    return list(_rows(study, result)) if result.held_out else []


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
    chosen = data.setups if study.readings.fit is None else study.readings.fit
    fitted = data.take([name for name in chosen if name not in blind])
    nominal = held_out_rms(measurement, held_out, measurement.nominal)
    plain = plain_least_squares(measurement, fitted)
    squares = held_out_rms(measurement, held_out, plain)
    for section in result.held_out:
        key = (section.name, section.channel)
        yield Row(section, nominal[key], squares[key])


# -- table -----------------------------------------------------------------------------
COLUMNS = ("machine", "fitted", "predicted blind", "readings", "predicted", "inside")


def line(entry: Entry, row: Row) -> str:
    """A line of the table."""
    blind = row.blind
    return tables.row(
        entry.name,
        entry.fitted,
        f"{entry.blind}: {blind.name}, {blind.channel}",
        blind.n,
        f"{blind.rms:.3g} {blind.unit}",
        f"{100 * blind.coverage:.0f} %",
        f"{row.least_squares:.3g}",
        f"{row.nominal:.3g}",
    )


def main() -> None:
    """Run the entries whose data are there, and print their table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, required=True, help="folder of the data")
    data = parser.parse_args().data
    print(tables.head(*COLUMNS, "least squares", "nominal"), flush=True)
    for entry in ENTRIES:
        if not (data / entry.folder).is_dir():
            print(tables.row(entry.name, f"no data in {data / entry.folder}"))
            continue
        with tempfile.TemporaryDirectory() as work:
            for row in run(entry, data, Path(work)):
                print(line(entry, row), flush=True)


if __name__ == "__main__":
    main()
