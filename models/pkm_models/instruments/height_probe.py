"""Touch probe that reads the height of the tool over the bed along z of the base frame.

The bed is taken as the plane z = 0; the trigger offset of the probe is unknown within
its tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.machine import Expr, Parameter, Values


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [frames[0].point[2] + s["offset"]]


instrument = Instrument(
    name="height_probe",
    source="touch probe of delta printers; height over the bed at the trigger",
    about="touch probe: height of the tool over the bed",
    channels=(Channel("height", "m", 0.02e-3),),
    settings=(),
    nuisances=(Parameter("offset", 0.0, 0.05e-3, "m", "trigger offset"),),
    cost=Cost(setup=120.0, reading=10.0),
    observe=_observe,
)
