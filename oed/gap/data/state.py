"""State of the machine at every pose of a series: what effects are functions of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oed.base import Array, Index, rows_by_label
from oed.dataset.columns import TEMPERATURE, TENSION
from oed.effect_model import State
from oed.gap.data.motion import motion, tool_places
from oed.measurement import Measurement, Series

DOWN = (0.0, 0.0, -1.0)
#: covariates of a reading that a State has under the same name
COVARIATES = ("time", "session_progress", "feed", "payload", "direction")
#: share of a run's longest extent that the second must have for it to be a loop rather
#: than a line
LOOP = 0.2
#: share of its distance from the base's origin by which a tool that stays in its place
#: moves by rounding, and an angle that is none, rad
ROUNDING = 1e-9


def states(
    measurement: Measurement,
    series: tuple[Series, ...],
    covariates: pd.DataFrame,
    theta: Array,
    gravity: tuple[float, float, float] = DOWN,
    tool: Array | None = None,
) -> list[State]:
    """One State a series, over all its poses, at theta (n,).

    `covariates` has one row a reading, in their order. The tool point (3,) is that of
    each series' set-up unless it is given.
    """
    times = _column(covariates, "time")
    session = _session(covariates, times, series)
    covariates = covariates.assign(session_progress=_progress(times))
    down = np.array(gravity, dtype=float)
    down = down / np.linalg.norm(down)
    by_series, start = [], 0
    for s in series:
        stop = start + len(s)
        rows = covariates.iloc[start:stop]
        point = np.array(measurement.setups[s.setup].tool) if tool is None else tool
        geometry = _geometry(measurement, s, theta, down, point)
        by_series.append(_state(measurement, s, rows, geometry, session))
        start = stop
    return by_series


def _session(
    covariates: pd.DataFrame,
    times: Array,
    series: tuple[Series, ...],
) -> dict[str, Any]:
    """Fields of a State that hold for the whole session."""
    session = np.unique(times[np.isfinite(times)])
    joints = np.vstack([s.q for s in series])
    load = np.abs(_column(covariates, "payload"))
    feed = _column(covariates, "feed")
    span = (np.nan, np.nan)
    if session.size:
        span = (float(session[0]), float(session[-1]))
    return {
        "max_payload": float(np.nanmax(load, initial=0.0)),
        "max_feed": float(np.nanmax(feed, initial=0.0)),
        "session_times": session,
        "start_temperature": _first_temperatures(covariates, times),
        "joint_range": np.array([joints.min(axis=0), joints.max(axis=0)]),
        "session_span": span,
    }


def _progress(times: Array) -> Array:
    """How far the session has gone at each reading, 0 to 1.

    By the clock, or by order where not all readings have a time.
    """
    clock = times
    if not np.isfinite(times).all():
        clock = np.arange(len(times), dtype=float)
    span = float(np.ptp(clock)) if clock.size else 0.0
    elapsed = clock - clock.min(initial=np.inf)
    return np.asarray(elapsed / max(span, 1e-12))


def _first_temperatures(
    covariates: pd.DataFrame,
    times: Array,
) -> dict[str, float]:
    """Temperature of each body at the session's first reading that has one."""
    in_time = covariates.iloc[np.argsort(times, kind="stable")]
    return {
        name.removeprefix(TEMPERATURE): float(
            next(iter(in_time[name].dropna()), np.nan)
        )
        for name in _temperature_columns(covariates)
    }


def _temperature_columns(covariates: pd.DataFrame) -> list[str]:
    names = [str(c) for c in covariates.columns]
    return [n for n in names if n.startswith(TEMPERATURE)]


def _state(
    measurement: Measurement,
    series: Series,
    rows: pd.DataFrame,
    geometry: Mapping[str, Any],
    session: Mapping[str, Any],
) -> State:
    """State of one series.

    geometry   fields that follow from the poses
    session    fields that hold for the whole session
    """
    kinematics, machine = measurement.kinematics, measurement.machine
    setup = measurement.setups[series.setup]
    owner = _owner(series)  # for each pose the reading whose covariates hold there
    run = series.run[owner]
    read = series.index[:, 0]
    referred = np.setdiff1d(np.arange(len(series.q)), read)
    taught = np.empty(0, dtype=np.intp) if setup.teach is None else referred
    covariates: dict[str, Any] = {
        name: _column(rows, name)[owner] for name in COVARIATES
    }
    temperature = {}
    for column in _temperature_columns(rows):
        body = column.removeprefix(TEMPERATURE)
        temperature[body] = _column(rows, column)[owner]
    tensions = [f"{TENSION}{k + 1}" for k in range(series.q.shape[1])]
    order = _order(series, rows, owner, referred)
    tip, feed = geometry["tool"], covariates["feed"]
    place = tool_places(tip, geometry["rotation"], machine.lever)
    moved = motion(series.q, place, run, order, feed, taught)
    return State(
        machine=machine,
        setup=series.setup,
        instrument=setup.instrument.name,
        joints=series.q,
        **geometry,
        motion_sign=moved.sense,
        travel_since_reversal=moved.reversal,
        rate=moved.rate,
        acceleration=moved.acceleration,
        phase=phase_along_runs(tip, run, taught),
        run=run,
        order=order,
        temperature=temperature,
        tension=np.column_stack([_column(rows, name)[owner] for name in tensions]),
        home=kinematics.inverse(machine.home_command[None])[0][0],
        channels=tuple(c.name for c in setup.instrument.channels),
        settings=setup.settings,
        **session,
        **covariates,
    )


def _geometry(
    measurement: Measurement,
    series: Series,
    theta: Array,
    down: Array,
    tool: Array,
) -> dict[str, Any]:
    """Fields of a State that follow from the poses: tool, forces, struts.

    down  (3,) unit vector of gravity;  tool  (3,) tool point in the platform's frame, m
    """
    kinematics, machine = measurement.kinematics, measurement.machine
    p, q = theta[: len(machine.parameters)], series.q
    x = measurement.poses(series, theta)
    rotation, tip, twist = kinematics.frames(x, tool)
    by_joint = twist @ kinematics.slopes.over_joints(x, q, p)
    force = np.einsum("k,mkj->mj", down, by_joint[:, :3])
    base, platform, per_length = _struts(measurement, x, q, p)
    lever = platform.mean(axis=1) - tip
    moment = np.nan_to_num(np.cross(lever, down))
    torque = np.einsum("mk,mkj->mj", moment, by_joint[:, 3:])
    strut = platform - base
    length = np.linalg.norm(strut, axis=-1)
    return {
        "pose": x,
        "tool": tip,
        "rotation": rotation,
        "axis": rotation[:, :, 2],
        "tool_force": force,
        "platform_force": force + torque,
        "twist": by_joint,
        "strut_length": length,
        "strut_direction": strut / length[..., None],
        "base": base,
        "platform": platform,
        "joint_per_length": per_length,
    }


def _order(
    series: Series,
    rows: pd.DataFrame,
    owner: Index,
    referred: Index,
) -> Array:
    """Number (m,) of each pose in its run.

    A pose that readings only refer to comes right before the first reading that does.
    """
    number = rows["order"].to_numpy(dtype=float)
    order = number[owner]
    order[series.index[:, 0]] = number
    order[referred] -= 1.0
    return np.asarray(order)


def _struts(
    measurement: Measurement,
    x: Array,
    q: Array,
    p: Array,
) -> tuple[Array, Array, Array]:
    """As `Kinematics.struts`; NaN for a machine that does not state its struts."""
    if measurement.machine.struts is None:
        unknown = np.full((*q.shape, 3), np.nan)
        return unknown, unknown, np.full(q.shape, np.nan)
    return measurement.kinematics.struts(x, q, p)


def _column(rows: pd.DataFrame, name: str) -> Array:
    """A covariate (n,); NaN where it is not recorded."""
    if name not in rows.columns:
        return np.full(len(rows), np.nan)
    return np.asarray(rows[name].to_numpy(dtype=float))


def _owner(series: Series) -> Index:
    """For each pose (m,) the first reading that sees it."""
    owner = np.zeros(len(series.q), dtype=np.intp)
    poses, first = np.unique(series.index.T, return_index=True)
    owner[poses] = first % len(series)
    return owner


# -- phase along runs ------------------------------------------------------------------


def phase_along_runs(tip: Array, run: NDArray[np.str_], taught: Index) -> Array:
    """Phase (m,) of each pose along its run, rad.

    It is 0 at the poses `taught` and in runs too short to have one.
    """
    phase = np.zeros(len(tip))
    moving = np.setdiff1d(np.arange(len(tip)), taught)
    for members in rows_by_label(run[moving]):
        at = moving[members]
        if len(at) < 3:
            continue
        offset = tip[at] - tip[at].mean(axis=0)
        _, extent, axes = np.linalg.svd(offset, full_matrices=False)
        if extent[0] <= ROUNDING * np.linalg.norm(tip[at]):
            continue
        if extent[1] > LOOP * extent[0]:
            phase[at] = _angle(offset, axes)
            continue
        along = offset @ _oriented(axes[0])  # a line: the share of its length
        length = np.ptp(along) * (1.0 + 1e-9)
        phase[at] = 2.0 * np.pi * (along - along.min()) / length
    return phase


def _oriented(axis: Array) -> Array:
    """An axis (3,) with its largest component positive."""
    largest = np.argmax(np.abs(axis))
    return np.asarray(axis * np.sign(axis[largest]))


def _angle(offset: Array, axes: Array) -> Array:
    """Angle (k,) in [0, 2 pi) about the normal of a loop's plane.

    It starts at the base's x axis, or at y where the normal is near x.
    """
    normal = _oriented(axes[2])
    start = np.eye(3)[1 if abs(normal[0]) >= 0.9 else 0]
    first = start - normal * (start @ normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.mod(np.arctan2(offset @ second, offset @ first), 2.0 * np.pi)
    # a circle that begins at 0 would end in either place by rounding
    return np.where(angle > 2.0 * np.pi - ROUNDING, 0.0, angle)
