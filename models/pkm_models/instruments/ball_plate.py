"""Calibrated artefacts with balls, probed by the machine itself: a ball plate, and
distances on it or on a step gauge.

Its certificate gives each ball's place in the plate's own frame. The machine probes a
ball, records its joints, and the certificate says where the tool point then was: y =
R(turn) (tool point - place) + shift. The plate's place is known to what laying it down
by hand leaves: shift and turn are unknown. Noise: probing and certificate, 0.15 um
each.

`distance`   the certified distance between two balls (or between faces of a step
             gauge): |x_1 - x_0|, whatever the artefact's place; a pair of balls is a
             run of two poses. Both ends are probed: 0.3 um. Its unknown is the
             certificate's scale, temperature included (0.2 K of a steel plate's 11.5e-6
             / K).

What they hide: the plate hides motions of the machine as a whole; distances hide them
as well.
"""

from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.model import Expr, Parameter, Values
from pkm_models.instruments import registration

SOURCE = "ISO 10360-2 (calibrated test lengths for coordinate measuring machines)"


BETWEEN = (
    "certified distance between this row's feature and that of the run's first row"
)


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return registration.coordinates_in_frame(s, frames[0].point - registration.place(k))


def _distance(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [ca.norm_2(frames[0].point - frames[1].point) / (1.0 + s["scale"])]


instrument = Instrument(
    name="ball_plate",
    source=SOURCE,
    about="ball plate: certified places of its balls, in the plate's own frame",
    channels=registration.point_channels(
        0.2e-6, about="{} of the probed ball, plate's frame", stem="ball"
    ),
    settings=registration.place_settings(
        "{} of the plate's origin in the base frame", (0.0, 0.0, 0.0)
    ),
    nuisances=registration.frame_parameters(0.5e-3, 5e-3),
    cost=Cost(setup=1800.0, reading=60.0),
    observe=_observe,
)

distance = Instrument(
    name="ball_distance",
    source=SOURCE,
    about="ball plate or step gauge: certified distance between two of its features",
    channels=(Channel("length", "m", 0.3e-6, about=BETWEEN),),
    settings=(),
    nuisances=(
        Parameter("scale", 0.0, 2.3e-6, "1", "scale of certificate and temperature"),
    ),
    cost=Cost(setup=1800.0, reading=120.0),
    observe=_distance,
    reference="run",
)
