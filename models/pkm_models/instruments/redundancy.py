"""The machine as its own instrument: by how much its redundant equations are missed.

A machine with more legs than degrees of freedom cannot choose its joints freely: the
recorded joints close the machine only for the right parameters. With phi(x, q, p) the m
equations at the pose that fits them best, and N (m x k) an orthonormal basis of the
null space of phi_x^T, one direction for each spare joint, the readings are

    g = N^T phi / m^1/2     (for one spare joint +- |phi| / m^1/2, `gap`; for more,
                             `gap1`, `gap2`, ...).

Where the joints were recorded on a machine that had settled freely (motors in torque
mode, encoders read), g = 0 was read, with the noise of the joints: e on each leg's
length gives e / m^1/2 in each component. Readings files need the joints alone: without
a column, 0 was read. It needs no other instrument, and sees no
motion of the machine as a whole, nor anything else that leaves the legs' lengths as
they are.

`redundancy_per_leg` is the same with a noise for each leg, `noise_q1_mm`, ...: with D
the diagonal of their squares, the covariance of g is N^T D N / m.
"""

import dataclasses
import math
from collections.abc import Sequence

import casadi as ca

from oed.instrument import Channel, Cost, Frame, Instrument, Setting
from oed.model import Expr, Machine, Values

#: m, standard deviation of a reading: legs of 1 mm, four of them
DEFAULT_SIGMA = 0.5e-3
SOURCE = (
    "self-calibration by redundant legs: Patel and Ehmann 2000, Int. J. Mach. Tools"
    " Manuf. 40, 489-512"
)
GAP = Channel(
    "gap",
    "m",
    DEFAULT_SIGMA,
    about="the legs' lengths beyond those that close the machine; either sign",
)


def _one(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    return [frames[0].closure_misfit]


def _several(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
    misfits = frames[0].closure_misfits
    assert misfits is not None  # `unfit` refuses other machines
    return [misfits[i] for i in range(misfits.numel())]


def _spare(machine: Machine) -> int:
    return len(machine.joints) - len(machine.command)


def _unfit(machine: Machine) -> str | None:
    if _spare(machine) >= 1:
        return None
    return "it takes more joints than degrees of freedom"


def _channels(machine: Machine) -> tuple[Channel, ...]:
    count = _spare(machine)
    if count == 1:
        return (GAP,)
    about = f"component of {GAP.about}"
    return tuple(
        Channel(f"gap{k + 1}", "m", DEFAULT_SIGMA, about=about) for k in range(count)
    )


def _machine_channels(machine: Machine) -> Instrument:
    count = _spare(machine)
    return dataclasses.replace(
        instrument,
        channels=_channels(machine),
        observe=_one if count <= 1 else _several,
        unfit=lambda other: _unfit(other) or _unlike(other, count),
        adapt=None,
    )


def _unlike(machine: Machine, count: int) -> str | None:
    """Why an instrument for `count` spare joints does not fit another machine."""
    spare = _spare(machine)
    if spare == max(count, 1):
        return None
    return f"it is for {count} spare joints, here are {spare}: use for_machine(machine)"


def _leg_channels(machine: Machine) -> Instrument:
    legs = machine.joints
    m = len(machine.joints)
    default = DEFAULT_SIGMA * math.sqrt(m)

    def sources(frames: Sequence[Frame], s: Values, k: Values) -> Expr:
        noise = ca.vertcat(*[k[f"noise_{leg.name}"] for leg in legs])
        null = frames[0].null_space
        assert null is not None  # as above
        return null.T @ ca.diag(noise) / math.sqrt(m)

    return dataclasses.replace(
        per_leg,
        channels=_channels(machine),
        settings=tuple(
            Setting(f"noise_{leg.name}", "m", default, f"noise of leg {leg.name}")
            for leg in legs
        ),
        sources=sources,
        unfit=_unfit,
        adapt=None,
    )


instrument = Instrument(
    name="redundancy",
    source=SOURCE,
    about="closure of a redundant machine: by how much its legs' lengths disagree",
    channels=(GAP,),
    settings=(),
    nuisances=(),
    cost=Cost(setup=60.0, reading=10.0),
    implied=0.0,
    observe=_one,
    unfit=lambda machine: _unfit(machine) or _unlike(machine, 1),
    adapt=_machine_channels,
)

per_leg = dataclasses.replace(
    instrument,
    name="redundancy_per_leg",
    about="closure of a redundant machine, with a noise for each leg",
    observe=_several,
    unfit=lambda machine: _unfit(machine) or "use for_machine(machine)",
    adapt=_leg_channels,
)
