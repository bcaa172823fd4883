"""Length gauge in the spindle: the distance from the tool point to the machine's table,
along z of the base frame.

An incremental gauge reads how far its plunger is pushed in against a flat table. The
table is nearly square to z: its height over the base frame's origin and its two tilts
are unknowns of the set-up,

    y = z - at_z - height - tilt_x y_t + tilt_y x_t,

with (x_t, y_t, z) the tool point: the plane z = at_z + height + tilt_x y_t - tilt_y
x_t, first order in the tilts, which are rotations of the table about x and y. The
plunger is taken as in line with z, under the tool point whatever the tool's
inclination: what is read is the tool point's height over the table.

What it adds to ball bars, whose lengths no common turn of machine and cup changes, is
the direction of z: it is worth as much as the table's tilts are known. They are taken
as levelled against the head's base to 0.02 mm/m, the division of a precision level.

A gauge's range is limited (`STROKE`): a study lets it read heights within the stroke
alone, and writes the rest to either side as `travel_mm`, beyond which a reading of a
head that is far off is lost.

Noise, one standard deviation: 1 um, for an incremental gauge of 100 mm with an accuracy
of +-1 um (one of 60 mm has +-0.5 um) on a table whose flatness adds as much. Time: a
gauge in a collet over a clean table is mounted in five minutes; a reading takes as long
as the head takes to settle, six seconds.
"""

from collections.abc import Sequence

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Parameter, Values


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    point = frames[0].point
    return [
        point[2]
        - k["at_z"]
        - s["height"]
        - s["tilt_x"] * point[1]
        + s["tilt_y"] * point[0]
    ]


instrument = Instrument(
    name="length_gauge",
    source="incremental length gauge of 100 mm and +-1 um in the spindle, against a flat table",
    about=(
        "length gauge of 1 um: height of the tool over the table, whose height and"
        " tilts are unknown"
    ),
    channels=(
        Channel(
            "height",
            "m",
            1.0e-6,
            about="height of the tool point over the table, along z of the base frame",
        ),
    ),
    settings=(
        Setting("at_z", "m", 0.0, "z of the table, as set up, in the base frame"),
    ),
    nuisances=(
        Parameter(
            "height", 0.0, 1.0e-3, "m", "height of the table over the stated one"
        ),
        Parameter("tilt_x", 0.0, 0.02e-3, "rad", "tilt of the table about x"),
        Parameter("tilt_y", 0.0, 0.02e-3, "rad", "tilt of the table about y"),
    ),
    cost=Cost(setup=300.0, reading=6.0),
    observe=_observe,
)
