"""Hexapod and hexaglide: oracles that know no orientation, ranks, closed forms."""

import re

import numpy as np
import pytest
from oracles import hexapod_geometry as oracle
from shipped_models import ball_bar, pose_tracker

from oed.base import Array
from oed.identifiability import Assessment, explain, lost_motions
from oed.instrument import Setup, mount
from oed.measurement import Measurement, commands_at_fixed_reading
from oed.mechanism import Kinematics
from oed.result import IdentifiabilityFinding
from pkm_models.machines import hexaglide, hexapod

MACHINE = hexapod.machine
KINEMATICS = Kinematics(MACHINE)
# the tracker's frame is the base frame
KNOWN = {f"{kind}_{n}": 0.0 for kind in ("shift", "turn") for n in "xyz"}
NO_TOOL = np.zeros(3)


def commands(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform(
        [c.lower for c in MACHINE.command], [c.upper for c in MACHINE.command], (n, 6)
    )


def geometry(p: Array) -> tuple[Array, Array, Array]:
    """Base joints (6, 3), platform joints (6, 3) and leg zeros (6,) of a parameter vector (42,)."""
    base, local = (
        np.array([points[i] for i in hexapod.LEGS]) for points in (hexapod.B, hexapod.A)
    )
    return base + p[:18].reshape(6, 3), local + p[18:36].reshape(6, 3), p[36:]


def assembled(p: Array, q: Array, x: Array) -> tuple[Array, Array]:
    """Tool point and rotation by the oracle; x (6,) is a pose near it."""
    base, local, zeros = geometry(p)
    rotation, point, _ = KINEMATICS.frames(x[None], NO_TOOL)
    return oracle.forward(q + zeros, base, local, point[0] + local @ rotation[0].T)


# -- kinematics ------------------------------------------------------------------------
def test_newton_agrees_with_the_oracle(rng):
    tolerance = np.array([p.tolerance for p in MACHINE.parameters])
    x, q = KINEMATICS.inverse(commands(rng, 40))
    for xi, qi in zip(x, q, strict=True):
        p = 3.0 * tolerance * rng.standard_normal(42)
        found = KINEMATICS.forward(qi[None], p, xi[None])
        rotation, point, _ = KINEMATICS.frames(found, NO_TOOL)
        expected_point, expected_rotation = assembled(p, qi, xi)
        assert np.abs(point[0] - expected_point).max() < 1e-12
        assert np.abs(rotation[0] - expected_rotation).max() < 1e-12


def test_the_legs_at_home_are_told_by_the_generic_geometry():
    """Base and platform joint of a leg are 30 degrees apart on circles of 300 and 200
    mm, 600 mm over each other.
    """
    _, q = KINEMATICS.inverse(MACHINE.home_command[None])
    expected = np.sqrt(
        0.3**2 + 0.2**2 - 2.0 * 0.3 * 0.2 * np.cos(np.deg2rad(30.0)) + 0.6**2
    )
    assert q[0] == pytest.approx([expected] * 6, abs=1e-14)


# -- what is seen ----------------------------------------------------------------------
def look(setups: list[Setup], plans: list[Array]) -> Assessment:
    m = Measurement(MACHINE, setups)
    return Assessment.of(
        m, [m.series(s.name, c) for s, c in zip(setups, plans, strict=True)]
    )


def free_cup(tool: float = 0.0, **settings: float) -> Setup:
    at = {"at_x": 0.0, "at_y": 0.0, "at_z": 0.200} | settings
    return mount(
        ball_bar.free_cup, f"cup, tool {tool:.1f}", tool=(0.0, 0.0, tool), **at
    )


def held(rng: np.random.Generator, n: int) -> Array:
    """Commands that keep a 300 mm bar on the free cup: five coordinates at random, z
    led by the bar.
    """
    m = Measurement(MACHINE, [free_cup()])
    command, possible = commands_at_fixed_reading(
        m, "cup, tool 0.0", commands(rng, n), "z"
    )
    assert possible.all()
    return command


def lost(seen: Assessment) -> IdentifiabilityFinding:
    return next(f for f in explain(seen) if f.kind == "lost")


def test_full_poses_in_a_known_frame_see_42_of_42(rng):
    seen = look(
        [mount(pose_tracker.instrument, "pose", tolerances=KNOWN)], [commands(rng, 60)]
    )
    assert (len(seen.names), seen.identifiability.rank) == (42, 42)
    assert (seen.shrinkage < 0.7).all()


def test_seven_poses_are_enough_and_six_are_not(rng):
    """Six equations a pose, seven unknowns a leg: each leg needs seven poses."""
    tracker = [mount(pose_tracker.instrument, "pose", tolerances=KNOWN)]
    at = commands(rng, 7)
    assert look(tracker, [at]).identifiability.rank == 42
    assert look(tracker, [at[:6]]).identifiability.rank == 36


def test_a_free_frame_hides_the_base(rng):
    """42 + 6 of the registration; lost are the six motions of the base with the tracker's frame."""
    seen = look([mount(pose_tracker.instrument, "pose")], [commands(rng, 60)])
    assert (len(seen.names), seen.identifiability.rank) == (48, 42)
    motions, rest = lost_motions(seen.identifiability, MACHINE, seen.scale)
    assert len(motions) == 6
    assert len(rest) == 0
    assert all(
        "base joints" in m and "together with what pose is set up on" in m
        for m in motions
    )


def test_a_single_ball_distance_says_what_it_loses(rng):
    """36 of 45 at any number of poses: three turns of the platform joints about the
    ball, six motions of the base.
    """
    for n in (150, 600):
        seen = look([free_cup()], [held(rng, n)])
        assert (len(seen.names), seen.identifiability.rank) == (45, 36)
    told = lost(seen)
    assert told.text.startswith("Lost, 9 directions of 45: ")
    for axis in "xyz":
        assert (
            f"the rotation of the platform joints about the tool point, {axis} axis"
            in told.text
        )
        assert (
            f"the rotation of the base joints about the base centre, {axis} axis"
            in told.text
        )
        assert (
            f"the translation of the base joints along {axis} together with what"
            in told.text
        )
    assert "moving" not in told.text  # nothing is left that has no name


def test_its_remedies_are_computed_and_hold(rng):
    """Each remedy's number, tried for real with instruments that the words did not use."""
    bar, tracker = free_cup(), mount(pose_tracker.instrument, "pose", tolerances=KNOWN)
    point = mount(pose_tracker.position, "point", tolerances=KNOWN)
    at = held(rng, 150)
    told = lost(look([bar], [at])).remedies
    trials = {
        "a second tool, 100 mm longer": ([bar, free_cup(0.1)], 2, 48),
        "reading the tool's position too": ([bar, point], 6, 45),
        "reading all six pose components": ([bar, tracker], 9, 45),
    }
    for text, (setups, back, parameters) in trials.items():
        said = next(t for t in told if text in t)
        assert (
            "all lost directions" in said
            if back == 9
            else re.search(rf"recovers {back} of 9", said)
        )
        plans = [at + np.array([0, 0, s.tool[2], 0, 0, 0]) for s in setups]
        seen = look(setups, plans)
        assert len(seen.names) == parameters
        assert len(seen.names) - seen.identifiability.rank == 9 - back


def test_the_lost_turns_change_no_distance_at_any_size(rng):
    """Not only to first order: turn the six platform joints by 5 degrees about the ball."""
    m = Measurement(MACHINE, [free_cup()])
    series = m.series("cup, tool 0.0", held(rng, 30))
    angle = np.deg2rad(5.0)
    turn = np.array(
        [
            [np.cos(angle), 0, np.sin(angle)],
            [0, 1, 0],
            [-np.sin(angle), 0, np.cos(angle)],
        ]
    )
    local = np.array([hexapod.A[i] for i in hexapod.LEGS])
    theta = m.nominal
    theta[18:36] = (local @ turn.T - local).ravel()
    assert np.abs(theta).max() > 5e-3
    assert (
        np.abs(m.readings([series], theta) - m.readings([series], m.nominal)).max()
        < 1e-13
    )


HEXAGLIDE = hexaglide.machine
HEXAGLIDE_KINEMATICS = Kinematics(HEXAGLIDE)


def hexaglide_commands(rng: np.random.Generator, n: int) -> Array:
    return rng.uniform(
        [c.lower for c in HEXAGLIDE.command],
        [c.upper for c in HEXAGLIDE.command],
        (n, 6),
    )


def test_newton_of_the_hexaglide_agrees_with_the_oracle(rng):
    """Carriages that stand still and struts of known length are a hexapod's feet and legs."""
    base, local = (
        np.array([points[i] for i in hexaglide.LEGS])
        for points in (hexaglide.B, hexaglide.A)
    )
    tolerance = np.array([p.tolerance for p in HEXAGLIDE.parameters])
    x, q = HEXAGLIDE_KINEMATICS.inverse(hexaglide_commands(rng, 30))
    for xi, qi in zip(x, q, strict=True):
        p = 3.0 * tolerance * rng.standard_normal(42)
        found = HEXAGLIDE_KINEMATICS.forward(qi[None], p, xi[None])
        rotation, point, _ = HEXAGLIDE_KINEMATICS.frames(found, NO_TOOL)
        carriages = base + np.column_stack([qi + p[:6], p[6:18].reshape(6, 2)])
        joints = local + p[18:36].reshape(6, 3)
        rough, about, _ = HEXAGLIDE_KINEMATICS.frames(xi[None], NO_TOOL)
        expected = oracle.forward(
            0.8 + p[36:], carriages, joints, about[0] + joints @ rough[0].T
        )
        assert np.abs(point[0] - expected[0]).max() < 1e-12
        assert np.abs(rotation[0] - expected[1]).max() < 1e-12


def test_no_pose_of_the_workspace_is_near_a_singular_one(rng):
    """Corners and 2000 poses between: struts in Pluecker coordinates; carriages in
    their travel and never passing.
    """
    low, high = (
        np.array([getattr(c, side) for c in HEXAGLIDE.command])
        for side in ("lower", "upper")
    )
    corners = np.array(np.meshgrid(*np.column_stack([low, high]))).reshape(6, -1).T
    x, q = HEXAGLIDE_KINEMATICS.inverse(
        np.vstack([corners, hexaglide_commands(rng, 2000)])
    )
    base, platform, _ = HEXAGLIDE_KINEMATICS.struts(x, q, HEXAGLIDE.nominal)
    along = (platform - base) / hexaglide.STRUT
    moment = np.cross(platform - x[:, None, :3], along) / hexaglide.PLATFORM
    values = np.linalg.svd(np.concatenate([along, moment], -1), compute_uv=False)
    assert values[:, -1].min() > 0.3
    assert values[:, 0].max() < 2.2
    # no strut is across its guide, where its carriage would move nothing
    assert np.abs(along[..., 0]).min() > 0.45
    assert all(
        c.lower < v.min() and v.max() < c.upper
        for c, v in zip(HEXAGLIDE.joints, q.T, strict=True)
    )
    assert (q[:, 1::2] - q[:, ::2]).min() > 0.9
