"""`oed compensate`: files that controllers read, by formulas written here, and their budget."""

import csv
import json
import re
from pathlib import Path
from types import SimpleNamespace

import compensation_sample as sample
import msgspec
import numpy as np
import pytest
import report_fixture
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from result_sample import whole
from scipy.interpolate import RegularGridInterpolator
from shipped_models import a3_head, hexapod, linear_delta, micro_cmm, planar_2dof

from oed.compensate import compensated_joints
from oed.mechanism import Kinematics
from oed.result import (
    BudgetLine,
    BudgetSection,
    ComponentAccuracy,
    GoodnessSection,
    NoiseRecord,
    PredictionSection,
    SpreadRecord,
    StudyResult,
    UsualEffects,
)
from oed.verdict import SCOPE_WORDS, WITH_USUAL_EFFECTS
from pkm_reports import first_lines
from pkm_studies import describe
from pkm_studies.base import InputError
from pkm_studies.catalogue import ControllerFormat
from pkm_studies.commands import main
from pkm_studies.compensation.export import undriven_components
from pkm_studies.results import load_result

#: an identified delta: radius, arms, angles, endstops
DELTA = linear_delta.machine.nominal + np.array(
    [3e-4, -5e-4, -6e-4, 4e-4, 1e-3, -2e-3, 0.0, 2e-4, 1.2e-3, -1e-4]
)


@pytest.fixture
def delta_folder(tmp_path: Path) -> Path:
    return sample.save(tmp_path / "d", sample.result(linear_delta.machine, DELTA))


@pytest.mark.parametrize(
    ("name", "stem"), [("f.csv", "f"), ("f.txt", "f"), ("f", "f"), ("f.1", "f.1")]
)
def test_further_files_take_the_name_without_its_end(
    name, stem, oed, delta_folder, tmp_path
):
    out = tmp_path / "out" / name
    options = ("--to", "csv", "--commands", 64, "--out", out)
    assert oed("compensate", delta_folder, *options)[0] == 0
    written = {path.name for path in out.parent.iterdir()}
    others = {f"{stem}_{end}.csv" for end in ("columns", "grid", "parameters")}
    assert written == {name, *others}


def nozzle(q: np.ndarray) -> np.ndarray:
    """Tool points of the machine with the identified parameters, by the oracle."""
    return delta.nozzle(q, DELTA[0], DELTA[1:4], DELTA[4:7], DELTA[7:])


def test_linuxcnc_reproduces_a_hexapod_and_a_tripod(oed, tmp_path, rng):
    for machine, shift in ((hexapod.machine, 0.05), (micro_cmm.machine, 0.02)):
        truth = machine.nominal + 0.5 * rng.standard_normal(len(machine.nominal)) * [
            p.tolerance for p in machine.parameters
        ]
        folder = sample.save(tmp_path / machine.name, sample.result(machine, truth))
        code, out, err = oed("compensate", folder, "--to", "linuxcnc")
        assert code == 0, err
        hal = (folder / "compensation.hal").read_text("utf-8")
        ini = (folder / "compensation.ini").read_text("utf-8")
        pins = {k: float(v) for k, v in re.findall(r"setp (\S+) (\S+)", hal)}
        zero = np.array(re.findall(r"STRUT_ZERO = (\S+)", ini), dtype=float)
        kinematics = Kinematics(machine)
        command = machine.home_command + shift * rng.uniform(-1, 1, (20, len(zero)))
        x, _ = kinematics.inverse(command)
        rotation, point, _ = kinematics.frames(x, np.zeros(3))
        if len(zero) == 6:
            b, a = (
                np.array(
                    [[pins[f"genhexkins.{s}.{k}.{i}"] for i in "xyz"] for k in range(6)]
                )
                for s in ("base", "platform")
            )
            ends = 1e3 * point[:, None] + np.einsum("nij,kj->nki", rotation, a)
            lengths = np.linalg.norm(ends - b, axis=2)
        else:
            lengths = tripod_lengths(hal, pins, 1e3 * point)
        q = 1e-3 * (lengths - zero)
        exact = compensated_joints(kinematics, command, truth)
        assert np.abs(q - exact).max() < 5e-9
        assert "cost at most x" in out


def tripod_lengths(hal: str, pins: dict[str, float], point: np.ndarray) -> np.ndarray:
    """AD, BD, CD of tripodkins for points of the machine's frame, mm."""
    origin = np.array(re.search(r"origin at (.*) mm", hal)[1].split(","), dtype=float)
    rows = re.search(r"\(rows\) (.*); point", hal)[1].split(";")
    axes = np.array([row.split() for row in rows], dtype=float)
    d = (point - origin) @ axes.T
    bx, cx, cy = (pins[f"tripodkins.{n}"] for n in ("Bx", "Cx", "Cy"))
    return np.column_stack(
        [
            np.sqrt((d**2).sum(1)),
            np.sqrt((d[:, 0] - bx) ** 2 + d[:, 1] ** 2 + d[:, 2] ** 2),
            np.sqrt((d[:, 0] - cx) ** 2 + (d[:, 1] - cy) ** 2 + d[:, 2] ** 2),
        ]
    )


def test_csv_and_json_hold_parameters_and_corrected_commands(oed, delta_folder):
    code, out, _ = oed("compensate", delta_folder, "--to", "csv")
    assert code == 0
    assert "the table is narrower than the workspace" in out.lower()
    assert oed("compensate", delta_folder, "--to", "json")[0] == 0
    with (delta_folder / "compensation.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    q = np.array([[float(r[f"q{i}_mm"]) for i in (1, 2, 3)] for r in rows])
    command = np.array([[float(r[f"{k}_mm"]) for k in "xyz"] for r in rows])
    assert np.abs(1e3 * nozzle(1e-3 * q) - command).max() < 5e-6
    corrected = np.array([[float(r[f"corrected_{k}_mm"]) for k in "xyz"] for r in rows])
    n = linear_delta.machine.nominal
    unchanged = delta.nozzle(1e-3 * q, n[0], n[1:4], n[4:7], n[7:])
    assert np.abs(1e3 * unchanged - corrected).max() < 5e-6
    document = json.loads((delta_folder / "compensation.json").read_text("utf-8"))
    radius = document["parameters"]["radius"]
    assert radius["value"] == pytest.approx(1e3 * DELTA[0], abs=1e-12)
    with (delta_folder / "compensation_parameters.csv").open(newline="") as file:
        table = {r["name"]: r for r in csv.DictReader(file)}
    assert float(table["arm2"]["value"]) == pytest.approx(1e3 * DELTA[2], abs=1e-9)


def test_gcode_moves_to_the_planned_poses(oed, tmp_path):
    poses = [{"z_mm": 1186.0, "psi_deg": 30.0, "theta_deg": 12.5}]
    content = sample.result(
        a3_head.machine, a3_head.machine.nominal, design=sample.design(poses)
    )
    folder = sample.save(tmp_path / "a3", content)
    assert oed("compensate", folder, "--to", "gcode")[0] == 0
    text = (folder / "compensation.ngc").read_text("utf-8")
    assert "G1 Z1186.0000 A30.0000 B12.5000 F300\nG4 P2\n(reading 1, run 1)" in text
    assert text.endswith("M2\n")


# -- refusals --------------------------------------------------------------------------
def test_a_failed_fit_is_refused_unless_forced(oed, tmp_path):
    content = sample.result(linear_delta.machine, DELTA, chi2=2000.0)
    folder = sample.save(tmp_path / "bad", content)
    code, out, err = oed("compensate", folder, "--to", "klipper")
    assert (code, out) == (1, "")
    assert "10.0 times the stated noise" in err
    assert "--force" in err
    assert not (folder / "compensation.cfg").exists()
    assert oed("compensate", folder, "--to", "klipper", "--force")[0] == 0
    text = (folder / "compensation.cfg").read_text("utf-8")
    assert "written by --force: the residuals are 10.0 times" in text


@pytest.mark.parametrize(("chi2", "code"), [(180.0, 0), (20e3, 1)])
def test_an_estimated_noise_may_exceed_its_guess(chi2, code, oed, tmp_path):
    """3 times the guess is the noise; 30 times it is no noise."""
    law = NoiseRecord("reading", "s.height", 30.0, 3.0, "um", stated=10.0)
    checked = GoodnessSection(chi2, 20.0, 1.0, 0.0, noise={"reading s.height": law})
    content = sample.result(linear_delta.machine, DELTA, chi2=chi2, goodness=checked)
    folder = sample.save(tmp_path / "noisy", content)
    assert oed("compensate", folder, "--to", "klipper")[0] == code


def test_a_file_of_the_user_stays(oed, delta_folder, tmp_path):
    mine = tmp_path / "printer.cfg"
    mine.write_text("mine", "utf-8")
    code, _, err = oed("compensate", delta_folder, "--to", "klipper", "--out", mine)
    assert code == 2
    assert "printer.cfg: this file is there already; name another one" in err
    assert mine.read_text("utf-8") == "mine"


def test_bad_input_is_refused(oed, delta_folder, tmp_path):
    code, _, err = oed("compensate", delta_folder, "--to", "klippr")
    assert code == 2
    assert "did you mean klipper?" in err
    head = sample.result(a3_head.machine, a3_head.machine.nominal)
    head_folder = sample.save(tmp_path / "head", head)
    code, _, err = oed("compensate", head_folder, "--to", "linuxcnc")
    assert code == 2
    assert "linuxcnc cannot drive a3_head" in err
    code, _, err = oed("compensate", delta_folder, "--to", "gcode")
    assert code == 2
    assert "no planned poses" in err
    code, _, err = oed("compensate", tmp_path / "nowhere", "--to", "csv")
    assert code == 2


def test_a_format_of_the_users_own(oed, delta_folder, tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from pkm_studies.catalogue.controller_format import ControllerFormat\n"
        "controller = ControllerFormat(name='mine', about='', source='',\n"
        "    write=lambda c: {'.txt': f'{c.parameter(\"radius\"):.4f}'})\n",
        "utf-8",
    )
    assert oed("compensate", delta_folder, "--to", file)[0] == 0
    assert (delta_folder / "compensation.txt").read_text() == f"{DELTA[0]:.4f}"


def nominal_delta() -> StudyResult:
    """The nominal machine as identified, with its table."""
    machine = linear_delta.machine
    content = sample.result(machine, machine.nominal)
    return msgspec.structs.replace(content, machine=describe.machine_info(machine))


def test_a_machine_in_a_file_of_the_user_needs_its_study(oed, tmp_path):
    """A result runs no code, also where study and machine lie beside it."""
    source = "from pkm_models.machines.linear_delta import machine\n"
    (tmp_path / "my.py").write_text(source, "utf-8")
    text = sample.study_text("linear_delta").replace("linear_delta", "my.py")
    study = tmp_path / "sample.study.toml"
    study.write_text(text, "utf-8")
    content = msgspec.structs.replace(nominal_delta(), study_text=text)
    folder = sample.save(tmp_path / "report", content)
    for command in ("compensate", folder, "--to", "csv"), ("verify", folder):
        code, _, error = oed(*command)
        assert code == 2
        assert "my.py, and a result runs no code; give the study: --study" in error
    assert oed("compensate", folder, "--to", "csv", "--study", study)[0] == 0


@pytest.mark.parametrize(("model", "nominal", "words"), [
    ("linear_delta", "[machine.nominal]\nradius_mm = 99.0\n", "radius = 99 for"),
    ("planar_2dof", "", "planar_2dof for linear_delta"),
])  # fmt: skip
def test_the_study_that_is_given_is_that_of_the_result(
    oed, tmp_path, model, nominal, words
):
    folder = sample.save(tmp_path / "d", nominal_delta())
    old, new = 'model = "linear_delta"\n', f'model = "{model}"\n{nominal}'
    study = tmp_path / "other.study.toml"
    study.write_text(sample.study_text("linear_delta").replace(old, new), "utf-8")
    code, _, error = oed("compensate", folder, "--to", "csv", "--study", study)
    assert code == 2
    assert words in error


GRID = """
[prediction]
reference = "absolute"
z_mm = [1066.0, 1166.0, 1266.0]
psi_deg = { from = 0.0, to = 180.0, count = 7 }
theta_deg = [15.0, 25.0, 35.0]
"""
#: round the whole turn, twelve poses to a circle
ROUND = """
[prediction]
reference = "absolute"
z_mm = [1066.0, 1166.0, 1266.0]
psi_deg = { from = 0.0, to = 360.0, count = 12, endpoint = false }
theta_deg = [5.0, 15.0, 25.0, 35.0]
"""
NAMES, UNITS = ("z", "psi", "theta"), ("um", "arcsec", "arcsec")
ARCSEC = np.pi / 648000.0
FINE = np.array([1e-6, ARCSEC, ARCSEC])
#: a controller that reads joints in steps of 50 um
COARSE = """
import dataclasses

import numpy as np

from pkm_studies.catalogue.controller_format import ControllerFormat
from pkm_studies.compensation.formats import json_file


def joints(texts, content):
    return 50e-6 * np.round(json_file.joints(texts, content) / 50e-6)


controller = ControllerFormat(
    name="coarse", about="", source="", write=json_file.write, joints=joints
)
"""
SD = np.r_[np.full(3, 20e-6), np.zeros(21)]
TABLE3 = a3.errors(*(a3.TABLE3[k] for k in ("dq", "db", "da0", "beta")))


def errors(p: np.ndarray, q: np.ndarray, command: np.ndarray) -> np.ndarray:
    """Errors (n, 3) of z, psi and theta of the oracle's machine, in um and arcsec."""
    real = a3.forward(p, q)
    psi, theta, _ = a3.euler(real.R)
    turned = np.angle(np.exp(1j * (psi - command[:, 1])))
    found = np.column_stack([real.tip[:, 2] - command[:, 0], turned])
    return np.column_stack([found, theta - command[:, 2]]) / FINE


def rms(values: list[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.array(values) ** 2, axis=(0, 1)))


def commands() -> np.ndarray:
    z, psi = [1.066, 1.166, 1.266], np.deg2rad(np.linspace(0.0, 180.0, 7))
    mesh = np.meshgrid(z, psi, np.deg2rad([15.0, 25.0, 35.0]), indexing="ij")
    return np.column_stack([axis.ravel() for axis in mesh])


def exported(
    folder: Path,
    base: np.ndarray,
    to: str,
    grid: str = GRID,
    options: tuple[str, ...] = (),
    reference: str = "absolute",
) -> BudgetSection:
    """The budget that the command writes, of a machine predicted to err by `base`."""
    predicted = dict(zip(NAMES, base.tolist(), strict=True))
    line = BudgetLine("readings", "instrument", dict.fromkeys(NAMES, 1.0), predicted)
    spreads = {
        name: SpreadRecord(value, 2.0 * value, 3.0 * value, unit)
        for (name, value), unit in zip(predicted.items(), UNITS, strict=True)
    }
    section = PredictionSection(
        reference=reference,
        components={
            name: ComponentAccuracy(True, spread, spread, spread, {})
            for name, spread in spreads.items()
        },
        unit=dict(zip(NAMES, UNITS, strict=True)),
        poses=0,
        map=[],
        mode="identified",
        budget=BudgetSection(predicted, [line]),
    )
    content = sample.result(a3_head.machine, TABLE3, prediction=section)
    text = content.study_text + grid.replace("absolute", reference)
    sample.save(folder, msgspec.structs.replace(content, study_text=text))
    assert main(["compensate", str(folder), "--to", to, *options]) == 0
    written = (folder / "compensation_budget.json").read_bytes()
    return msgspec.json.decode(written, type=BudgetSection)


def test_rounding_costs_what_its_line_says(tmp_path, capsys):
    """Machines drawn about the identified one, with joints in steps and without."""
    rng, command = np.random.default_rng(3), commands()
    machines = TABLE3 + SD * rng.standard_normal((60, 24))
    exact = compensated_joints(Kinematics(a3_head.machine), command, TABLE3)
    steps = 50e-6 * np.round(exact / 50e-6)
    base = rms([errors(p, exact, command) for p in machines])
    whole = rms([errors(p, steps, command) for p in machines])
    (tmp_path / "coarse.py").write_text(COARSE)
    budget = exported(tmp_path / "out", base, f"{tmp_path}/coarse.py:controller")
    values = np.array([budget.predicted[n] for n in NAMES])
    assert (whole > 1.05 * base).all()
    assert values == pytest.approx(whole, rel=0.03)
    rounding = budget.lines[-1]
    assert rounding.kind == "rounding"
    alone = rms([errors(TABLE3, steps, command)])
    assert [rounding.size[n] for n in NAMES] == pytest.approx(alone, rel=1e-3)
    assert rounding.without is not None
    assert [rounding.without[n] for n in NAMES] == pytest.approx(base, rel=1e-9)
    for name in NAMES:
        assert sum(line.share[name] for line in budget.lines) == pytest.approx(1.0)
    assert "with this file the predicted rms is" in capsys.readouterr().out.lower()


def test_a_budget_without_effects_is_not_that_over_all_answers(tmp_path, capsys):
    """Each figure says of which machine it is, where a diagnosis corrects nothing."""
    folder = tmp_path / "out"
    few = ("--commands", "120")
    exported(folder, np.array([10.0, 5.0, 5.0]), "json", options=few)
    gap = report_fixture.result_of(whole()).gap
    assert gap is not None
    gap = msgspec.structs.replace(gap, verdict="none")
    sample.save(folder, msgspec.structs.replace(load_result(folder), gap=gap))
    capsys.readouterr()
    assert main(["compensate", str(folder), "--to", "json", *few]) == 0
    printed = capsys.readouterr().out
    assert "Predicted rms over all hypotheses: " in printed
    [sentence] = [line for line in printed.splitlines() if "With this file" in line]
    counted, alone = sentence.split("; geometry alone with this file: ")
    assert "rms is z 66 um" in counted
    assert SCOPE_WORDS["mixture"] in counted
    assert alone.startswith("z 10 um")


def test_usual_effects_count_as_on_the_first_page(tmp_path, capsys):
    """30 um with usual effects where geometry alone leaves 10: one figure for both."""
    folder, few = tmp_path / "out", ("--commands", "120")
    exported(folder, np.array([10.0, 5.0, 5.0]), "json", options=few)
    result = load_result(folder)
    section = result.prediction
    assert section.budget is not None
    errors = dict.fromkeys(NAMES, 30.0)
    whole = {
        name: msgspec.structs.replace(
            component, after=msgspec.structs.replace(component.after, rms=30.0)
        )
        for name, component in section.components.items()
    }
    usual = UsualEffects(["home_reference"], errors, errors, whole)
    budget = msgspec.structs.replace(section.budget, usual=usual)
    section = msgspec.structs.replace(section, mode="plan", budget=budget)
    sample.save(folder, msgspec.structs.replace(result, prediction=section))
    capsys.readouterr()
    assert main(["compensate", str(folder), "--to", "json", *few]) == 0
    printed = capsys.readouterr().out
    [sentence] = [line for line in printed.splitlines() if "With this file" in line]
    assert f"rms is z 30 um, psi 30 arcsec, theta 30 arcsec, {WITH_USUAL_EFFECTS}" in (
        sentence
    )
    assert "geometry alone with this file: z 10 um" in sentence
    first = " ".join(first_lines(load_result(folder)).sentences)
    assert "predicted to be z 30 um" in first


def read_table(folder: Path) -> tuple[list[np.ndarray], np.ndarray]:
    """Places along each axis, and corrections (..., 3) of the joints; SI."""
    knots, rows = sample.table(folder)
    keys = ("z_mm", "psi_deg", "theta_deg")
    places = np.array([[float(r[key]) for key in keys] for r in rows]) * sample.FACTORS
    mesh = np.stack(np.meshgrid(*knots, indexing="ij"), axis=-1)
    assert places == pytest.approx(mesh.reshape(-1, 3), abs=1e-8)
    added = [[1e-3 * float(r[f"correction_q{k}_mm"]) for k in (1, 2, 3)] for r in rows]
    return knots, np.array(added).reshape(*mesh.shape)


def interpolated(folder: Path, command: np.ndarray) -> np.ndarray:
    """Joints (n, 3) of a nominal controller that adds the file's corrections."""
    knots, added = read_table(folder)
    reduced = command.copy()
    reduced[:, 1] %= 2.0 * np.pi
    return a3.inverse_nominal(*command.T) + RegularGridInterpolator(knots, added)(
        reduced
    )


#: rms errors that exact compensation leaves, um and arcsec
EXACT = np.array([97.0, 20.0, 1.2])


def test_interpolation_costs_what_its_line_says(tmp_path, capsys):
    """A nominal controller interpolates the table's corrections, by other code."""
    budget = exported(tmp_path, EXACT, "csv")
    knots, _ = read_table(tmp_path)
    low, high = (np.array([axis[end] for axis in knots]) for end in (0, -1))
    inside = 1e-9 * (high - low)
    rng = np.random.default_rng(8)
    command = rng.uniform(low + inside, high - inside, (4000, 3))
    realised = rms([errors(TABLE3, interpolated(tmp_path, command), command)])
    lines = {line.kind: line for line in budget.lines}
    sizes = [lines["interpolation"].size[n] for n in NAMES]
    assert sizes == pytest.approx(realised, rel=0.15)
    total = np.array([budget.predicted[n] for n in NAMES])
    assert total == pytest.approx(np.hypot(EXACT, sizes), rel=1e-3)
    assert "interpolation still costs" not in capsys.readouterr().out
    assert (total < 1.03 * EXACT).all()


@pytest.mark.slow
def test_accuracy_that_is_zeroed_at_home_has_the_corrections_of_home(tmp_path):
    """Home is upright, the errors count from a tilt of 5 degrees."""
    budget = exported(tmp_path, EXACT, "csv", ROUND, reference="home")
    knots, _ = read_table(tmp_path)
    home = a3_head.machine.home_command[None]
    assert [axis[0] for axis in knots] == pytest.approx(home[0], abs=1e-9)
    wanted = compensated_joints(Kinematics(a3_head.machine), home, TABLE3)
    assert interpolated(tmp_path, home) == pytest.approx(wanted, abs=2e-9)
    low, high = np.array([1.066, 0.0, np.deg2rad(5)]), np.array([1.266, 6.28, 0.61])
    command = np.random.default_rng(8).uniform(low, high, (4000, 3))
    realised = rms([errors(TABLE3, interpolated(tmp_path, command), command)])
    lines = {line.kind: line for line in budget.lines}
    sizes = np.array([lines["interpolation"].size[n] for n in NAMES])
    assert sizes == pytest.approx(realised, rel=0.15)
    assert (sizes < 0.25 * EXACT).all()


def test_machines_err_with_the_file_as_its_budget_predicts(tmp_path, capsys):
    """Machines drawn about the identified one; a coarse table, so that it counts."""
    rng = np.random.default_rng(3)
    machines = TABLE3 + SD * rng.standard_normal((60, 24))
    low, high = np.array([1.066, 0.0, np.deg2rad(5)]), np.array([1.266, 6.28, 0.61])
    command = rng.uniform(low, high, (400, 3))
    exact = compensated_joints(Kinematics(a3_head.machine), command, TABLE3)
    base = rms([errors(p, exact, command) for p in machines])
    budget = exported(tmp_path, base, "csv", ROUND, ("--commands", "120"))
    assert "interpolation still costs" in capsys.readouterr().out
    knots, _ = read_table(tmp_path)
    assert (knots[1][0], knots[1][-1]) == pytest.approx((0.0, 2.0 * np.pi))
    joints = interpolated(tmp_path, command)
    whole = rms([errors(p, joints, command) for p in machines])
    assert (whole > 1.1 * base).any()
    assert [budget.predicted[n] for n in NAMES] == pytest.approx(whole, rel=0.05)


def test_a_limit_below_the_coarsest_table_is_refused(tmp_path, capsys):
    folder = sample.save(tmp_path, sample.result(a3_head.machine, TABLE3))
    arguments = ["compensate", str(folder), "--to", "csv", "--commands", "19"]
    assert main(arguments) == 2
    assert "--commands 19" in capsys.readouterr().err
    assert not (folder / "compensation.csv").exists()


def test_without_a_prediction_or_a_formula_there_is_no_budget(tmp_path):
    folder = sample.save(tmp_path, sample.result(a3_head.machine, TABLE3))
    few = ("--commands", "120")
    assert main(["compensate", str(folder), "--to", "csv", *few]) == 0
    assert not (folder / "compensation_budget.json").exists()
    exported(tmp_path / "with", np.full(3, 1.0), "json", options=few)
    document = json.loads((tmp_path / "with/compensation_budget.json").read_text())
    assert {line["kind"] for line in document["lines"]} == {"instrument", "rounding"}


@pytest.mark.parametrize("joints", [np.zeros((3, 2)), np.full((2, 3), np.nan)])
def test_joints_of_a_format_are_a_row_a_command(joints):
    controller = ControllerFormat(
        name="own",
        about="",
        source="",
        write=lambda content: {},
        joints=lambda texts, content: joints,
    )
    content = SimpleNamespace(command=np.zeros((2, 3)), machine=a3_head.machine)
    with pytest.raises(InputError, match=r"are not \(2, 3\) finite numbers"):
        controller.driven_joints({}, content)


def test_the_largest_errors_without_a_drive_are_named():
    machine = a3_head.machine
    names = [c.name for c in machine.components]
    undriven = [c.name for c in machine.components if not c.compensatable]
    remaining = np.zeros((2, len(names)))
    remaining[0, names.index(undriven[0])] = -3e-6
    remaining[1, names.index(undriven[0])] = 1e-6
    (sentence,) = undriven_components(machine, remaining)
    assert f"{undriven[0]} 3" in sentence
    assert all(name in sentence for name in undriven)
    assert undriven_components(planar_2dof.machine, np.ones((2, 2))) == ()
