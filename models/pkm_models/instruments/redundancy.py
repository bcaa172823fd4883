"""The machine as its own instrument: by how much its redundant equation is missed.

A machine with one leg more than degrees of freedom cannot choose its joints freely: the
recorded joints close the machine only for the right parameters. With phi(x, q, p) the m
equations at the pose that fits them best, the reading is

    g = +- |phi| / m^1/2     (root mean square of the equations; the sign is that of the
                             redundant direction).

Where the joints were recorded on a machine that had settled freely (motors in torque
mode, encoders read), g = 0 was read, with the noise of the joints: e on each leg's
length gives e / m^1/2. It needs no other instrument, and sees no motion of the machine
as a whole, nor anything else that leaves the legs' lengths as they are.
"""

from __future__ import annotations

from collections.abc import Sequence

from oed.instrument import Channel, Cost, Frame, Instrument
from oed.machine import Expr, Machine, Values


def _observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [frames[0].closure_misfit]


def _unfit(machine: Machine) -> str | None:
    spare = len(machine.joints) - len(machine.command)
    return (
        None
        if spare == 1
        else f"it takes one joint more than degrees of freedom, here are {spare} more"
    )


instrument = Instrument(
    name="redundancy",
    source=(
        "self-calibration by redundant legs: Patel and Ehmann 2000, Int. J. Mach. Tools"
        " Manuf. 40, 489-512"
    ),
    about="closure of a redundant machine: by how much its legs' lengths disagree",
    channels=(Channel("gap", "m", 0.5e-3),),
    settings=(),
    nuisances=(),
    cost=Cost(setup=60.0, reading=10.0),
    observe=_observe,
    unfit=_unfit,
)
