"""Families of machines: any geometry assembles in the mode that is meant, against the
oracle of tests/oracles/machine_shapes.py, and studies describe them.
"""

import importlib
import itertools

import numpy as np
import pytest
from oracles import machine_shapes, wrist_shapes
from sample import refused, resolved

from oed.accuracy import ErrorMaps
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Family

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
