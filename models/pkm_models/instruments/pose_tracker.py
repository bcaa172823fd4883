"""Pose tracker: position of the tool and its rotation, in a frame that is known up to
its registration.

`instrument`   six components: x, y, z and alpha, beta, gamma with R = Rx(alpha)
               Ry(beta) Rz(gamma), so that the tool axis is (sin beta, -sin alpha cos
               beta, cos alpha cos beta) as for the laser ball bar
`position`     position alone, as from a laser tracker and one reflector

A registration that is not known (tolerances not 0) hides what only moves the base frame
of the machine: the common motions of its base joints, as far as the parameters hold
them (of a `prs_spindle`, the shifts along X and Y).

Noise, one standard deviation: 10 um and 5 arcsec, a laser tracker with a six-component
target some 2 m away; the registration's tolerances, 0.05 mm and 0.05 mrad, are those of
a fit to a few reference points of the base.
"""

import dataclasses
import math
from collections.abc import Sequence

import casadi as ca

from oed.base import Orientation
from oed.instrument import Channel, Cost, Frame, Instrument
from oed.model import Expr, Values
from pkm_models.instruments import registration

SOURCE = "laser tracker with six-component target; ISO 10360-10 for the instrument"
ORIENTATION = Orientation.rotation(
    ("x", "read_alpha"), ("y", "read_beta"), ("z", "read_gamma")
)
FRAMES = f"{ORIENTATION.formula}, from the platform's frame to the instrument's"
POINT = registration.point_channels(10e-6)
ANGLES = tuple(
    Channel(f"read_{n}", "rad", 5.0 * math.pi / 648000.0, about=f"{about}; {FRAMES}")
    for n, about in (
        ("alpha", "angle about x, right-handed"),
        ("beta", "angle about the turned y, right-handed"),
        ("gamma", "angle about the tool axis, right-handed"),
    )
)


def _position(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return registration.coordinates_in_frame(s, frames[0].point)


def _pose(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    relative = registration.rotation_in_frame(s, frames[0].rotation)
    gamma = ca.atan2(-relative[0, 1], relative[0, 0])
    return [*_position(frames, s, k), *registration.axis_angles(relative[:, 2]), gamma]


instrument = Instrument(
    name="pose_tracker",
    source=SOURCE,
    about="tracker: position and orientation of the tool",
    channels=(*POINT, *ANGLES),
    settings=(),
    nuisances=registration.frame_parameters(0.05e-3, 0.05e-3),
    cost=Cost(setup=2700.0, reading=15.0),
    observe=_pose,
    orientation=ORIENTATION,
)

position = dataclasses.replace(
    instrument,
    name="pose_tracker_position",
    about="tracker: position of the tool alone",
    channels=POINT,
    cost=Cost(setup=2700.0, reading=10.0),
    observe=_position,
    orientation=None,
)
