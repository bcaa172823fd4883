"""Orientation of the platform against the workpiece frame, row by row: by a level, dial
gauges or an autocollimator.

A ball bar sees a point of the platform. These instruments see how the platform is
turned, at home as a rule: Tian et al. (2016), Eq. (13), where the rotations of the
platform's frame A-uvw against the workpiece's O-XYZ at home are three rows of H. With
(u, v, w) the platform's axes in the base frame, a level along v and along u, and a dial
gauge along an edge that is parallel to u, read

    tilt_x = asin(v_z),        tilt_y = -asin(u_z),        spin = atan2(u_y, u_x).

An autocollimator reads the directions of a mirror's normal that is parallel to w:

    tilt_x = atan2(-w_y, w_z),        tilt_y = atan2(w_x, w_z).

To first order all of these are the components of the rotation vector. All are positive
as right-handed rotations about x, y and z.

`instrument`      all three rows
`level`           both tilts, against the horizontal
`autocollimator`  both tilts, against the axis of the autocollimator

The directions against which they read are taken as those of the base frame, as in the
paper, where this reading defines the frame: the tolerances of the zeros are 0, that is,
held. `tolerance = { zero_x_mrad = ... }` frees them. A level that is reversed has no
zero error.

Noise, one standard deviation: 10 urad for a level with a division of 0.02 mm/m, read to
half of it, and for an edge of 0.4 m with a dial gauge of 1 um division at both ends; 2.5
urad (0.5 arcsec) for an autocollimator.
"""

from collections.abc import Callable, Mapping, Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.model import Expr, Machine, Values
from pkm_models.instruments import registration

SOURCE = "Tian et al. 2016, section 3, Eq. (13)"
LEVEL_SIGMA = 10e-6  #: noise of a level, rad
AUTOCOLLIMATOR_SIGMA = 2.5e-6  #: noise of an autocollimator, rad
TURNS = "xyz"
U, V, W = 0, 1, 2
SLOPES = {
    "read_tilt_x": "slope of the platform's y axis over the horizontal, asin(v_z)",
    "read_tilt_y": "slope of the platform's x axis under the horizontal, -asin(u_z)",
}
SPIN = {
    "read_spin": "direction of the platform's x axis in plan, from x to y, atan2(u_y, u_x)"
}
NORMAL = {
    "read_tilt_x": "tilt of the platform's z axis about x, atan2(-w_y, w_z)",
    "read_tilt_y": "tilt of the platform's z axis about y, atan2(w_x, w_z)",
}


def _slopes(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    """Slopes of the platform's v and u axes over the horizontal."""
    rotation = frames[0].rotation
    return [
        ca.asin(rotation[2, V]) + s["zero_x"],
        -ca.asin(rotation[2, U]) + s["zero_y"],
    ]


def _with_spin(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    """The slopes, and the direction of the u axis in plan."""
    u = frames[0].rotation[:, U]
    return [*_slopes(frames, s, k), ca.atan2(u[1], u[0]) + s["zero_z"]]


def _normal(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    """Directions of a mirror's normal along the platform's w axis."""
    w = frames[0].rotation[:, W]
    return [ca.atan2(-w[1], w[2]) + s["zero_x"], ca.atan2(w[0], w[2]) + s["zero_y"]]


def _orientation(
    name: str,
    about: str,
    channels: Mapping[str, str],
    sigma: float,
    observe: Callable[[Sequence[Frame], Values, Values], list[Expr]],
    cost: Cost,
) -> Instrument:
    about_zero = "zero of the reading about {}; held unless freed"
    axes = TURNS[: len(channels)]
    zeros = registration.unknowns("zero", 0.0, "rad", about_zero, axes)

    def unfit(machine: Machine) -> str | None:
        """A platform whose turns it does not read, as a level's in a plane."""
        pose = {c.name: ca.SX.sym(c.name) for c in machine.pose}
        frame = Frame(*machine.platform(pose))
        read = ca.vertcat(*observe([frame], {z.name: 0.0 for z in zeros}, {}))
        if ca.depends_on(read, ca.vertcat(*pose.values())):
            return None
        return "its platform keeps the orientation that is read"

    return Instrument(
        name=name,
        source=SOURCE,
        about=about,
        channels=tuple(
            Channel(n, "rad", sigma, about=about) for n, about in channels.items()
        ),
        settings=(),
        nuisances=zeros,
        cost=cost,
        observe=observe,
        unfit=unfit,
    )


instrument = _orientation(
    "home_orientation",
    "level and dial gauges: rotations of the platform about x, y and z at home",
    SLOPES | SPIN,
    LEVEL_SIGMA,
    _with_spin,
    Cost(setup=600.0, reading=120.0),
)

level = _orientation(
    "level",
    "level on the platform: its tilts about x and y",
    SLOPES,
    LEVEL_SIGMA,
    _slopes,
    Cost(setup=300.0, reading=60.0),
)

autocollimator = _orientation(
    "autocollimator",
    "autocollimator and a mirror on the platform: its tilts about x and y",
    NORMAL,
    AUTOCOLLIMATOR_SIGMA,
    _normal,
    Cost(setup=1800.0, reading=30.0),
)
