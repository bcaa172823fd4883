"""Calliper on a machined or printed object: the distance between two places the tool
has been.

The first row of a run is its reference pose; each later row is the distance from it.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.model import Expr, Parameter, Values

BETWEEN = "distance between the tool points of this row and of the run's first row"


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [(1.0 + s["scale"]) * ca.norm_2(frames[0].point - frames[1].point)]


instrument = Instrument(
    name="calliper",
    source="distances on a test object; Klipper's enhanced delta calibration uses the same kind",
    about="calliper: distance between two tool positions",
    channels=(Channel("length", "m", 0.03e-3, about=BETWEEN),),
    settings=(),
    nuisances=(
        Parameter("scale", 0.0, 1e-3, "1", "scale of object and calliper (shrinkage)"),
    ),
    cost=Cost(setup=1800.0, reading=60.0),
    observe=_observe,
    reference="run",
)
