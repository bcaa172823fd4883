"""Touched plane: the tool point touches a flat surface, wherever it is on it.

Constrained calibration: a granite plate, a gauge block or a ground face holds the tool
point P to a plane. With n the stated unit normal, u and v square to it and to each
other, and the offset and the two small tilts of the plane as unknowns,

    off = n . P - at - offset - tilt_u (P - c) . v + tilt_v (P - c) . u = 0,

first order in the tilts, which are rotations about u and v through the point c = at n.
For a horizontal plane u is x and v is y. A plane that is known has tolerances of 0. The
measurement is the joints recorded at the touches; files need no column for `off`.

Noise, one standard deviation: 1 um, trigger and flatness of a small plate.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Parameter, Values


def _axes(normal: Expr) -> tuple[Expr, Expr, Expr]:
    """Unit normal n and two directions u, v in the plane, right-handed (u, v, n)."""
    n = normal / ca.norm_2(normal)
    # The coordinate axis farthest from n, taken into the plane: x for a horizontal one.
    sizes = [abs(float(n[i])) for i in range(3)]
    axis = ca.DM([float(i == sizes.index(min(sizes))) for i in range(3)])
    u = axis - ca.dot(axis, n) * n
    u = u / ca.norm_2(u)
    return n, u, ca.cross(n, u)


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    normal = ca.DM([float(k[f"normal_{a}"]) for a in "xyz"])
    n, u, v = _axes(normal)
    point = frames[0].point
    tilted = s["tilt_u"] * ca.dot(point, v) - s["tilt_v"] * ca.dot(point, u)
    return [ca.dot(point, n) - k["at"] - s["offset"] - tilted]


def _plane(distance: float | None) -> Instrument:
    """The plane at a distance along its normal, m; a set-up has to state None."""
    return Instrument(
        name="touch_plane",
        source="Rugbani and Schreve, section VI: constrained calibration",
        about="tool point on a plane whose offset and two tilts are unknown",
        channels=(
            Channel(
                "off",
                "m",
                1e-6,
                about="tool point over the plane, along its normal; 0 where it touches",
            ),
        ),
        settings=(
            Setting(
                "at", "m", distance, "distance of the plane from the origin, along n"
            ),
            Setting("normal_x", "1", 0.0, "x of the plane's normal n"),
            Setting("normal_y", "1", 0.0, "y of the plane's normal n"),
            Setting("normal_z", "1", 1.0, "z of the plane's normal n"),
        ),
        nuisances=(
            Parameter("offset", 0.0, 1e-3, "m", "distance of the plane less `at`"),
            Parameter("tilt_u", 0.0, 5e-3, "rad", "tilt of the plane about u"),
            Parameter("tilt_v", 0.0, 5e-3, "rad", "tilt of the plane about v"),
        ),
        cost=Cost(setup=300.0, reading=10.0),
        observe=_observe,
        fixed_reading=lambda k: 0.0,
        implied=0.0,
        adapt=lambda machine: _plane(machine.home.get("z", 0.0)),
    )


instrument = _plane(None)
