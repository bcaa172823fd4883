"""`oed forecast`: nodes to measure, their table at work on the oracle, what is refused."""

import csv
import dataclasses
import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gantry_forecast import PLAN, QUIET
from oracles import forecast_data, planar_geometry
from scipy.interpolate import RegularGridInterpolator

from pkm_studies.commands import main
from pkm_studies.resolve import resolve
from pkm_studies.results import load_result
from pkm_studies.stages.forecast import forecast_task
from pkm_studies.stages.plan.task import stored_knowledge
from pkm_studies.study import Study

STUDIES = Path(__file__).parents[3] / "studies"


def study(folder: Path, text: str = PLAN) -> Path:
    path = folder / "gantry.study.toml"
    path.write_text(text)
    return path


def run(*arguments: object) -> int:
    return main([str(a) for a in arguments])


def section(folder: Path) -> dict[str, Any]:
    result: dict[str, Any] = json.loads((folder / "result.json").read_text())
    forecast: dict[str, Any] = result["forecast"]
    return forecast


def rows(path: Path) -> list[dict[str, str]]:
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def commands_of(sheet: Path) -> np.ndarray:
    """Commands (n, 2), m, of a sheet of nodes."""
    return 1e-3 * np.array([[float(r["y_mm"]), float(r["z_mm"])] for r in rows(sheet)])


def check_sent(file: Path, step: int) -> None:
    """The nominal controller sends the corrected command to the corrected joints."""
    for row in rows(file)[::step]:
        v = {name: float(value) * 1e-3 for name, value in row.items()}
        kept = planar_geometry.inverse(np.array([v["y_mm"], v["z_mm"]]))
        corrected = np.array([v["corrected_y_mm"], v["corrected_z_mm"]])
        change = planar_geometry.inverse(corrected) - kept
        expected = [v["correction_q1_mm"], v["correction_q2_mm"]]
        assert change == pytest.approx(expected, abs=5e-9)


@pytest.fixture(scope="module")
def planned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("forecast")
    assert run("forecast", study(folder), "--out", folder / "out") == 0
    return folder


def filled(folder: Path, name: str) -> Path:
    """The sheet as the oracle's gantry fills it in, with the noise of the instrument."""
    command = commands_of(folder / "out" / "forecast_nodes.csv")
    errors = forecast_data.planar().errors(command)
    noise = np.random.default_rng(3).standard_normal(errors.shape)
    path = folder / name
    forecast_data.write(
        path, COLUMNS, command, errors + forecast_data.SIGMA * noise, UNITS
    )
    return path


def test_the_plan_is_a_sheet_to_fill_in(planned):
    sheet = rows(planned / "out" / "forecast_nodes.csv")
    assert len(sheet) == 28
    assert list(sheet[0]) == ["y_mm", "z_mm", "error_y_um", "error_z_um"]
    assert {r["error_y_um"] + r["error_z_um"] for r in sheet} == {""}
    text = (planned / "out" / "forecast_nodes.csv").read_text()
    assert "# error_y_um: y of the tool point, actual less wanted" in text
    forecast = section(planned / "out")
    assert forecast["minutes"] == pytest.approx(80.0 + 28 * 40.0 / 60.0)
    planned_rms = [c["planned"] for c in forecast["components"].values()]
    assert all(3.0 < rms < 6.0 for rms in planned_rms)
    page = (planned / "out" / "report.html").read_text()
    assert "Forecast compensation" in page
    assert "not measured yet" in page


def test_the_table_brings_a_hundredth(planned, capsys):
    nodes = filled(planned, "nodes.csv")
    out = planned / "out"
    assert run("forecast", study(planned), "--out", out, "--readings", nodes) == 0
    assert "the table is predicted to leave" in capsys.readouterr().out
    gantry = forecast_data.planar()
    command = np.array(
        [(y, z) for z in np.arange(6) * 0.3 for y in np.arange(-30, 31) / 20]
    )
    both = np.vstack([command, [[0.0, 0.0]]])
    added = table(out / "forecast_table.csv")(both)
    error = gantry.gantry.pose(gantry.joints(both) + added) - both
    left = (error[:-1] - error[-1]) * 1e6
    assert np.abs(gantry.errors(command)).max() > 60e-6
    assert np.abs(left).max() < 10.0
    for k, c in enumerate(section(out)["components"].values()):
        rms = np.sqrt(np.mean(left[:, k] ** 2))
        assert 0.5 * c["low"] < rms < 1.2 * c["high"]
        assert c["low"] < c["predicted"] < c["high"]
        assert 0.4 < c["left_out"] / c["left_out_predicted"] < 1.5
    page = (out / "report.html").read_text()
    assert "Left out: how far each node is from what all other nodes predict" in page
    check_sent(out / "forecast_table.csv", 7)
    # the table goes into the controller's file
    assert run("compensate", out, "--to", "csv") == 0
    said = "Errors measured at nodes (oed forecast) are part of the table."
    assert said in capsys.readouterr().out
    command = PLACES[:400]
    before = 1e6 * Machine().errors(command)
    after = 1e6 * Machine(added=table(out / "compensation.csv")).errors(command)
    assert np.sqrt(np.mean(before**2)) > 25.0
    assert np.abs(after).max() < 10.0
    check_sent(out / "compensation.csv", 37)
    assert run("compensate", out, "--to", "json") == 0
    columns = json.loads((out / "compensation.json").read_text())["table"]
    first = [float(r["correction_q1_mm"]) for r in rows(out / "compensation.csv")]
    assert columns["correction_q1_mm"] == pytest.approx(first, abs=1e-6)
    capsys.readouterr()
    run("compensate", out, "--to", "c")
    assert "are not in this file" in capsys.readouterr().out


def test_a_wrong_reading_is_named_and_stated_noise_counts(planned, capsys):
    nodes, out = filled(planned, "wrong.csv"), planned / "out"
    lines = nodes.read_text().splitlines()
    y, z, error, other = lines[5].split(",")
    lines[5] = f"{y},{z},{float(error) + 60.0},{other}"
    nodes.write_text("\n".join(lines))
    call = ("forecast", study(planned, QUIET), "--out", out, "--readings", nodes)
    assert run(*call) == 0
    said = capsys.readouterr().out
    assert f"y_mm = {float(y):g}, z_mm = {float(z):g}" in said
    assert "measure it again" in said
    sigmas = [",sigma_y_um", *("," for _ in lines[1:])]
    sigmas[5] = ",200"
    nodes.write_text("\n".join(map("".join, zip(lines, sigmas, strict=True))))
    assert run(*call) == 0
    assert "measure it again" not in capsys.readouterr().out


def test_errors_in_another_unit_are_doubted(planned, capsys):
    """Millimetres under a header in micrometres."""
    nodes, out = filled(planned, "wrong_unit.csv"), planned / "out_small"
    header, *lines = nodes.read_text().splitlines()
    cells = [line.split(",") for line in lines]
    small = [[y, z, *(f"{1e-3 * float(e):.6f}" for e in rest)] for y, z, *rest in cells]
    nodes.write_text("\n".join([header, *(",".join(row) for row in small)]))
    call = ("forecast", study(planned, QUIET), "--out", out, "--readings", nodes)
    assert run(*call) == 0
    assert "check the unit of the file" in capsys.readouterr().out


@pytest.mark.parametrize(("change", "words"), [
    (lambda t: t.replace("0,1200,", "0,9200,", 1), "out of the machine's range"),
    (lambda t: t.replace("error_y_um", "error_y_cm"), "no such column"),
    (lambda t: "\n".join(t.splitlines()[:4]), "3 nodes are too few"),
    (lambda t: t.replace("0,1200,", "0,1200,x", 1), "not a finite number"),
])  # fmt: skip
def test_bad_nodes_are_refused(planned, capsys, change, words):
    nodes = filled(planned, "bad.csv")
    text = nodes.read_text()
    assert "0,1200," in text
    nodes.write_text(change(text))
    before = (planned / "out" / "result.json").read_bytes()
    arguments = ("--out", planned / "out", "--readings", nodes)
    assert run("forecast", study(planned), *arguments) == 2
    assert words in capsys.readouterr().err
    assert (planned / "out" / "result.json").read_bytes() == before


@pytest.mark.parametrize(("old", "new", "words"), [
    ("expected = { y_um = 40.0, z_um = 40.0 }", "expected = {}", "it is empty"),
    ("nodes = 28", 'setup = "rm9"', "no such set-up"),
    ("nodes = 28", "sigma = { x_um = 1.0 }", "unknown field"),
    ("[prediction]", '[prediction]\nreference = "best_fit"', "cannot align"),
    (PLAN[PLAN.index("[forecast]") :], "", "does not say what calibration leaves"),
])  # fmt: skip
def test_studies_without_what_it_needs_are_refused(tmp_path, capsys, old, new, words):
    assert old in PLAN
    path = study(tmp_path, PLAN.replace(old, new))
    assert run("forecast", path, "--out", tmp_path / "out") == 2
    assert words in capsys.readouterr().err


def test_an_empty_sheet_is_refused(planned, capsys):
    nodes = planned / "out" / "forecast_nodes.csv"
    path = study(planned)
    assert run("forecast", path, "--out", planned / "out", "--readings", nodes) == 2
    assert "no error was measured" in capsys.readouterr().err


@pytest.mark.parametrize(("reference", "count"), [("home", 1), ("absolute", 0)])
def test_only_errors_against_home_leave_home_alone(tmp_path, capsys, reference, count):
    stated = f'[prediction]\nreference = "{reference}"'
    path = study(tmp_path, QUIET.replace("[prediction]", stated))
    assert run("forecast", path, "--out", tmp_path / "out") == 0
    assert capsys.readouterr().out.count("adds nothing at home") == count


CALIBRATED = """
[readings]
simulate = true
[readings.truth]
D_mm = 3584.6
l1_mm = 3349.6
l2_mm = 3350.3
beta1_mrad = 0.3
[posterior]
enabled = false
[[design.reference]]
name = "lines"
setup = "rm4"
y_mm = [-1500.0, 0.0, 1500.0]
z_mm = { from = 0.0, to = 1500.0, count = 6 }
runs_by = "y"
[[design.reference]]
name = "lines"
setup = "rm5"
y_mm = { from = -1500.0, to = 1500.0, count = 11 }
z_mm = [0.0, 750.0, 1500.0]
runs_by = "z"
"""


@pytest.mark.slow
def test_an_estimate_in_the_folder_is_the_mean_of_the_field(tmp_path):
    """Eight nodes of a machine with the nominal numbers, whose errors are 0.3 mm."""
    setup = """[[setup]]
name = "rm4"
instrument = "rm4"
[[setup]]
name = "rm5" """
    eight = 'nodes = 8\ncompensated = false\nsetup = "rm5"'
    text = PLAN.replace('[[setup]]\nname = "rm5"', setup) + CALIBRATED
    text = text.replace("[noise]\n", "[noise]\nrm4 = { dy_um = 3.0 }\n")
    text = text.replace("pdf = false", "pdf = false\nhtml = false")
    text = text.replace("nodes = 28", eight)
    out, path = tmp_path / "out", study(tmp_path, text)
    truth = planar_geometry.NOMINAL + 1e-3 * np.array([0.6, 0, 0, -0.4, 0.3, 0.3, 0])
    assert run("run", path, "--out", out, "--quiet") == 0
    assert section(out)["readings"] == 0
    command = commands_of(out / "forecast_nodes.csv")

    def errors(at: np.ndarray) -> np.ndarray:
        both = np.vstack([at, [[0.0, 0.0]]])
        error = planar_geometry.forward(planar_geometry.inverse(both), truth) - both
        return error[:-1] - error[-1]

    nodes = tmp_path / "nodes.csv"
    forecast_data.write(nodes, COLUMNS, command, errors(command), UNITS)
    assert run("forecast", path, "--out", out, "--readings", nodes) == 0
    result = json.loads((out / "result.json").read_text())
    assert result["estimate"]["parameters"]["D"]["value"] == pytest.approx(
        3584.6, abs=1
    )
    lines = np.array([(y, z) for z in (0.1, 0.8) for y in (-1.3, -0.7, 0.2, 1.4)])
    joints = planar_geometry.inverse(lines) + table(out / "forecast_table.csv")(lines)
    home = planar_geometry.forward(planar_geometry.inverse(np.zeros(2)), truth)
    left = planar_geometry.forward(joints, truth) - lines - home
    assert np.abs(errors(lines)).max() > 200e-6
    assert np.abs(left).max() < 12e-6
    # a controller that holds the estimate leaves nothing that parameters explain
    predicted = {}
    for name, line in (("nominal", ""), ("held", 'controller = "out"\n')):
        held = tmp_path / f"{name}.study.toml"
        held.write_text(text.replace("[machine]\n", f"[machine]\n{line}", 1))
        resolved = resolve(Study.load(held), readings=[])
        knowledge = stored_knowledge(resolved, load_result(out), out)
        task = forecast_task(resolved, knowledge, np.random.default_rng(0))
        predicted[name] = np.abs(task.predicted_errors(lines)).max()
    assert predicted["nominal"] > 200e-6
    assert predicted["held"] < 1e-6


def test_shipped_nodes_are_what_the_oracle_reads():
    arcsec = np.radians(1.0 / 3600.0)
    cases = (
        (
            "planar_forecast",
            forecast_data.planar().errors,
            (["y_mm", "z_mm"], [1e-3, 1e-3]),
            (["error_y_um", "error_z_um"], [1e-6, 1e-6]),
            forecast_data.SIGMA,
        ),
        (
            "a3_forecast",
            forecast_data.a3().errors,
            (["z_mm", "psi_deg", "theta_deg"], [1e-3, *np.radians([1, 1])]),
            (
                ["error_z_um", "error_psi_arcsec", "error_theta_arcsec"],
                [1e-6, arcsec, arcsec],
            ),
            forecast_data.A3_SIGMA,
        ),
    )
    for name, errors, (commands, units), (columns, fine), sigma in cases:
        for kind in ("nodes", "check"):
            table = rows(STUDIES / f"{name}.{kind}.csv")
            command = np.array([[float(r[n]) for n in commands] for r in table]) * units
            read = np.array([[float(r[n]) for n in columns] for r in table]) * fine
            noise = (read - errors(command)) / sigma
            assert np.abs(noise).max() < 4.0
            assert 0.8 < noise.std() < 1.2


Array = np.ndarray
Run = Callable[..., tuple[int, str, str]]
#: m, pitch of both screws, and the amplitude of the error that comes back with it
PITCH, AMPLITUDE = 10e-3, 4e-6
UNITS = np.array([1e-3, 1e-3, 1e-6, 1e-6])
COLUMNS = ["y_mm", "z_mm", "error_y_um", "error_z_um"]
PLACES = np.random.default_rng(11).uniform([-1.5, 0.0], [1.5, 1.5], (1000, 2))


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


def written(path: Path, machine: Machine, command: Array, seed: int) -> Path:
    """A file of errors (n, 2) as they are read, with the noise of the instrument."""
    errors = machine.errors(command)
    noise = np.random.default_rng(seed).standard_normal(errors.shape)
    errors = errors + forecast_data.SIGMA * noise
    forecast_data.write(path, COLUMNS, command, errors, UNITS)
    return path


@pytest.fixture(scope="module")
def planned_nodes(planned: Path) -> Array:
    """The nodes (28, 2) that the study plans, m."""
    return commands_of(planned / "out" / "forecast_nodes.csv")


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


@pytest.mark.slow
def test_a_finer_line_widens_the_interval(planned_nodes, tmp_path, oed):
    """A screw of 4 um leaves what nodes far apart cannot predict, and say so."""
    machine = Machine(AMPLITUDE)
    said = measured(tmp_path, oed, machine, planned_nodes)
    joints = planar_geometry.inverse(planned_nodes)
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
    said = measured(
        tmp_path, oed, machine, planned_nodes, QUIET + 'check = "line.csv"\n'
    )
    assert "shorter than" not in said
    wide = components()
    added = table(tmp_path / "out" / "forecast_table.csv")
    left = 1e6 * Machine(AMPLITUDE, added).errors(PLACES)
    realised = np.sqrt(np.mean(left**2, axis=0))
    assert realised[0] > narrow["y"]["high"]
    for k, name in enumerate("yz"):
        assert wide[name]["low"] < realised[k] < wide[name]["high"]
