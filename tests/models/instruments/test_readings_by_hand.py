"""What each instrument reads of a pose, in NumPy and by SciPy's rotations."""

import casadi as ca
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from oed.instrument import Frame, Instrument
from pkm_models.instruments import (
    ball_bar,
    ball_plate,
    calliper,
    camera,
    height_probe,
    laser_ball_bar,
    length_gauge,
    planar_position,
    pose_tracker,
    relative,
    seat,
    touch_plane,
)

RNG = np.random.default_rng(8)
TURNS = Rotation.from_euler("XYZ", RNG.uniform(-0.5, 0.5, (2, 3)))
(X, Y, Z), OTHER = POINTS = RNG.uniform(0.2, 1.0, (2, 3))
POINT, WAY = POINTS[0], POINTS[0] - POINTS[1]
#: unknowns of the set-ups, and numbers that they state; SI
S = dict(scale=0.02, offset=0.03, height=0.04, tilt=0.05, tilt_x=0.06, tilt_y=0.07)
S |= dict(tilt_u=0.08, tilt_v=0.09)
K = dict(bed_slope_x=0.11, bed_slope_y=0.12, at=0.13, normal_z=1.0)
CUP, SEAT, SHIFT, TURN, AT = RNG.uniform(-0.1, 0.1, (5, 3))
for names, values in (("cup", CUP), ("seat", SEAT), ("shift", SHIFT), ("turn", TURN)):
    S |= {f"{names}_{axis}": value for axis, value in zip("xyz", values, strict=True)}
K |= {f"at_{axis}": value for axis, value in zip("xyz", AT, strict=True)}
SPIN = Rotation.from_euler("z", TURN[2])
FRAME = Rotation.from_rotvec([TURN[0], TURN[1], 0.0]) * SPIN
SEEN = FRAME.apply(POINT) + SHIFT
ACROSS = {"y": WAY[1] - S["tilt"] * WAY[2], "z": WAY[2] - S["tilt"] * WAY[1]}
LEVEL = Z + S["offset"]
TILTED = S["tilt_y"] * X - S["tilt_x"] * Y
ABOUT = FRAME.apply(POINT - AT) + AT + SHIFT
AXIS = (FRAME * TURNS[0]).as_matrix()[:, 2]
BY_HAND = [
    (ball_bar.instrument, [np.linalg.norm(WAY - CUP)]),
    (ball_bar.free_cup, [np.linalg.norm(POINT - AT - CUP)]),
    (ball_plate.instrument, FRAME.apply(POINT - AT) + SHIFT),
    (ball_plate.distance, [np.linalg.norm(WAY) / 1.02]),
    (calliper.instrument, [1.02 * np.linalg.norm(WAY)]),
    (camera.instrument, SEEN),
    (camera.known_frame, POINT),
    (height_probe.instrument, [LEVEL]),
    (height_probe.tilted_bed, [LEVEL + TILTED]),
    (height_probe.contact, [LEVEL - 0.11 * X - 0.12 * Y]),
    (laser_ball_bar.instrument, [*ABOUT, np.arctan2(-AXIS[1], AXIS[2]), np.arcsin(AXIS[0])]),
    (laser_ball_bar.position, ABOUT),
    (length_gauge.instrument, [Z - AT[2] - S["height"] + TILTED]),
    (planar_position.instrument, (SPIN.apply(POINT) + SHIFT)[:2]),
    (pose_tracker.instrument, [*SEEN, *(FRAME * TURNS[0]).as_euler("XYZ")]),
    (pose_tracker.position, SEEN),
    (relative.rm1, [WAY[1]]),
    (relative.rm2, [WAY[2]]),
    (relative.rm3, [ACROSS["z"]]),
    (relative.rm4, [ACROSS["y"]]),
    (relative.rm5, [WAY[1], ACROSS["z"]]),
    (seat.instrument, POINT - AT - SEAT),
    (touch_plane.instrument, [Z - 0.13 - S["offset"] - S["tilt_u"] * Y + S["tilt_v"] * X]),
]  # fmt: skip


@pytest.mark.parametrize(
    ("instrument", "expected"), BY_HAND, ids=[one.name for one, _ in BY_HAND]
)
def test_a_reading_is_as_by_hand(instrument: Instrument, expected: np.ndarray) -> None:
    frames = [
        Frame(ca.DM(turn.as_matrix()), ca.DM(point))
        for turn, point in zip(TURNS, POINTS, strict=True)
    ]
    free = {p.name for p in instrument.nuisances}
    stated = {setting.name: setting.default for setting in instrument.settings}
    s = {name: value for name, value in S.items() if name in free}
    k = {name: K.get(name, default) for name, default in stated.items()}
    read = instrument.observe(frames, s, k)
    assert len(read) == len(instrument.channels)
    assert [float(value) for value in read] == pytest.approx(list(expected), abs=1e-12)
