"""Two coordinates of the tool point: a camera over the plane, a grid plate, two laser
interferometers.

The instrument's frame is registered by a shift in the plane and a small turn about z,
unknown within their tolerances:

    y = (x, y)(tool point) turned by turn_z + (shift_x, shift_y).

Its noise is that of a grid encoder or a calibrated camera, 0.05 mm; the tolerances, 5
mm and 10 mrad, are those of an instrument put down by hand.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Cost, Frame, Instrument
from oed.model import Expr, Machine, Parameter, Values
from pkm_models.instruments import registration


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    point = frames[0].point
    x, y = point[0], point[1]
    cos, sin = ca.cos(s["turn_z"]), ca.sin(s["turn_z"])
    across = cos * x - sin * y + s["shift_x"]
    along = sin * x + cos * y + s["shift_y"]
    return [across, along]


def _unfit(machine: Machine) -> str | None:
    if "x" in {c.name for c in machine.pose}:
        return None
    return 'it does not move in x; use camera with channels = ["read_y", "read_z"]'


instrument = Instrument(
    name="planar_position",
    source="two-coordinate position readings in the x-y plane, as of a grid encoder",
    about="camera or grid plate: x and y of the tool point",
    channels=registration.point_channels(0.05e-3, "xy"),
    settings=(),
    nuisances=(
        *registration.unknowns(
            "shift", 5e-3, "m", "{} of the instrument's frame", "xy"
        ),
        Parameter("turn_z", 0.0, 10e-3, "rad", "turn of the instrument's frame"),
    ),
    cost=Cost(setup=900.0, reading=20.0),
    observe=_observe,
    unfit=_unfit,
)
