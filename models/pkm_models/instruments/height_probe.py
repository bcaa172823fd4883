"""Touch probe that reads the height of the tool over the bed along z of the base frame.

The bed is taken as the plane z = 0; the trigger offset of the probe is unknown within
its tolerance. `tilted_bed` frees the bed's two tilts as well, rotations about x and y:

    y = z + offset - tilt_x y_t + tilt_y x_t,

with (x_t, y_t, z) the tool point, first order in the tilts. `contact_probe` stops the
machine where it touches: the pose is the measurement, and the reading is the height at
which the probe triggers, over a bed of known slopes,

    y = z + offset - bed_slope_x x_t - bed_slope_y y_t.
"""

import dataclasses
from collections.abc import Sequence

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Parameter, Values


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    point = frames[0].point
    along_x = s.get("tilt_y", 0.0) - k.get("bed_slope_x", 0.0)
    along_y = -s.get("tilt_x", 0.0) - k.get("bed_slope_y", 0.0)
    return [point[2] + s["offset"] + along_x * point[0] + along_y * point[1]]


OFFSET = Parameter("offset", 0.0, 0.05e-3, "m", "trigger offset")
TILTS = (
    Parameter("tilt_x", 0.0, 5e-3, "rad", "tilt of the bed about x"),
    Parameter("tilt_y", 0.0, 5e-3, "rad", "tilt of the bed about y"),
)
HEIGHT = Channel(
    "height",
    "m",
    0.02e-3,
    about="height of the tool point over the bed, along z of the base frame, up",
)

CONTACT = dataclasses.replace(
    HEIGHT,
    about=(
        "height of the tool point over the stated slopes of the bed at contact, along z"
        " of the base frame, up"
    ),
)

instrument = Instrument(
    name="height_probe",
    source="touch probe of delta printers; height over the bed at the trigger",
    about="touch probe: height of the tool over the bed",
    channels=(HEIGHT,),
    settings=(),
    nuisances=(OFFSET,),
    cost=Cost(setup=120.0, reading=10.0),
    observe=_observe,
    held=TILTS,
)

tilted_bed = dataclasses.replace(
    instrument,
    name="height_probe_tilted_bed",
    about="touch probe: height of the tool over a bed whose tilts are unknown",
    nuisances=(OFFSET, *TILTS),
    held=(),
)

contact = dataclasses.replace(
    instrument,
    name="contact_probe",
    about="touch probe that stops the machine: the pose at contact is the measurement",
    channels=(CONTACT,),
    settings=(
        Setting("bed_slope_x", "1", 0.0, "rise of the bed along x"),
        Setting("bed_slope_y", "1", 0.0, "rise of the bed along y"),
    ),
    implied=0.0,
)
