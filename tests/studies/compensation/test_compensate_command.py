"""`oed compensate`: files that controllers read, by formulas written here."""

import csv
import json
import re
from pathlib import Path

import compensation_sample as sample
import msgspec
import numpy as np
import pytest
from oracles import delta_trilateration as delta
from shipped_models import a3_head, hexapod, linear_delta, micro_cmm

from oed.compensate import compensated_joints
from oed.mechanism import Kinematics
from oed.result import GoodnessSection, NoiseRecord, StudyResult
from pkm_studies import describe

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
