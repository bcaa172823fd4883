"""What the controller holds: from a result, parameters or a table; against plain numpy."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import compensation_sample as sample
import msgspec
import numpy as np
import pytest
import rounds
from numpy.typing import NDArray
from oracles import a3_geometry as a3
from shipped_models import a3_head, hexapod, linear_delta

from oed.accuracy import driven_errors
from oed.measurement import Measurement
from oed.result import StudyResult
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import ResolvedStudy, resolve
from pkm_studies.study import Study

Array = NDArray[np.float64]
Run = Callable[..., tuple[int, str, str]]
LONG = 0.15
STUDY = """
schema = 1
name = "round2"
[machine]
model = "a3_head"
controller = "{controller}"
[[setup]]
name = "bare"
instrument = "camera_known_frame"
[[setup]]
name = "long"
instrument = "camera_known_frame"
tool_mm = [0, 0, 150]
"""
TEACH = np.array([[a3.Z_TEACH, 0.0, 0.0]])
BAR = """
[[setup]]
name = "bar"
instrument = "ball_bar_free_cup"
length_mm = 300
at_x_mm = {:.9f}
at_y_mm = {:.9f}
at_z_mm = {:.9f}
[[design.reference]]
name = "circle"
setup = "bar"
z_mm = 1146
psi_deg = {{ from = 0, to = 360, count = 8, endpoint = false }}
theta = "hold"
"""
HELD = "replaces what the controller holds (../first)"


def errors(size: float, seed: int) -> Array:
    """A head with errors of a size, m, and of as many rad over the lever."""
    scale = np.r_[np.full(3, 5.0), np.full(18, 0.3), np.full(3, 5.0)]
    return size * scale * np.random.default_rng(seed).standard_normal(24)


def si(machine_values: Array) -> Array:
    names = [p.name for p in a3_head.machine.parameters]
    return np.array([machine_values[rounds.NAMES.index(n)] for n in names])


KNOWN = errors(1e-3, 1)
TRUTH = KNOWN + errors(0.02e-3, 2)


@pytest.fixture(scope="module")
def first_round(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the result and the files of a first round."""
    base = tmp_path_factory.mktemp("rounds")
    first = sample.save(base / "first", sample.result(a3_head.machine, si(KNOWN)))
    for form in ("json", "csv"):  # its errors are larger than the tolerances
        options = ["--to", form, "--force", "--commands", "200"]
        assert main(["compensate", str(first), *options]) == 0
    return base


@pytest.fixture
def folder(tmp_path: Path, first_round: Path) -> Path:
    shutil.copytree(first_round, tmp_path, dirs_exist_ok=True)
    return tmp_path


def resolved(folder: Path, controller: str) -> ResolvedStudy:
    path = folder / "round2.study.toml"
    return resolve(Study.parse(STUDY.format(controller=controller), path), readings=())


def measured(folder: Path, controller: str) -> Measurement:
    study = resolved(folder, controller)
    return study.measurement_with(study.setups)


def commands() -> Array:
    rng = np.random.default_rng(3)
    low, high = np.array([1.07, 0.0, 0.1]), np.array([1.26, 6.0, 0.5])
    return rng.uniform(low, high, (20, 3))


@pytest.mark.parametrize(
    "name", ["first", "first/compensation.json", "first/compensation_parameters.csv"]
)
def test_joints_are_those_of_the_controllers_parameters(folder, name):
    m = measured(folder, name)
    joints = rounds.of_parameters(KNOWN)
    for setup, tool in (("bare", 0.0), ("long", LONG)):
        command = commands() + np.array([tool, 0.0, 0.0])
        series = m.series(setup, command)
        q = joints(command, tool)
        assert np.abs(series.q - q).max() < 2e-11
        y = m.readings([series], np.r_[si(TRUTH), m.nominal[24:]]).reshape(-1, 3)
        tip = a3.forward(TRUTH, q, tool).tip
        assert np.abs(y - tip).max() < 1e-10


def test_joints_of_a_table_are_nominal_ones_with_its_corrections(folder):
    m = measured(folder, "first/compensation.csv")
    joints = rounds.of_table(folder / "first" / "compensation.csv")
    command = commands()
    sent = m.series("bare", command).q
    assert np.abs(sent - joints(command, 0.0)).max() < 1e-10
    # a longer tool on the same poses needs the same joints
    moved = command.copy()
    moved[:, 0] += LONG * np.cos(command[:, 2])
    assert np.abs(m.series("long", moved).q - sent).max() < 1e-9


def test_recorded_joints_stay_as_they_are(folder):
    m = measured(folder, "first")
    q = a3.inverse_nominal(*commands().T)
    assert np.abs(m.series_from_joints("bare", q).q - q).max() == 0.0


@pytest.mark.parametrize("name", ["first", "first/compensation.csv"])
def test_errors_before_compensation_are_those_that_the_controller_leaves(folder, name):
    kinematics = measured(folder, name).kinematics
    table = rounds.of_table(folder / "first" / "compensation.csv")
    joints = rounds.of_parameters(KNOWN) if name == "first" else table
    command = commands()
    left = driven_errors(kinematics, command, si(TRUTH), "absolute")
    names = [c.name for c in a3_head.machine.components]
    driven = left[:, [names.index(n) for n in ("z", "psi", "theta")]]
    exact = rounds.errors(TRUTH, joints, command)
    # Euler angles of small rotations: the twist's components are linear in them
    assert np.abs(driven - exact).max() < 0.01 * np.abs(exact).max()


def test_planned_readings_are_those_of_the_compensated_machine(folder):
    m = measured(folder, "first")
    series = m.series("bare", commands())
    y = m.expected_readings(series).reshape(-1, 3)
    tip = a3.forward(KNOWN, rounds.of_parameters(KNOWN)(commands(), 0.0)).tip
    assert np.abs(y - tip).max() < 1e-10


# -- refusals --------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "words"), [
    ("frist", "there is no folder"),
    (".", "there is no result.json"),
    ("first/compensation.cfg", "there is no folder"),
    ("none.json", "there is no file"),
    ("delta", "it is the result of another machine: a3_head for linear_delta"),
    ("delta.json", "it is the table of another machine"),
    ("empty", "nothing was identified there"),
    ("other.csv", "a3_head has no parameter l1"),
    ("slip.csv", "did you mean dq1?"),
    ("twice.csv", "twice.csv has several rows of dq1"),
    ("header.csv", "header.csv has no row"),
    ("units.csv", "dq1 has no number in a unit such as mm"),
    ("nominal.csv", "dq1 = 0 for 1 mm"),
    ("broken.json", "this is no table of parameters"),
    ("columns.csv", "has neither parameters nor a column correction_q1_mm"),
    ("alone.csv", "the axes of the table are missing"),
    ("first/result.txt", "this is no table of parameters"),
])  # fmt: skip
def test_what_cannot_be_the_controller_is_named(folder, oed, name, words):
    delta = sample.result(linear_delta.machine, linear_delta.machine.nominal)
    sample.save(folder / "delta", delta)
    empty = sample.result(a3_head.machine, a3_head.machine.nominal)
    sample.save(folder / "empty", msgspec.structs.replace(empty, estimate=None))
    table = (folder / "first" / "compensation.csv").read_text()
    texts = {
        "delta.json": json.dumps({"machine": "linear_delta", "parameters": {}}),
        "other.csv": "name,value,unit\nl1,1,mm\n",
        "slip.csv": "name,value,unit\ndqq1,1,mm\n",
        "twice.csv": "name,value,unit\ndq1,1,mm\ndq1,2,mm\n",
        "header.csv": "name,value,unit\n",
        "units.csv": "name,value,unit\ndq1,1,deg\n",
        "nominal.csv": "name,value,unit,nominal\ndq1,1,mm,1\n",
        "broken.json": "{",
        "columns.csv": "z_mm,psi_deg\n1,2\n3,4\n",
        "alone.csv": table,
        "first/result.txt": "dq1 = 1",
    }
    for file, text in texts.items():
        (folder / file).write_text(text)
    path = folder / "round2.study.toml"
    path.write_text(STUDY.format(controller=name))
    code, out, err = oed("check", path)
    assert code == 2
    assert words in out + err
    assert "machine.controller" in out + err or "_grid.csv" in out + err


def test_a_bar_is_held_where_the_compensated_machine_is(folder):
    """Commands of a circle of the bar, on the head that the controller believes in."""
    cup = a3.forward(KNOWN, rounds.of_parameters(KNOWN)(TEACH, 0.0)).tip[0]
    text = STUDY.format(controller="first") + BAR.format(*(1e3 * cup))
    study = resolve(Study.parse(text, folder / "round2.study.toml"), readings=())
    command = study.reference_plans[0].series[0].reading_commands()
    tip = a3.forward(KNOWN, rounds.of_parameters(KNOWN)(command, 0.0)).tip
    assert np.linalg.norm(tip - cup, axis=1) == pytest.approx(0.3, abs=1e-9)


def test_polishing_is_for_nominal_numbers(folder, oed):
    path = folder / "round2.study.toml"
    bar = STUDY.format(controller="first") + BAR.format(0, 0, 1286)
    path.write_text(bar + "[design.polish]\n")
    code, _, err = oed("check", path)
    assert code == 2
    assert "design.polish: polishing moves poses of a controller with nominal" in err


@pytest.mark.parametrize("table", ["controller", "earlier"])
def test_a_changed_grid_or_a_missing_session_is_noticed(folder, table):
    if table == "controller":
        grid = folder / "first" / "compensation_grid.csv"
        rows = grid.read_text().splitlines()
        grid.write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:]]) + "\n")
        with pytest.raises(InputError, match="its axes are psi_deg, z_mm"):
            resolved(folder, "first/compensation.csv")
        return
    text = STUDY.format(controller="first") + '[prior]\nearlier = "absent"\n'
    with pytest.raises(InputError, match=r"prior\.earlier.*there is no folder"):
        resolve(Study.parse(text, folder / "round2.study.toml"), readings=())


# -- the export of a later round -------------------------------------------------------
def compensated(folder: Path, content: StudyResult, form: str, oed: Run) -> str:
    code, out, err = oed("compensate", sample.save(folder, content), "--to", form)
    assert code == 0, err
    return out


@pytest.mark.parametrize(("machine", "form", "suffix"), [
    (linear_delta.machine, "klipper", ".cfg"),
    (linear_delta.machine, "rrf", ".g"),
    (linear_delta.machine, "marlin", ".gcode"),
    (linear_delta.machine, "json", ".json"),
    (linear_delta.machine, "csv", "_columns.csv"),
    (hexapod.machine, "linuxcnc", ".hal"),
], ids=lambda value: value if isinstance(value, str) else "")  # fmt: skip
def test_every_format_says_that_it_is_the_whole(tmp_path, oed, machine, form, suffix):
    first = sample.result(machine, machine.nominal)
    text = first.study_text.replace("[machine]", '[machine]\ncontroller = "../first"')
    later = msgspec.structs.replace(first, study_text=text)
    assert HELD in compensated(tmp_path / "later", later, form, oed)
    assert HELD not in compensated(tmp_path / "alone", first, form, oed)
    written = (tmp_path / "later" / f"compensation{suffix}").read_text("utf-8")
    alone = (tmp_path / "alone" / f"compensation{suffix}").read_text("utf-8")
    assert HELD in written
    # all errors of the machine, and not those since the first round
    if form == "json":
        one, other = json.loads(written), json.loads(alone)
        assert one["table"] == other["table"]
        assert one["parameters"] == other["parameters"]
    elif form != "csv":
        rows = [line for line in written.splitlines() if HELD not in line]
        assert rows == alone.splitlines()


# -- an earlier session as the prior ---------------------------------------------------
def session(covariance: Array) -> StudyResult:
    """A result whose estimate has this covariance of the free parameters, mm and mrad."""
    content = sample.result(a3_head.machine, si(KNOWN))
    frame = set(a3_head.machine.frame)
    rows = {n: p for n, p in content.estimate.parameters.items() if n not in frame}
    estimate = msgspec.structs.replace(
        content.estimate, parameters=rows, covariance=covariance.tolist()
    )
    return msgspec.structs.replace(content, estimate=estimate)


def test_the_posterior_of_an_earlier_session_is_the_prior(folder):
    rng = np.random.default_rng(4)
    root = 0.01 * rng.standard_normal((18, 18))
    covariance = root @ root.T
    sample.save(folder / "session", session(covariance))
    text = STUDY.format(controller="first") + '[prior]\nearlier = "session"\n'
    study = resolve(Study.parse(text, folder / "round2.study.toml"), readings=())
    m = study.measurement_with(study.setups)
    free = np.flatnonzero(m.free)
    assert len(free) == 18
    assert m.nominal[free] == pytest.approx(si(KNOWN)[free], rel=1e-12)
    assert (m.drawn == 0.0).all()
    prior = m.prior_covariance[np.ix_(free, free)]
    scale = 1e-6 * np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs(prior - 1e-6 * covariance).max() < 1e-9 * scale.max()
    # what is fixed stays at the drawing, and so does the pose that is wanted
    assert (study.machine.nominal == 0.0).all()
    x, _ = m.kinematics.inverse(commands())
    tip, _ = a3.nominal_pose(*commands().T)
    assert np.abs(x[:, :3] - tip).max() < 1e-10


@pytest.mark.parametrize(("table", "words"), [
    ('[[prior.correlated]]\nparameters = ["dq*"]\ncorrelation = 0.5', "has correl"),
    ('[plan]\nbudget_min = 10\n[[plan.measurement]]\nname = "a"\ncounts = [6]', "does not know it"),
    ("[machine.nominal]\ndq1_mm = 1", "dq1 = 1 for 0 mm"),
])  # fmt: skip
def test_what_the_posterior_of_a_session_does_not_go_with(folder, table, words):
    content = session(np.eye(18))
    rows = [{"name": "dq1", "nominal": 0.0, "tolerance": 1.0, "unit": "mm"}]
    machine = msgspec.structs.replace(content.machine, parameters=rows)
    sample.save(folder / "session", msgspec.structs.replace(content, machine=machine))
    text = STUDY.replace('controller = "{controller}"\n', "")
    text += f'[prior]\nearlier = "session"\n{table}\n'
    with pytest.raises(InputError, match=words):
        resolve(Study.parse(text, folder / "round2.study.toml"), readings=())
