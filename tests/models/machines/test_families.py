"""Families of machines: any geometry assembles in the mode that is meant, against oracles."""

import importlib
import itertools
from collections.abc import Callable
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from oracles import machine_shapes, new_families, wrist_shapes
from sample import refused, resolved

from oed.accuracy import ErrorMaps
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Family, Machine

CLOSURE = 1e-12  #: relative to the machine's size
POSES = 60
FAMILIES = machine_shapes.FAMILIES | wrist_shapes.FAMILIES


def _family(name: str) -> Family:
    module = importlib.import_module(f"pkm_models.machines.{name}")
    return module.machine.family  # type: ignore[no-any-return]


def _commands(machine, rng: np.random.Generator) -> np.ndarray:  # type: ignore[no-untyped-def]
    """Corners of the workspace, and poses inside."""
    ends = [(c.lower, c.upper) for c in machine.command]
    inside = rng.uniform(*np.transpose(ends), (POSES, len(ends)))
    return np.vstack([list(itertools.product(*ends)), inside])


def _size(geometry: machine_shapes.Geometry) -> float:
    """Largest distance of a joint at the base from the origin, or longest arm; m."""
    keys = [k for k in ("base", "guide", "anchor", "centre") if k in geometry]
    lengths = [k for k in ("arm", "lower", "strut") if k in geometry]
    far = [np.linalg.norm(geometry[k], axis=1).max() for k in keys]
    return float(max(far + [np.max(geometry[k]) for k in lengths]))


def _refusal(name: str, rng: np.random.Generator) -> str | None:
    """Draw a machine and judge it: the sentence of its refusal, or None."""
    draw, judge = FAMILIES[name]
    geometry = draw(rng)
    machine = _family(name).build(geometry)
    kinematics, command = Kinematics(machine), _commands(machine, rng)
    size = _size(geometry)
    try:
        x, q = kinematics.inverse(command)
        again = kinematics.start_poses(q)
    except AssemblyError as error:
        return str(error)
    lengths, mirrored = judge(geometry, x, q)
    assert np.abs(lengths).max() < CLOSURE * size
    assert not mirrored.any()
    lever = [size if c.unit == "m" else 1.0 for c in machine.pose]
    assert (np.abs(again - x) / lever).max() < CLOSURE
    return None


@pytest.mark.parametrize("name", FAMILIES)
def test_a_drawn_machine_closes_in_the_mode_that_is_meant(name, rng):
    assert _refusal(name, rng) is None


STUDY = """\
schema = 1
name = "tricept"

[machine]
model = "tripod_passive_leg"

[machine.geometry]
base_mm = [[0, 500, 0], [-433, -250, 0], [433, -250, 0]]
platform_mm = [[0, 200, 400], [-173, -100, 400], [173, -100, 400]]
home_mm = [0, 0, -1500]
reach_mm = 300

[[setup]]
name = "tracker"
instrument = "pose_tracker_position"
"""


def test_a_study_describes_a_tricept():
    machine = resolved(STUDY).machine
    nominal = {p.name: p.nominal for p in machine.parameters}
    assert nominal["b2x"] == pytest.approx(-0.433)
    assert [c.name for c in machine.command] == ["x", "y", "z"]
    x, q = Kinematics(machine).inverse(machine.home_command)
    assert q[0] == pytest.approx(np.hypot(0.3, 1.1), abs=1e-4)
    assert x[0] == pytest.approx([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])


def test_a_best_alignment_moves_no_place_that_compensation_has_put_right():
    """Turns of a Tricept's platform, which no leg corrects, stay out of the places."""
    machine = resolved(STUDY).machine
    command = np.array(list(itertools.product([-0.2, 0.2], [-0.2, 0.2], [-1.7, -1.3])))
    maps = ErrorMaps.of(Kinematics(machine), command, "best_fit")
    places, turns = maps.remaining[:, :3], maps.remaining[:, 3:]
    assert np.abs(turns).max() > 0.1
    assert np.abs(places).max() < 1e-9


@pytest.mark.parametrize(("old", "new", "said"), [
    ("[0, 500, 0], ", "", "2 x 3 numbers, where 3 x 3 belong"),
    ("[0, 500, 0]", "[0, 500]", "the rows differ in length"),
    ("home_mm = [0, 0, -1500]", "home_mm = [0, 0, -100]", "reaches the pivot"),
    ("reach_mm", "reech_mm", "did you mean reach_mm?"),
])  # fmt: skip
def test_a_geometry_that_does_not_fit_is_refused(old, new, said):
    assert said in str(refused(STUDY, (old, new)))


def test_too_few_cables_are_refused():
    family = _family("cables_planar")
    with pytest.raises(ValueError, match="1 cables are fewer than the 2 coordinates"):
        family.build({"anchor": np.ones((1, 2))})


Run = Callable[..., tuple[int, str, str]]
NAMES = tuple(new_families.CLOSURES)
WITH_LEGS = ("pentapod", "tripod_upr_spr", "tripod_wrist")


def model(name: str) -> Machine:
    return import_module(f"pkm_models.machines.{name}").machine  # type: ignore[no-any-return]


def commands(machine: Machine, rng: np.random.Generator, count: int) -> np.ndarray:
    low, high = np.array([(c.lower, c.upper) for c in machine.command]).T
    return rng.uniform(low, high, (count, len(low)))


@pytest.mark.parametrize("name", NAMES)
def test_poses_with_errors_are_those_of_the_description(name, rng):
    """All errors but those of directions, whose names each side may choose."""
    machine, errors = model(name), {}
    p = machine.nominal.copy()
    for k, parameter in enumerate(machine.parameters):
        if not parameter.name.startswith("tilt"):
            errors[parameter.name] = parameter.tolerance * rng.standard_normal()
            p[k] += errors[parameter.name]
    kinematics, command = Kinematics(machine), commands(machine, rng, 10)
    x, q = kinematics.inverse(command)
    reached = kinematics.forward(q, p, x)
    for start, joints, at in zip(x, q, reached, strict=True):
        assert new_families.pose(name, joints, {}, start) == pytest.approx(
            start, abs=1e-10
        )
        expected = new_families.pose(name, joints, errors, start)
        assert at == pytest.approx(expected, abs=1e-10)
        assert np.abs(at - start).max() > 1e-5


@pytest.mark.parametrize("name", NAMES)
def test_readings_see_what_the_description_lets_them_see(name, rng):
    """The same space of readings of the pose, hence the same rank."""
    machine = model(name)
    stems = [p.name for p in machine.parameters if not p.name.startswith("tilt")]
    tilted = {p.name[4] for p in machine.parameters if p.name.startswith("tilt")}
    turns = [f"turn{i}{k}" for i in sorted(tilted) for k in "xyz"]
    kinematics = Kinematics(machine)
    # half as many readings again as parameters
    count = -(-3 * len(machine.parameters) // (2 * len(machine.command)))
    x, q = kinematics.inverse(commands(machine, rng, count))
    ours = kinematics.slopes.pose_by_parameter(x, q, machine.nominal)
    theirs = [
        new_families.slopes(name, joints, pose, stems + turns)
        for pose, joints in zip(x, q, strict=True)
    ]
    ours, oracle = ours.reshape(-1, ours.shape[2]), np.vstack(theirs)
    ranks = [
        np.linalg.matrix_rank(scaled(h), tol=1e-6)
        for h in (ours, oracle, np.hstack([scaled(ours), scaled(oracle)]))
    ]
    assert ranks == [len(machine.parameters)] * 3


def scaled(h: np.ndarray) -> np.ndarray:
    size = np.linalg.norm(h, axis=0)
    return h / np.where(size > 1e-9, size, np.inf) / np.sqrt(h.shape[1])


@pytest.mark.parametrize("name", [n for n in NAMES if n not in WITH_LEGS])
def test_joints_turn_in_the_sense_of_their_words(name):
    machine = model(name)
    x, q = Kinematics(machine).inverse(machine.home_command)
    ahead = Kinematics(machine).struts(x, q + 1e-6, machine.nominal)[0][0]
    behind = Kinematics(machine).struts(x, q - 1e-6, machine.nominal)[0][0]
    motion = (ahead - behind) / 2e-6
    if name != "orthoglide":
        crank = [
            machine.nominal[machine.index(f"r{i + 1}")] for i in range(len(motion))
        ]
        assert np.linalg.norm(motion, axis=1) == pytest.approx(crank, abs=1e-6)
        assert "right-handed about its axis" in machine.joints[0].about
    if name == "orthoglide":
        assert motion == pytest.approx(np.eye(3), abs=1e-6)
    elif name == "five_bar":
        knee = 0.5 * (ahead + behind) - [[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0]]
        assert motion == pytest.approx(np.cross([0.0, 0.0, 1.0], knee), abs=1e-6)
    elif name == "rotary_delta":
        assert (motion[:, 2] < 0.0).all()
    else:
        assert (motion[:, 2] > 0.0).all()


def study(name: str, oed: Run, folder: Path) -> Path:
    instrument = "planar_position" if name == "five_bar" else "pose_tracker_position"
    chosen = ("--machine", name, "--instrument", instrument)
    file = folder / f"{name}.study.toml"
    assert oed("new", name, *chosen)[0] == 0
    assert oed("check", file)[0] == 0
    return file


@pytest.mark.usefixtures("own_folder")
@pytest.mark.parametrize("name", NAMES)
def test_a_new_study_passes_its_check(name, oed, tmp_path):
    assert study(name, oed, tmp_path).is_file()


@pytest.mark.parametrize("end", ["base", "platform"])
def test_legs_whose_revolute_axes_disagree_are_refused(end):
    family = model("tripod_upr_spr").family
    table = {d.name: np.array(d.default) for d in family.dimensions if d.name == end}
    table[end][1, 1] += 0.01
    with pytest.raises(ValueError, match=f"{end} joints 1 and 2 must"):
        family.build(table)
