"""Pose errors over the workspace that effects cause, in states of a session.

A controller that is sent parameters p + d, and not the machine's p, moves the tool by -C d
more (C: what compensation changes per unit of a parameter). The shift d that takes up a
known error e (n poses, k components) of effects as far as parameters can minimises

    sum over poses and components of ((e - C d) / s)^2 / n + (RIDGE_SHARE d / tolerance)^2,

with s the error of each component before calibration.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import gap
from oed.accuracy import ErrorMaps, Reference
from oed.base import Array
from oed.effect_model import Column, State
from oed.measurement import Measurement, Series
from oed.mechanism import NO_TOOL, ErrorModel, Kinematics
from oed.model import Machine

if TYPE_CHECKING:
    import pandas as pd

    from oed.gap import ActingEffectForm, GapProblem


#: a parameter moves by a tolerance where this takes such a share of the error before
#: calibration
RIDGE_SHARE = 1e-3


def absorbing_shift(maps: ErrorMaps, errors: Array, tolerance: Array) -> Array:
    """Shifts (np, ...) of the parameters sent, SI, that take up errors (n, k, ...), SI.

    maps       over the machine's np parameters
    tolerance  (np,) prior standard deviations, SI; those of 0 do not move
    """
    free = tolerance > 0.0
    scaled = (maps.raw * tolerance)[:, :, free]
    size = np.sqrt((scaled**2).sum(axis=2).mean(axis=0))
    weight = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    weight /= np.sqrt(len(errors))
    change = ((maps.raw - maps.remaining) * tolerance)[:, :, free]
    rows = (change * weight[:, None]).reshape(-1, int(free.sum()))
    several = errors.shape[2:]
    target = (errors.T * weight[:, None]).T.reshape(-1, *several)
    ridge = RIDGE_SHARE * np.eye(rows.shape[1])
    stacked = np.vstack([rows, ridge])
    padded = np.concatenate([target, np.zeros((len(ridge), *several))])
    solution = np.linalg.lstsq(stacked, padded)[0]
    shift = np.zeros((len(tolerance), *several))
    shift[free] = (solution.T * tolerance[free]).T
    return shift


@dataclasses.dataclass(frozen=True)
class SessionStates:
    """States of a session, from which those of the workspace are drawn."""

    measurement: Measurement
    covariates: pd.DataFrame  #: one row a reading
    states: tuple[State, ...]  #: one a series
    gravity: tuple[float, float, float]  #: its direction in the base frame
    #: values, SI, of covariates at which the machine is used
    used: Mapping[str, Array] = dataclasses.field(default_factory=dict)

    @classmethod
    def of(
        cls, problem: GapProblem, used: Mapping[str, Array] | None = None
    ) -> SessionStates:
        """Those of a problem's readings."""
        return cls(
            problem.measurement,
            problem.covariates,
            problem.states,
            problem.gravity,
            used or {},
        )

    def draw(self, count: int, rng: np.random.Generator) -> pd.DataFrame:
        """Covariates of `count` rows: drawn readings of the session, as used."""
        drawn = rng.integers(len(self.covariates), size=count)
        rows = self.covariates.iloc[drawn]
        return rows.assign(
            **{name: rng.choice(values, count) for name, values in self.used.items()}
        )

    def workspace_state(
        self,
        theta: Array,
        command: Array,
        rng: np.random.Generator,
        *,
        tool: Array = NO_TOOL,
        still: bool = False,
    ) -> State:
        """The machine's state at commands of a tool point (3,), then at home, in states
        drawn from the session's.

        Joints are those of a controller that knows `theta`: where an effect is
        periodic, a correction of some tenths of a millimetre shifts its phase. The
        machine moves from command to command in a drawn order, or stands (`still`), no
        faster than in the session: along the rows of a grid, its joints would arrive
        from one side, and a reference would take their backlash for a shift.
        """
        measurement, first = self.measurement, self.states[0]
        order = np.arange(len(command) + 1)
        if not still:
            rng.shuffle(order[:-1])
        poses = measurement.machine.and_home(command, tool)[order]
        sent = theta[: len(measurement.machine.parameters)]
        x, q = measurement.kinematics.inverse(poses, sent, tool)
        index = np.arange(len(poses))[:, None]
        run = index[:, 0].astype(str) if still else np.array(["1"] * len(poses))
        series = Series(first.setup, q, x, poses, index, run)
        rows = self.draw(len(q), rng)
        rows = rows.assign(run="1", order=np.arange(len(q), dtype=float))
        rows.iloc[-1] = _first_row(self.covariates, rows)
        (state,) = gap.states(
            measurement,
            (series,),
            rows.reset_index(drop=True),
            theta,
            self.gravity,
            tool,
        )
        if "feed" not in self.used:
            state = _slowed(state, self.states)
        return session_state(state.take(np.argsort(order)), first)


def _slowed(state: State, recorded: Sequence[State]) -> State:
    """The state at feeds at which no joint is faster or accelerates more."""
    units = np.array([joint.unit for joint in state.machine.joints])
    share = np.ones(len(state))
    for unit in np.unique(units):
        for name, power in (("rate", 1.0), ("acceleration", 0.5)):
            sizes = [
                np.nan_to_num(np.abs(getattr(s, name)[:, units == unit])).max(axis=1)
                for s in (state, *recorded)
            ]
            limit = max(size.max() for size in sizes[1:])
            used = np.maximum(sizes[0], max(limit, np.finfo(float).tiny))
            share = np.minimum(share, (limit / used) ** power)
    return dataclasses.replace(
        state,
        rate=state.rate * share[:, None],
        acceleration=state.acceleration * share[:, None] ** 2,
        feed=state.feed * share,
    )


def session_state(state: State, first: State) -> State:
    """The state with its place in a session, of which `first` is a state."""
    progress = state.session_progress
    low, high = first.session_span
    if np.isfinite(state.time).all() and high > low:
        progress = (state.time - low) / (high - low)
    return dataclasses.replace(
        state,
        session_progress=progress,
        max_payload=first.max_payload,
        max_feed=first.max_feed,
        session_times=first.session_times,
        start_temperature=first.start_temperature,
        joint_range=first.joint_range,
        session_span=first.session_span,
    )


def _first_row(covariates: pd.DataFrame, rows: pd.DataFrame) -> pd.Series:
    """The session's first reading, at the place of the last of `rows`."""
    first = covariates
    if "time" in covariates and covariates["time"].notna().any():
        first = covariates.sort_values("time")
    row = first.iloc[0].copy()
    row["run"], row["order"] = "1", rows["order"].iloc[-1]
    return row[rows.columns]


def effect_maps(
    kinematics: Kinematics,
    forms: Sequence[ActingEffectForm],
    state: State,
    parameters: Array,
    command: Array,
    reference: Reference,
    tool: Array = NO_TOOL,
) -> ErrorMaps:
    """Pose errors per prior standard deviation of each coefficient (n, k, m).

    state       at the commands (n, n_dof) of a tool point (3,), then at home
    parameters  (np,) of the machine, SI
    """
    machine = kinematics.machine
    model = ErrorModel.of(kinematics, machine.and_home(command, tool), tool)
    tools = kinematics.frames(state.pose, tool)[2]
    by_joint = tools @ kinematics.slopes.pose_by_joint(
        state.pose, state.joints, parameters
    )
    raw, remaining = [], []
    for form in forms:
        columns = {c.name: c for c in form.effect.columns(state, **form.constants)}
        for name in form.names:
            twist = np.zeros((len(state.pose), 6))
            fixed = np.zeros_like(twist)
            if name in columns:
                twist, fixed = _twists(machine, model, by_joint, columns[name])
            raw.append(twist)
            remaining.append(fixed)
    return ErrorMaps.of(
        kinematics,
        command,
        reference,
        tool,
        further=(np.stack(raw, axis=2), np.stack(remaining, axis=2)),
    )


def _twists(
    machine: Machine, model: ErrorModel, by_joint: Array, column: Column
) -> tuple[Array, Array]:
    """Twist errors (n, 6) per prior standard deviation: raw, and compensated."""
    twist = np.zeros(by_joint.shape[:2])
    fixed = np.zeros_like(twist)
    names = {p.name for p in machine.parameters}
    for joint, change in column.joints.items():
        twist += by_joint[:, :, joint] * change[:, None]
    for parameter, change in column.parameters.items():
        if parameter in names:
            k = machine.index(parameter)
            twist += model.raw[:, :, k] * change[:, None]
            fixed += model.remaining[:, :, k] * change[:, None]
    return twist * column.scale, fixed * column.scale
