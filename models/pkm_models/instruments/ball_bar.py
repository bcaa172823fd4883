"""Double ball bar: the distance between a cup on the table and a ball at the tool
point.

Tian et al. (2016), Eqs. (8)-(12). Two ways to know where the table cup is:

`instrument`   the cup was taught: the machine held it at a teach pose, so it sits where
               the real machine stood then, plus a small offset (the paper's row n^T
               [A_r,jk - A_r,s, -E]);
`free_cup`     the cup was set by hand near a stated place, and its three coordinates
               are unknown (row n^T [A_r,jk, -E]).
"""

import dataclasses
from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Parameter, Values
from pkm_models.instruments import registration

SOURCE = "Tian et al. 2016, section 3; ISO 230-4 for the instrument"
LENGTH = Setting("length", "m", 0.300, "nominal bar length")
CHANNEL = Channel(
    "length", "m", 0.5e-6, about="distance from the cup's centre to the tool ball's"
)
COST = Cost(setup=900.0, reading=6.0)
CUP = ("cup_x", "cup_y", "cup_z")  #: a magnetic cup seats elsewhere each time


def _offset(s: Values) -> Expr:
    return ca.vertcat(*[s[name] for name in CUP])


def _taught(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [ca.norm_2(frames[0].point - frames[1].point - _offset(s))]


def _free(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [ca.norm_2(frames[0].point - registration.place(k) - _offset(s))]


def _cup(tolerance: float) -> tuple[Parameter, ...]:
    return registration.unknowns("cup", tolerance, "m", "{} offset of the cup")


instrument = Instrument(
    name="ball_bar",
    source=SOURCE,
    about="double ball bar, table cup taught by the machine",
    channels=(CHANNEL,),
    settings=(LENGTH,),
    nuisances=_cup(0.02e-3),
    renewed=CUP,
    cost=COST,
    observe=_taught,
    reference="teach",
    fixed_reading=lambda k: k["length"],
)

free_cup = dataclasses.replace(
    instrument,
    name="ball_bar_free_cup",
    about="double ball bar, table cup set by hand",
    settings=(LENGTH, *registration.place_settings("{} of the cup in the base frame")),
    nuisances=_cup(1.0e-3),
    observe=_free,
    reference=None,
)
