"""Measured errors in the controller's file, and waves that no node sees, on the gantry."""

import csv
import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from gantry_forecast import QUIET
from oracles import forecast_data, planar_geometry
from scipy.interpolate import RegularGridInterpolator

from pkm_studies import stages
from pkm_studies.study import Study

Array = np.ndarray
Run = Callable[..., tuple[int, str, str]]
#: m, pitch of both screws, and the amplitude of the error that comes back with it
PITCH, AMPLITUDE = 10e-3, 4e-6
UNITS = np.array([1e-3, 1e-3, 1e-6, 1e-6])
COLUMNS = ["y_mm", "z_mm", "error_y_um", "error_z_um"]


@dataclasses.dataclass(frozen=True)
class Machine:
    """The gantry with screws of an amplitude, m, and what is added to its joints."""

    amplitude: float = 0.0
    added: Callable[[Array], Array] = lambda command: np.zeros((len(command), 2))

    def errors(self, command: Array) -> Array:
        """Errors (n, 2) against home, m."""
        gantry = forecast_data.planar()
        both = np.vstack([command, [[0.0, 0.0]]])
        joints = gantry.joints(both) + self.added(both)
        joints += self.amplitude * np.sin(2.0 * np.pi * joints / PITCH)
        error = gantry.gantry.pose(joints) - both
        return np.asarray(error[:-1] - error[-1])


def rows(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def written(path: Path, machine: Machine, command: Array, seed: int) -> Path:
    """A file of errors (n, 2) as they are read, with the noise of the instrument."""
    errors = machine.errors(command)
    noise = forecast_data.SIGMA * np.random.default_rng(seed).standard_normal(
        errors.shape
    )
    forecast_data.write(path, COLUMNS, command, errors + noise, UNITS)
    return path


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Array:
    """The nodes (28, 2) that the study plans, m."""
    folder = tmp_path_factory.mktemp("plan")
    (folder / "gantry.study.toml").write_text(QUIET)
    study = Study.load(folder / "gantry.study.toml")
    stages.forecast_study(study, folder / "out")
    sheet = rows(folder / "out" / "forecast_nodes.csv")
    return 1e-3 * np.array([[float(r["y_mm"]), float(r["z_mm"])] for r in sheet])


def measured(
    folder: Path, oed: Run, machine: Machine, command: Array, text: str = QUIET
) -> str:
    """What the forecast of nodes (n, 2) prints that were read on the machine."""
    study = folder / "gantry.study.toml"
    study.write_text(text)
    file = written(folder / "nodes.csv", machine, command, 3)
    code, said, error = oed(
        "forecast", study, "--out", folder / "out", "--readings", file
    )
    assert code == 0, error
    return said


def table(path: Path) -> Callable[[Array], Array]:
    """Corrections (n, 2), m, as a controller interpolates the file's, at commands, m."""
    read = rows(path)
    y, z = (np.unique([float(r[name]) for r in read]) for name in ("y_mm", "z_mm"))
    names = ("correction_q1_mm", "correction_q2_mm")
    values = np.array([[float(r[name]) for name in names] for r in read])
    grid = RegularGridInterpolator((y, z), values.reshape(len(y), len(z), 2))
    return lambda command: 1e-3 * grid(1e3 * command)


def places(count: int) -> Array:
    return np.random.default_rng(11).uniform([-1.5, 0.0], [1.5, 1.5], (count, 2))


def test_the_table_goes_into_the_controllers_file(planned, tmp_path, oed):
    measured(tmp_path, oed, Machine(), planned)
    out = tmp_path / "out"
    code, said, error = oed("compensate", out, "--to", "csv")
    assert code == 0, error
    assert "Errors measured at nodes (oed forecast) are part of the table." in said
    added = table(out / "compensation.csv")
    command = places(400)
    before = 1e6 * Machine().errors(command)
    after = 1e6 * Machine(added=added).errors(command)
    assert np.sqrt(np.mean(before**2)) > 25.0
    assert np.abs(after).max() < 10.0
    # the nominal controller sends the corrected command to the corrected joints
    for row in rows(out / "compensation.csv")[::37]:
        v = {name: 1e-3 * float(value) for name, value in row.items()}
        sent = planar_geometry.inverse(
            np.array([v["corrected_y_mm"], v["corrected_z_mm"]])
        )
        kept = planar_geometry.inverse(np.array([v["y_mm"], v["z_mm"]]))
        expected = [v["correction_q1_mm"], v["correction_q2_mm"]]
        assert sent - kept == pytest.approx(expected, abs=5e-9)
    assert oed("compensate", out, "--to", "json")[0] == 0
    columns = json.loads((out / "compensation.json").read_text())["table"]
    first = [float(r["correction_q1_mm"]) for r in rows(out / "compensation.csv")]
    assert columns["correction_q1_mm"] == pytest.approx(first, abs=1e-6)
    code, said, _ = oed("compensate", out, "--to", "c")
    assert "are not in this file" in said


@pytest.mark.slow
def test_a_finer_line_widens_the_interval(planned, tmp_path, oed):
    """A screw of 4 um leaves what nodes far apart cannot predict, and say so."""
    machine = Machine(AMPLITUDE)
    said = measured(tmp_path, oed, machine, planned)
    joints = planar_geometry.inverse(planned)
    apart = np.abs(joints[:, None] - joints).max(axis=2) + np.diag(np.full(28, np.inf))
    stated = re.search(r"shorter than ([\d.]+) mm", said)
    assert stated is not None, said
    wave = 2.0 * np.median(apart.min(axis=1))
    assert float(stated[1]) == pytest.approx(1e3 * wave, rel=1e-2)
    assert wave > 10.0 * PITCH

    def components() -> dict[str, dict[str, float]]:
        result = json.loads((tmp_path / "out" / "result.json").read_text())
        return dict(result["forecast"]["components"])

    narrow = components()
    line = np.column_stack([np.linspace(-0.45, 0.45, 61), np.full(61, 0.7)])
    written(tmp_path / "line.csv", machine, line, 4)
    said = measured(tmp_path, oed, machine, planned, QUIET + 'check = "line.csv"\n')
    assert "shorter than" not in said
    wide = components()
    added = table(tmp_path / "out" / "forecast_table.csv")
    left = 1e6 * Machine(AMPLITUDE, added).errors(places(1000))
    realised = np.sqrt(np.mean(left**2, axis=0))
    assert realised[0] > narrow["y"]["high"]
    for k, name in enumerate("yz"):
        assert wide[name]["low"] < realised[k] < wide[name]["high"]
