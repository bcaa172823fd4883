"""Three coordinates of the tool point: a camera that follows markers, a laser tracker's
reflector, any position reader.

The instrument stands somewhere: its frame is registered with the machine's base frame
by a shift and a small turn, unknown within their tolerances
(`pkm_models.instruments.registration`), and it reads

    y = R(turn) (tool point) + shift.

`known_frame` is the same where the instrument's frame *is* the base frame: what it says
defines x, y and z. What a free registration hides: every motion of the machine as a
whole (its base joints together), which only the tolerances hold.
"""

import dataclasses
from collections.abc import Sequence

import casadi as ca

from oed.instrument import Cost, Frame, Instrument
from oed.model import Expr, Values
from pkm_models.instruments import registration

SOURCE = (
    "three-coordinate position readings; 1 mm is what markers on a mover a few metres"
    " away are seen to"
)


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return registration.coordinates_in_frame(s, frames[0].point)


instrument = Instrument(
    name="camera",
    source=SOURCE,
    about="camera: three coordinates of the tool point, frame registered with the machine's",
    channels=registration.point_channels(1.0e-3),
    settings=(),
    nuisances=registration.frame_parameters(5e-3, 10e-3),
    cost=Cost(setup=900.0, reading=20.0),
    observe=_observe,
)

known_frame = dataclasses.replace(
    instrument,
    name="camera_known_frame",
    about="camera: three coordinates of the tool point, in the machine's base frame",
    channels=registration.point_channels(
        1.0e-3, about="{} of the tool point in the base frame"
    ),
    nuisances=(),
    observe=lambda frames, s, k: list(ca.vertsplit(frames[0].point)),
)
