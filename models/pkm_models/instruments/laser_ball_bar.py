"""Laser ball bar: a telescoping bar on a gimbal reads a ball at the tool by distance R,
elevation theta, azimuth phi.

Wang and Fan (2004), section 5: R by laser, theta and phi by rotary encoders, turned
into Cartesian coordinates; the spindle axis from two places of the ball, A and B, where
a standard bar in the spindle is retracted and extended by `baseline`. With the gimbal
at G and u(theta, phi) the unit vector, an error of the readings moves a point by

    u dR + R u_theta dtheta + R u_phi dphi,

so that x, y, z are correlated with each other, and with alpha and beta, whose A is
theirs too: `sources`. B lies away from the platform, B = A - baseline n, with n = (sin
beta, -sin alpha cos beta, cos alpha cos beta), Eq. (15).

`instrument`   position and axis
`position`     position alone

Noise: R 0.3 um, theta and phi 1.15 arcsec, the accuracies the paper states, taken as
one standard deviation each, as settings of their own; the channels' sigmas are what
they give 0.7 m away with a baseline of 100 mm, of which the paper says nothing. A study
that states a channel's sigma scales that row.

Unknown is the frame: the bar is aligned with the machine's Y axis (section 5.2), taken
as good to 0.1 mm and 0.1 mrad here. It hides two directions of a `prs_spindle`:
shifting all sliders along X or Y is shifting the frame. Its rotations are seen against
the guides, which are vertical, and its height, hardly, against the struts' lengths.

A file may have R, theta and phi of A and B themselves (section 5.2, (c) and (d)):
`range_a`, `elevation_a`, `azimuth_a` and so on, with theta up from the horizontal and phi
from x to y. Then A = G + R (cos theta cos phi, cos theta sin phi, sin theta), and n is that
of A - B.

The paper's three laser scales on the sliders are no readings of this kind: with them
the sliders' true heights, the joints q, are known, whatever the machine's own scales
show. A readings file gives them as q1_mm, q2_mm, q3_mm.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from oed import units
from oed.base import Array, Orientation
from oed.instrument import Channel, Cost, Frame, InnerReading, Instrument, Setting
from oed.model import Expr, Values
from pkm_models.instruments import registration

SOURCE = "Wang and Fan 2004, Int. J. Mach. Tools Manuf. 44, section 5"
ORIENTATION = Orientation.direction(("x", "read_alpha"), ("y", "read_beta"))
FRAMES = (
    f"{ORIENTATION.formula} = (sin beta, -sin alpha cos beta, cos alpha cos beta), from"
    " ball B to ball A, along z of the platform's frame, in the instrument's frame"
)
POINT = registration.point_channels(4e-6, about=f"{registration.COORDINATE}: ball A")
AXIS = tuple(
    Channel(f"read_{n}", "rad", 55e-6, about=f"{about}; {FRAMES}")
    for n, about in (
        ("alpha", "angle about x, right-handed"),
        ("beta", "angle about the turned y, right-handed"),
    )
)
SETTINGS = (
    *registration.place_settings("{} of the gimbal in the base frame"),
    Setting("range_noise", "m", 0.3e-6, "standard deviation of R"),
    Setting(
        "angle_noise", "rad", 1.15 * units.ARCSEC, "standard deviation of theta and phi"
    ),
)
BASELINE = Setting("baseline", "m", 0.100, "travel of the standard bar between A and B")

#: what R, theta and phi need, and why a zero may be wrong
INNER = (
    ("range", "m", "range_noise", "the length of the bar at its zero, or a dead path,"),
    ("elevation", "rad", "angle_noise", "the zero of the encoder"),
    ("azimuth", "rad", "angle_noise", "the zero of the encoder"),
)


def _inner(balls: int) -> tuple[InnerReading, ...]:
    """R, theta and phi of some balls, as `sources` has their errors."""
    return tuple(
        InnerReading(name, unit, noise, tuple(range(k, 3 * balls, 3)), zero)
        for k, (name, unit, noise, zero) in enumerate(INNER)
    )


def _ends(frame: Frame, s: Values, k: Values) -> tuple[Expr, Expr]:
    """A and B as the instrument sees them."""
    ends = (frame.point, frame.point - k["baseline"] * frame.rotation[:, 2])
    a, b = (registration.point_in_frame(s, end, registration.place(k)) for end in ends)
    return a, b


def _offset(a: Expr, b: Expr) -> list[Expr]:
    return [a[0], a[1], a[2], *registration.axis_angles(a - b)]


def _spread(point: Expr, k: Values) -> Expr:
    """Slopes (3 x 3) of a point over errors of R, theta, phi, in units of noise."""
    d = point - registration.place(k)
    flat = ca.sqrt(d[0] ** 2 + d[1] ** 2)
    up = ca.vertcat(-d[0] * d[2] / flat, -d[1] * d[2] / flat, flat)
    around = ca.vertcat(-d[1], d[0], 0.0)
    return ca.horzcat(
        k["range_noise"] * d / ca.norm_2(d),
        k["angle_noise"] * up,
        k["angle_noise"] * around,
    )


def _from_inner(raw: Mapping[str, Array], k: Mapping[str, float]) -> dict[str, Array]:
    """Place of A and direction of the axis, from R, theta and phi (n,) of A and B."""
    gimbal = np.array([k["at_x"], k["at_y"], k["at_z"]])
    a, b = (_from_gimbal(raw, ball) for ball in "ab")
    d = a - b
    return {
        **{f"read_{n}": gimbal[i] + a[:, i] for i, n in enumerate("xyz")},
        "read_alpha": np.arctan2(-d[:, 1], d[:, 2]),
        "read_beta": np.arctan2(d[:, 0], np.hypot(d[:, 1], d[:, 2])),
    }


def _from_gimbal(raw: Mapping[str, Array], ball: str) -> Array:
    """Place (n, 3) of a ball from the gimbal; NaN where it was not read."""
    names = [f"{one[0]}_{ball}" for one in INNER]
    absent = np.full(len(raw["range_a"]), np.nan)
    r, up, around = (raw.get(name, absent) for name in names)
    flat = r * np.cos(up)
    return np.column_stack(
        [flat * np.cos(around), flat * np.sin(around), r * np.sin(up)]
    )


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return _offset(*_ends(frames[0], s, k))


def _sources(frames: Sequence[Frame], s: Values, k: Values) -> Expr:
    """Slopes (5 x 6): R, theta, phi at A, then at B."""
    a, b = _ends(frames[0], s, k)
    e = ca.SX.sym("e", 6)
    read = ca.vertcat(*_offset(a + _spread(a, k) @ e[:3], b + _spread(b, k) @ e[3:]))
    return ca.substitute(ca.jacobian(read, e), e, ca.DM.zeros(6))


def _observe_position(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    a = registration.point_in_frame(s, frames[0].point, registration.place(k))
    return [a[0], a[1], a[2]]


def _sources_position(frames: Sequence[Frame], s: Values, k: Values) -> Expr:
    return _spread(
        registration.point_in_frame(s, frames[0].point, registration.place(k)), k
    )


instrument = Instrument(
    name="laser_ball_bar",
    source=SOURCE,
    about="laser ball bar on a gimbal: position of the tool and direction of the spindle axis",
    channels=(*POINT, *AXIS),
    settings=(*SETTINGS, BASELINE),
    nuisances=registration.frame_parameters(0.1e-3, 0.1e-3),
    cost=Cost(setup=3600.0, reading=60.0),
    observe=_observe,
    sources=_sources,
    inner=_inner(2),
    from_inner=_from_inner,
    orientation=ORIENTATION,
)

position = dataclasses.replace(
    instrument,
    name="laser_ball_bar_position",
    about="laser ball bar on a gimbal: position of the tool alone",
    channels=POINT,
    settings=SETTINGS,
    cost=Cost(setup=3600.0, reading=20.0),
    observe=_observe_position,
    sources=_sources_position,
    inner=_inner(1),
    orientation=None,
)
