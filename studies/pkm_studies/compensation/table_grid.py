"""Chooses the commands of a table by what interpolation between them costs."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping

import numpy as np

from oed import units
from oed.base import Array, grid_nodes
from oed.compensate import (
    CommandGrid,
    FurtherAxes,
    GridAxis,
    InterpolationTable,
    joint_corrections,
    joint_motion,
)
from oed.mechanism import AssemblyError, Kinematics
from oed.result import ForecastSection, PredictionSection
from oed.units import quantity
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation
from pkm_studies.quantities import display_unit

#: largest number of commands of a table, unless the user gives another
DEFAULT_MAX_COMMANDS = 5000
#: interpolation may cost this share of the rms that exact compensation leaves, which
#: grows by 2 % with it
GROWTH_SHARE = 0.2
#: where no accuracy was predicted, the error of each joint, m or rad
JOINT_ERROR = 1e-6
SHRINK = 0.9  #: factor by which a box that is partly out of reach shrinks
SHRINKS = 20  #: times that it shrinks, at most


@dataclasses.dataclass(frozen=True)
class TableAccuracy:
    """Which errors count, and how large they may be.

    names   (k,) of the components, or of the joints
    units   (k,) SI
    target  (k,) rms, SI
    motion  (n, k, nq) of them per unit of each joint, at commands; with offsets for m
            additional axes (n, k, nq + m)
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    target: Array
    motion: Callable[[Array], Array]

    @classmethod
    def predicted(
        cls, kinematics: Kinematics, prediction: PredictionSection | None
    ) -> TableAccuracy:
        """A share of the predicted accuracy; without one, a joint error of 1 um."""
        if prediction is None:
            return _joint_offsets(kinematics)
        after = {name: c.after.rms for name, c in prediction.components.items()}
        if prediction.budget is not None:
            after = prediction.budget.predicted
        driven = [c for c in kinematics.machine.components if c.compensatable]
        remaining = rms_of(after, kinematics)
        if not (remaining > 0.0).all():
            return _joint_offsets(kinematics)
        return cls(
            tuple(c.name for c in driven),
            tuple(c.unit for c in driven),
            GROWTH_SHARE * remaining,
            lambda command: joint_motion(kinematics, command),
        )

    def grid(
        self,
        axes: tuple[GridAxis, ...],
        correction: Callable[[Array], Array],
        largest: int,
    ) -> CommandGrid | None:
        """The grid of a table over a box; None where no part of the box is in reach.

        A box that is partly out of reach shrinks about its middle, full turns aside. Raises
        InputError where `largest` is less than the coarsest grid.
        """
        fewest = math.prod(axis.fewest for axis in axes)
        if largest < fewest:
            raise InputError(
                f"a table over {len(axes)} coordinates needs {fewest} commands",
                f"give at least {fewest}, or take a format with parameters",
                value=f"--commands {largest}",
            )
        for step in range(SHRINKS):
            box = tuple(axis.shrunk(SHRINK**step) for axis in axes)
            try:
                grid = CommandGrid.choose(
                    box,
                    correction,
                    self.motion,
                    self.target,
                    largest,
                    np.random.default_rng(0),
                )
                correction(grid.commands)
            except AssemblyError:
                continue
            return grid
        return None


def add_offsets(
    want: TableAccuracy, further: FurtherAxes, prediction: PredictionSection | None
) -> TableAccuracy:
    """As `want`, with offsets for additional axes to a share of what stays unknown."""
    components = {} if prediction is None else prediction.components
    counted = [
        (k, axis)
        for k, axis in enumerate(further.axes)
        if axis.component in components and components[axis.component].known.rms > 0.0
    ]
    unknown = [components[axis.component].known for _, axis in counted]
    targets = [GROWTH_SHARE * u.rms * units.factor(u.unit) for u in unknown]
    rows = np.eye(len(further))[[k for k, _ in counted]]

    def motion(command: Array) -> Array:
        """Offsets do not move what the joints drive."""
        driven = want.motion(command)
        k, nq = driven.shape[1:]
        whole = np.zeros((len(command), k + len(rows), nq + len(further)))
        whole[:, :k, :nq] = driven
        whole[:, k:, nq:] = rows
        return whole

    return TableAccuracy(
        (*want.names, *(f"{axis.name} offset" for _, axis in counted)),
        (*want.units, *(axis.unit for _, axis in counted)),
        np.concatenate([want.target, targets]),
        motion,
    )


def rms_of(values: Mapping[str, float], kinematics: Kinematics) -> Array:
    """Rms errors (k,) of the driven components, SI, from those in fine units."""
    driven = [c for c in kinematics.machine.components if c.compensatable]
    sizes = [units.to_si(values[c.name], units.FINE[c.unit]) for c in driven]
    return np.array(sizes, dtype=float)


def _joint_offsets(kinematics: Kinematics) -> TableAccuracy:
    joints = kinematics.machine.joints
    return TableAccuracy(
        tuple(j.name for j in joints),
        tuple(j.unit for j in joints),
        np.full(len(joints), JOINT_ERROR),
        lambda command: np.broadcast_to(
            np.eye(len(joints)), (len(command), len(joints), len(joints))
        ),
    )


def table_correction(content: Compensation) -> Callable[[Array], Array]:
    """What a table holds, as a single state: joint corrections, then offsets."""
    further, parameters = content.further, content.identified.values

    def correction(command: Array) -> Array:
        joints = joint_corrections(further.kinematics, command, parameters)
        if content.forecast is not None:
            joints = joints + content.forecast(command)
        offsets = further.offsets(command, parameters)
        return np.hstack([joints, offsets])[:, None]

    return correction


def forecast_corrections(
    section: ForecastSection, kinematics: Kinematics, parameters: Array
) -> Callable[[Array], Array]:
    """What a measured forecast adds (n, nq) to the joints for the parameters, SI."""
    columns = [
        units.to_si(values, units.split(name)[1])
        for name, values in section.corrections.items()
    ]
    knots = [
        units.to_si(places, units.split(name)[1])
        for name, places in section.places.items()
    ]
    command = grid_nodes(tuple(knots))
    turns = {
        axis.name: axis.turn for axis in GridAxis.box_axes(kinematics.machine, command)
    }
    counts = [len(places) for places in knots]
    table = InterpolationTable(
        tuple(turns),
        tuple(knots),
        np.column_stack(columns).reshape(*counts, -1),
        tuple(turns.values()),
    )
    if not section.whole:
        return table.at
    return lambda c: table.at(c) - joint_corrections(kinematics, c, parameters)


def sentences(grid: CommandGrid, want: TableAccuracy) -> tuple[str, ...]:
    """What the grid is, how a controller reads it, and what a limit costs."""
    parts = [
        f"{axis.name} {_place(axis.lower, axis.unit)} to {_place(axis.upper, axis.unit)}"
        f" in {count - 1} {'step' if count == 2 else 'steps'}"
        for axis, count in zip(grid.axes, grid.counts, strict=True)
    ]
    phrase = (
        f"the table is a rectilinear grid of {math.prod(grid.counts)} commands, with"
        f" equal steps along each coordinate: {', '.join(parts)}"
    )
    reading = (
        "the controller interpolates the columns correction_* linearly between the"
        " commands, and adds them to the joints of its nominal model"
    )
    turned = [axis.name for axis in grid.axes if axis.turn]
    if turned:
        phrase += f"; {', '.join(turned)} goes on at its first value after the last one"
    if grid.is_fine:
        return phrase, reading
    return phrase, reading, _limit(grid, want)


def _limit(grid: CommandGrid, want: TableAccuracy) -> str:
    rms = grid.errors.max(axis=0)
    costs = [
        f"{name} {quantity(size, unit)}"
        for name, unit, size, target in zip(
            want.names, want.units, rms, want.target, strict=True
        )
        if size > target
    ]
    return (
        f"with {math.prod(grid.counts)} commands interpolation still costs"
        f" {', '.join(costs)} rms: raise --commands, narrow the workspace in"
        " [prediction], or give the controller the parameters"
    )


def _place(value: float, unit: str) -> str:
    shown = display_unit(unit)
    return f"{units.number(value, shown):.6g} {shown}"


# Limbs of a machine as bodies and joints, from the ends of its struts.

#: change of a rotary joint, rad, from which the motion of a strut's end is taken
TURN = 0.5
TRAVEL = 0.01  #: change of a linear joint, m, for the same
MOTION_TOLERANCE = 1e-9  #: m; what differs less between two poses does not move
LEG, CARRIAGE, CRANK = "leg", "carriage", "crank"


@dataclasses.dataclass(frozen=True)
class Limb:
    """A limb at home, in the base frame; m, rad."""

    kind: str  #: `leg`, `carriage` or `crank`
    centre: Array  #: (3,) of a crank; where the strut starts, for the others
    start: Array  #: (3,) of the strut
    end: Array  #: (3,) of the strut, at the platform
    local: Array  #: (3,) the same in the platform's frame, from its tool point
    axis: Array  #: (3,) direction in which the joint moves, or about which it turns
    joint: float  #: value of the joint


@dataclasses.dataclass(frozen=True)
class PlatformOnLimbs:
    """A platform and its limbs at home."""

    rotation: Array  #: (3, 3) of the platform
    point: Array  #: (3,) tool point, m
    limbs: tuple[Limb, ...]


def platform_on_limbs(
    kinematics: Kinematics, parameters: Array
) -> PlatformOnLimbs | None:
    """The machine with parameters (np,), SI; None where struts do not describe it."""
    machine = kinematics.machine
    count = len(machine.joints)
    other = machine.struts is None or machine.cable_stiffness is not None
    if other or len(machine.pose) != count or len(machine.command) != count:
        return None
    home = machine.home_command
    shift = 0.1 * np.array([c.upper - c.lower for c in machine.command])
    poses, joints = kinematics.inverse(np.array([home, home + shift]), parameters)
    _, ends, _ = kinematics.struts(poses, joints, parameters)
    rotation, point, _ = kinematics.frames(poses, np.zeros(3))
    local = np.einsum("nji,nkj->nki", rotation, ends - point[:, None])
    if np.ptp(local, axis=0).max() > MOTION_TOLERANCE:
        return None
    limbs = [
        _limb(kinematics, poses, joints, parameters, ends[0, k], local[0, k], k)
        for k in range(count)
    ]
    stated_limbs = [limb for limb in limbs if limb is not None]
    return (
        PlatformOnLimbs(rotation[0], point[0], tuple(stated_limbs))
        if len(stated_limbs) == count
        else None
    )


def _limb(
    kinematics: Kinematics,
    poses: Array,
    joints: Array,
    p: Array,
    end: Array,
    local: Array,
    k: int,
) -> Limb | None:
    """Limb k, from where its strut starts at four values of its joint."""
    turns = kinematics.machine.joints[k].unit == "rad"
    change = TURN if turns else TRAVEL
    moved = np.repeat(joints[:1], 4, axis=0)
    moved[:, k] += change * np.array([0.0, 1.0, -1.0, 2.0])
    at_home = np.repeat(poses[:1], 4, axis=0)
    starts, _, longer = kinematics.struts(at_home, moved, p)
    there, ahead, behind, further = starts[:, k]
    joint = float(joints[0, k])
    if turns:
        arm = (2.0 * there - ahead - behind) / (2.0 * (1.0 - np.cos(change)))
        motion = (ahead - behind) / (2.0 * np.sin(change))
        size = float(arm @ arm)
        if size < MOTION_TOLERANCE**2:
            return None
        axis, centre = np.cross(arm, motion) / size, there - arm
        expected = centre + np.cos(2 * change) * arm + np.sin(2 * change) * motion
        whole = abs(np.linalg.norm(axis) - 1.0) < MOTION_TOLERANCE
        if not whole or np.abs(further - expected).max() > MOTION_TOLERANCE:
            return None
        return Limb(CRANK, centre, there, end, local, axis, joint)
    if np.ptp(starts[:, k], axis=0).max() > MOTION_TOLERANCE:
        axis = (ahead - behind) / (2.0 * change)
        straight = (
            np.abs(there + 2.0 * change * axis - further).max() < MOTION_TOLERANCE
        )
        if not straight or abs(np.linalg.norm(axis) - 1.0) > MOTION_TOLERANCE:
            return None
        return Limb(CARRIAGE, there, there, end, local, axis, joint)
    axis = (end - there) / np.linalg.norm(end - there)
    if abs(longer[0, k] - 1.0) > MOTION_TOLERANCE:
        return None
    return Limb(LEG, there, there, end, local, axis, joint)


def square_directions(limb: Limb) -> tuple[Array, Array]:
    """Two unit vectors (3,) square to a strut, about which it swings."""
    along = limb.end - limb.start
    along = along / np.linalg.norm(along)
    first = np.cross(along, np.eye(3)[int(np.argmin(np.abs(along)))])
    first = first / np.linalg.norm(first)
    return first, np.cross(along, first)
