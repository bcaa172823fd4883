"""Seat: the tool ball rests in a fixed seat while the platform turns about it.

Constrained calibration: a magnetic cup of three balls on the table keeps the centre of
the tool ball, the tool point P, at one place, whatever the orientation. With the stated
place `at` and its unknown offset, the readings are by how far P is from it,

    miss = P - at - seat = 0,

in x, y and z of the base frame. The measurement is the joints that were recorded while
the ball sat, with the motors yielding; files need no columns for the misses. Three
gauges about a ball that does not sit (an R-test, ISO 230-7) read the same numbers.

Another seat is another set-up. A machine of three or fewer degrees of freedom cannot
move with its tool point held.

Noise, one standard deviation: 1 um, the repeatability of a magnetic seat of three balls.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Cost, Frame, Instrument
from oed.model import Expr, Machine, Values
from pkm_models.instruments import registration

AXES = "xyz"
REPEATABILITY = 1e-6  #: how exactly a seat takes the tool again, m
SEAT_TOLERANCE = 1e-3  #: tolerance of where the seat is, m


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    seat = ca.vertcat(*[k[f"at_{n}"] + s[f"seat_{n}"] for n in AXES])
    return list(ca.vertsplit(frames[0].point - seat))


def _unfit(machine: Machine) -> str | None:
    if len(machine.command) > len(AXES):
        return None
    return "with the tool point in a seat it could not move"


def _seat(home: Sequence[float | None]) -> Instrument:
    """The seat near a point (3,), m; a set-up has to state what is None there."""
    return Instrument(
        name="seat",
        source="Rugbani and Schreve, section VI: constrained calibration; ISO 230-7",
        about="tool ball in a seat of unknown place: the point stays, the platform turns",
        channels=registration.point_channels(
            REPEATABILITY,
            about="{} of the tool point less the seat's, base frame; 0 in the seat",
            stem="miss",
        ),
        settings=registration.place_settings(
            "{} of the seat in the base frame, about", home
        ),
        nuisances=registration.unknowns(
            "seat", SEAT_TOLERANCE, "m", "{} of the seat less the stated"
        ),
        cost=Cost(setup=300.0, reading=15.0),
        observe=_observe,
        unfit=_unfit,
        implied=0.0,
        adapt=lambda machine: _seat([machine.home.get(n) for n in AXES]),
        fixed_point=True,
    )


instrument = _seat([None, None, None])
