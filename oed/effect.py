"""What an unmodelled effect is: changes of joints, parameters, set-up or readings as
functions of the machine's state.

An effect is linear in its coefficients: each is one `Column`, a change per unit of the
coefficient at each pose, with the coefficient's physical prior standard deviation. What
the form depends on nonlinearly (a time constant, a screw's pitch) are its `constants`,
given as a grid over which the diagnosis marginalises. The same columns give the
effect's signature in the readings (H delta p, to first order) and, through the exact
closure, a virtual machine that has it.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from oed.arrays import Array
from oed.machine import Machine

#: singular value of the tool's motion by its joints, against the largest, below which a
#: direction is none of its own
DIRECTION_CUTOFF = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True)
class State:
    """What the machine was like at m poses of a set-up, its teach or reference poses
    among them. nq joints; SI.

    machine      the machine
    setup        name of the set-up
    pose         (m, nx) coordinates of the pose;  tool (m, 3) the tool point, axis (m,
                 3) the platform's z, in the base frame
    joints       (m, nq) what the joints were sent to
    sense        (m, nq) sign of each joint's motion, from the order of poses in a run;
                 where a joint stands still, that of its last motion; 0 where nothing is
                 known (a teach pose)
    reversal     (m, nq) how far each joint has gone since it last turned back in the
                 run, m or rad; inf before it does
    rate         (m, nq) joint velocity, and acceleration (m, nq), at the run's feed;
                 NaN where the feed is not known
    force        (m, nq) generalised force in each joint per newton pulling along
                 gravity at the tool point (J^-T w)
    weight       (m, nq) the same at the middle of the platform's joints; at the tool
                 point where struts are not told
    twist        (m, 6, nq) motion of the tool point (3, m) and rotation (3, rad), base
                 frame, per unit of each joint
    strut        (m, nq) length of the strut that the joint drives;  along (m, nq, 3)
                 its direction, base to platform
    base         (m, nq, 3) and platform (m, nq, 3) its ends in the base frame
    per_length   (m, nq) change of the joint worth a strut longer by 1 m (joint unit
                 over m)
    phase        (m,) place along the run, the same for both directions of travel, rad
                 in [0, 2 pi)
    run          (m,) label of the run;  order (m,) in it
    time, feed, payload, direction   (m,), NaN where unknown
    temperature  {body: (m,)} K
    heaviest     largest payload of the session, N; 0 where unknown
    session      (k,) times of all readings of the session, sorted, s; empty where
                 unknown
    progress     (m,) how far the session has gone, 0 to 1: by the clock, or by the
                 order of the readings where not all of them have a time
    start        {body: its temperature at the session's first reading, K}
    channels     names of the instrument's channels
    settings     of the set-up, by name, SI
    stroke       (2, nq) least and largest value of each joint in the session, taught
                 poses among them
    home         (nx,) the home pose
    span         first and last time of all set-ups together, s; NaN where unknown
    """

    machine: Machine
    setup: str
    pose: Array
    tool: Array
    axis: Array
    joints: Array
    motion_sign: Array
    travel_since_reversal: Array
    rate: Array
    acceleration: Array
    tool_force: Array
    platform_force: Array
    twist: Array
    strut_length: Array
    strut_direction: Array
    base: Array
    platform: Array
    joint_per_length: Array
    phase: Array
    run: NDArray[np.str_]
    order: Array
    time: Array
    feed: Array
    payload: Array
    direction: Array
    temperature: Mapping[str, Array]
    max_payload: float
    session_times: Array
    session_progress: Array
    start_temperature: Mapping[str, float]
    channels: tuple[str, ...]
    settings: Mapping[str, float]
    joint_range: Array
    home: Array
    session_span: tuple[float, float]

    @functools.cached_property
    def joints_per_displacement(self) -> Array:
        """Joint changes (m, nq, 3) that displace the tool along each axis of the base,
        without turning it if they can; nothing along an axis in which joints hardly
        move it.
        """
        size = np.repeat([1.0, self.machine.lever], 3)[:, None]
        motion = self.twist * size if len(self.limbs) >= 6 else self.twist[:, :3]
        return np.asarray(np.linalg.pinv(motion, rcond=DIRECTION_CUTOFF)[:, :, :3])

    def displacing_joints(self, axis: int, amount: Array) -> dict[int, Array]:
        """Joint changes {joint: (m,)} that displace the tool along an axis of the base
        by `amount` (m,), m.
        """
        change = self.joints_per_displacement[:, :, axis] * amount[:, None]
        return {i: change[:, i] for i in self.limbs}

    @functools.cached_property
    def joints_per_extension(self) -> Array:
        """Joint changes (m, nq) that displace the tool along its axis, without turning
        it if they can; per m.
        """
        return np.asarray(
            np.einsum("mqk,mk->mq", self.joints_per_displacement, self.axis)
        )

    @property
    def limbs(self) -> range:
        """Numbers of the joints, from 0."""
        return range(self.joints.shape[1])

    def __len__(self) -> int:
        return len(self.pose)


@dataclasses.dataclass(frozen=True, slots=True)
class Column:
    """One coefficient of an effect: what a unit of it changes at each of m poses, and
    its prior standard deviation.

    joints      {joint number from 0: (m,)} change of what the joint really does, m or
                rad
    parameters  {name: (m,)} change of a geometric parameter of the machine, SI
    nuisances   {name: (m,)} change of an unknown of the set-up (`cup_x`), SI; the
                instrument's own names
    reading     {channel, or "*" for all: (m,)} what is added to the reading at the pose
                read, SI
    name        of the coefficient: columns of one name in several set-ups share it
                (`leg 1`, `leg 1 length`); a coefficient of one set-up has that in its
                name
    label       block it belongs to, `leg 1`, or "" for all
    scale       prior standard deviation of the coefficient
    shape       true for columns that only let a form adapt beside the textbook's own
    Names that a machine or a set-up does not have are left out; a column that changes
    nothing is dropped.
    """

    name: str
    scale: float
    label: str = ""
    joints: Mapping[int, Array] = dataclasses.field(default_factory=dict)
    parameters: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    nuisances: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    reading: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    shape: bool = False


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """An unmodelled effect.

    needs       covariates without which it cannot be tested: `time`, `feed`, `payload`,
                `time or temp_leg`; with `direction: both`, `payload: 2`, `feed: 2` as
                many different values are wanted
    constants   nonlinear constants with the values that the diagnosis marginalises over
    columns     (state, constants by name) -> its columns in one set-up
    remedy      what a machine builder does about it
    exposed_by  the reading that tells it from its rivals
    unfit       why it cannot occur on a machine, in words; None, as by default, where
                it can
    alike       whether all limbs, built alike, mostly have it alike where all have it
    textbook    prior share of its textbook form, where it has columns that adapt the
                shape
    """

    name: str
    source: str
    about: str
    columns: Callable[..., Iterable[Column]]
    needs: tuple[str, ...] = ()
    constants: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    remedy: str = ""
    exposed_by: str = ""
    unfit: Callable[[Machine], str | None] = lambda machine: None
    common_to_limbs: bool = False
    textbook_share: float = 0.5

    def constant_grid(self) -> list[dict[str, float]]:
        """Every combination of the constants' values."""
        grid: list[dict[str, float]] = [{}]
        for name, values in self.constants.items():
            grid = [point | {name: value} for point in grid for value in values]
        return grid
