"""What no drive corrects: offsets for additional axes, on machines of the oracles."""

import csv
from pathlib import Path

import compensation_sample as sample
import msgspec
import numpy as np
import pytest
from oracles import a3_geometry as a3
from sample import STUDY as SMALL
from sample import table_lines
from scipy.interpolate import RegularGridInterpolator
from scipy.spatial.transform import Rotation
from shipped_models import (
    hexapod,
    linear_delta,
    planar_2dof,
    tripod_passive_leg,
    tripod_prs,
    tripod_rps,
)

from oed.compensate import FurtherAxes, compensated_joints
from oed.mechanism import Kinematics
from oed.result import StudyResult
from pkm_studies.commands import main
from pkm_studies.results import load_result

ARCSEC = np.pi / 648000.0
CUP = np.array([0.0, 0.0, a3.Z_TEACH])
TABLE_3 = a3.errors(*(a3.TABLE3[k] for k in ("dq", "db", "da0", "beta")))
NOISE = 0.5e-6
HEAD = SMALL.partition("[design]")[0]
STUDY = (
    HEAD.replace('"small"', '"own"\nseed = 4')
    + """
[identify]
stages = [["dq*"], ["*"]]
effects = "none"
[posterior]
enabled = false
[prediction]
reference = "home"
z_mm = [1066.0, 1166.0, 1266.0]
psi_deg = { from = 0.0, to = 360.0, count = 12, endpoint = false }
theta_deg = [5.0, 15.0, 25.0, 35.0]
[report]
pdf = false
"""
)


def readings(rng: np.random.Generator) -> str:
    """Two circles of 15, read by the oracle's head of Table 3."""
    stroke, psi = np.repeat([0.08, 0.2], 15), np.tile(2 * np.pi * np.arange(15) / 15, 2)
    z = a3.C + a3.D + stroke
    theta = a3.circle_theta(z, psi, CUP)
    q = a3.inverse_nominal(z, psi, theta)
    cup = a3.taught_cup(TABLE_3, a3.TABLE3["ds"])
    length = a3.ball_bar_reading(TABLE_3, q, cup) + NOISE * rng.standard_normal(30)
    lines = ["setup,run,order,z_mm,psi_deg,theta_deg,length_mm"]
    for k in range(30):
        angles = np.rad2deg([psi[k], theta[k]])
        place = f"{1e3 * z[k]:.9f},{angles[0]:.9f},{angles[1]:.9f}"
        lines.append(f"cup,{k // 15},{k},{place},{1e3 * length[k]:.9f}")
    return "\n".join(lines) + "\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The head identified from readings that the toolkit did not make, with its table."""
    folder = tmp_path_factory.mktemp("axes")
    (folder / "own.study.toml").write_text(STUDY)
    (folder / "own.readings.csv").write_text(readings(np.random.default_rng(7)))
    study, csv_file = (
        str(folder / f"own.{kind}") for kind in ("study.toml", "readings.csv")
    )
    out = str(folder / "out")
    assert main(["identify", study, "--readings", csv_file, "--out", out]) == 0
    assert main(["compensate", out, "--to", "csv"]) == 0
    return folder / "out"


def table(folder: Path, columns: list[str]) -> RegularGridInterpolator:
    """Columns of the table over z, psi and theta, SI."""
    knots, rows = sample.table(folder)
    units = {"mm": 1e-3, "um": 1e-6, "arcsec": ARCSEC}
    values = np.array(
        [[float(r[c]) * units[c.rpartition("_")[2]] for c in columns] for r in rows]
    )
    shape = [len(axis) for axis in knots]
    return RegularGridInterpolator(knots, values.reshape(*shape, len(columns)))


JOINTS = [f"correction_q{k}_mm" for k in (1, 2, 3)]
OFFSETS = ["x_offset_um", "y_offset_um", "turn_offset_arcsec"]


def driven(folder: Path, command: np.ndarray, axes: bool) -> np.ndarray:
    """Errors (n, 3) of the oracle's head in x, y and about the tool axis, SI.

    It is driven by the table: joints, and where `axes` is true an X-Y table and a part
    program that take the offsets back.
    """
    reduced = command.copy()
    reduced[:, 1] %= 2.0 * np.pi
    q = a3.inverse_nominal(*command.T) + table(folder, JOINTS)(reduced)
    real = a3.forward(TABLE_3, q)
    tip, rotation = a3.nominal_pose(*command.T)
    turned = Rotation.from_matrix(real.R @ np.swapaxes(rotation, 1, 2)).as_rotvec()
    about = np.einsum("ni,ni->n", turned, rotation[:, :, 2])
    errors = np.column_stack([(real.tip - tip)[:, :2], about])
    return errors - table(folder, OFFSETS)(reduced) if axes else errors


def workspace() -> np.ndarray:
    z, theta = [1.066, 1.166, 1.266], np.deg2rad([5, 15, 25, 35])
    mesh = np.meshgrid(z, 2 * np.pi * np.arange(12) / 12, theta, indexing="ij")
    return np.column_stack([axis.ravel() for axis in mesh])


HOME = np.array([[a3.C + a3.D, 0.0, 0.0]])


def rms(folder: Path, axes: bool) -> np.ndarray:
    """Zeroed at home, as the report states errors; um, um, arcsec."""
    errors = driven(folder, workspace(), axes) - driven(folder, HOME, axes)
    return np.sqrt(np.mean(errors**2, axis=0)) / [1e-6, 1e-6, ARCSEC]


def section(folder: Path) -> StudyResult:
    return load_result(folder)


def test_table_and_axes_leave_what_the_report_says(folder):
    """A head that the toolkit did not simulate, driven by code that shares none."""
    prediction = section(folder).prediction
    assert prediction.mode == "identified"
    known = [prediction.components[n].known for n in ("x", "y", "phi")]
    stays = [prediction.components[n].after.rms for n in ("x", "y", "phi")]
    without, with_axes = rms(folder, axes=False), rms(folder, axes=True)
    assert without == pytest.approx(stays, rel=0.1)
    for found, spread in zip(with_axes, known, strict=True):
        assert spread.rms_interval is not None
        low, high = spread.rms_interval  # of 95 % of the machines
        assert 0.8 * low < found < 1.2 * high
    assert (with_axes[:2] < without[:2] / 5).all()


def test_the_budget_of_the_file_has_both_lines(folder):
    text = (folder / "compensation_budget.json").read_bytes()
    budget = msgspec.json.decode(text)
    assert list(budget["no_axes"]) == ["x", "y", "phi"]
    without = rms(folder, axes=False)
    assert list(budget["no_axes"].values()) == pytest.approx(without, rel=0.1)
    prediction = section(folder).prediction
    assert prediction.budget is not None
    kinds = {line["kind"]: line for line in budget["lines"]}
    for name in ("x", "y", "phi"):
        exact = prediction.budget.predicted[name]
        added = [kinds[k]["size"][name] for k in ("rounding", "interpolation")]
        assert budget["predicted"][name] == pytest.approx(
            np.hypot(exact, np.hypot(*added))
        )
        assert added[1] < 0.25 * exact
        assert prediction.budget.no_axes[name] > exact


def test_the_terminal_and_the_report_state_both_lines(folder, capsys):
    few = ["--to", "json", "--commands", "60"]
    assert main(["compensate", str(folder), *few]) == 0
    printed = capsys.readouterr().out
    assert "No drive of this machine corrects x, y, phi" in printed
    assert (
        "with additional axes that take back x_offset, y_offset, turn_offset" in printed
    )
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "Without additional axes" in page
    headline = section(folder).headline
    assert any("No drive corrects x" in sentence for sentence in headline)


# -- verify ----------------------------------------------------------------------------
def fill_in(folder: Path, to: Path, axes: bool | None, scale: float = 1.0) -> Path:
    """Errors of the oracle's head at the planned poses; None leaves x, y, phi empty."""
    text = (folder / "acceptance.csv").read_text()
    rows = list(csv.DictReader(table_lines(text)))
    names = [c for c in rows[0] if c.endswith(("_mm", "_deg"))]
    command = np.array([[float(r[c]) for c in names] for r in rows]) * sample.FACTORS
    errors = driven(folder, command, bool(axes)) - driven(folder, HOME, bool(axes))
    for row, (x, y, phi) in zip(rows, scale * errors, strict=True):
        row |= {"error_z_um": "0", "error_psi_arcsec": "0", "error_theta_arcsec": "0"}
        if axes is not None:
            row["error_x_um"], row["error_y_um"] = f"{x / 1e-6:.9f}", f"{y / 1e-6:.9f}"
            row["error_phi_arcsec"] = f"{phi / ARCSEC:.9f}"
            row["further_axes"] = "1" if axes else ""
    with to.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return to


def test_verify_judges_without_and_with_the_axes(folder, tmp_path):
    assert main(["verify", str(folder)]) == 0
    plan = section(folder).acceptance
    assert list(plan.components) == ["z", "psi", "theta"]
    assert list(plan.further) == ["x", "y", "phi"]
    off = fill_in(folder, tmp_path / "off.csv", axes=False)
    on = fill_in(folder, tmp_path / "on.csv", axes=True)
    verdicts = []
    for file in (off, on):
        main(["verify", str(folder), "--readings", str(file)])
        judged = section(folder).verification
        assert judged.judgement != "fail"
        verdicts.append(judged.further)
    for name, demand in plan.further.items():
        first, second = (v[name] for v in verdicts)
        # the table interpolates, the plan does not
        assert first.rms == pytest.approx(second.rms, abs=0.2 * demand.promised)
        assert first.without == pytest.approx(second.without, rel=0.02)
        assert first.without > first.rms
    bad = fill_in(folder, tmp_path / "bad.csv", axes=False, scale=1.5)
    assert main(["verify", str(folder), "--readings", str(bad)]) == 1
    none = fill_in(folder, tmp_path / "none.csv", axes=None)
    main(["verify", str(folder), "--readings", str(none)])
    judged = section(folder).verification
    assert judged.further == {}


# -- other machines --------------------------------------------------------------------
@pytest.mark.parametrize(("machine", "names"), [
    (linear_delta.machine, []),
    (hexapod.machine, []),
    (planar_2dof.machine, []),
    (tripod_rps.machine, ["x", "y", "turn"]),
    (tripod_prs.machine, ["x", "y", "turn"]),
    (tripod_passive_leg.machine, ["ax", "ay", "az"]),
], ids=lambda value: value.name if hasattr(value, "name") else "")  # fmt: skip
def test_a_machine_has_the_axes_that_its_joints_lack(machine, names, rng):
    """Joints and axes together leave nothing."""
    kinematics = Kinematics(machine)
    further = FurtherAxes.of(kinematics)
    assert [a.name for a in further.axes] == names
    tolerance = np.array([p.tolerance for p in machine.parameters])
    parameters = machine.nominal + tolerance * rng.standard_normal(len(tolerance))
    home = machine.home_command
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    command = home + 0.2 * (rng.uniform(low, high, (5, len(home))) - home)
    joints = compensated_joints(kinematics, command, parameters)
    start, _ = kinematics.inverse(command)
    wanted = kinematics.frames(start, np.zeros(3))[:2]
    reached = kinematics.forward(joints, parameters, start)
    rotation, point = kinematics.frames(reached, np.zeros(3))[:2]
    turn = Rotation.from_matrix(rotation @ np.swapaxes(wanted[0], 1, 2)).as_rotvec()
    left = np.hstack([point - wanted[1], turn])
    left -= further.twists(command, further.offsets(command, parameters))
    assert np.abs(left).max() < 1e-9
    assert bool(names) == bool(len(further))


def test_a_format_without_offsets_says_where_they_are(tmp_path, capsys, folder):
    (tmp_path / "bare.py").write_text(
        "from pkm_studies.catalogue.controller_format import ControllerFormat\n"
        "from pkm_studies.compensation.formats import json_file\n"
        "controller = ControllerFormat(name='bare', about='', source='',"
        " write=json_file.write, joints=json_file.joints)\n"
    )
    reference = f"{tmp_path}/bare.py:controller"
    out = str(tmp_path / "bare.json")
    assert main(["compensate", str(folder), "--to", reference, "--out", out]) == 0
    printed = capsys.readouterr().out
    assert "csv and json have columns for additional axes" in printed


def test_a_machine_without_such_motions_has_no_such_columns(tmp_path):
    machine = linear_delta.machine
    folder = sample.save(tmp_path, sample.result(machine, machine.nominal))
    assert main(["compensate", str(folder), "--to", "csv"]) == 0
    header = (folder / "compensation.csv").read_text().splitlines()[0]
    assert "offset" not in header
    described = (folder / "compensation_columns.csv").read_text()
    for name in header.split(","):
        assert f"\n{name}," in described
