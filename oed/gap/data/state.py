"""The machine's state at every pose of a series: what effects are functions of."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oed.arrays import Array, Index
from oed.effect import State
from oed.gap.data.motion import motion
from oed.measurement import Measurement, Series

TEMPERATURE = "temp_"
DOWN = (0.0, 0.0, -1.0)
#: share of a run's longest extent that the second must have for it to be a loop rather
#: than a line
LOOP = 0.2


def states(
    measurement: Measurement,
    series: tuple[Series, ...],
    covariates: pd.DataFrame,
    theta: Array,
    gravity: tuple[float, float, float] = DOWN,
) -> list[State]:
    """One State a series, over all its poses, at theta (n,); `covariates` has one row a
    reading, in their order.
    """
    times = _column(covariates, "time")
    session, joints = (
        np.unique(times[np.isfinite(times)]),
        np.vstack([s.q for s in series]),
    )
    shared = {
        "heaviest": float(
            np.nanmax(np.abs(_column(covariates, "payload")), initial=0.0)
        ),
        "session": session,
        "start": _first(covariates, times),
        "stroke": np.array([joints.min(axis=0), joints.max(axis=0)]),
        "span": (
            (float(session[0]), float(session[-1]))
            if session.size
            else (np.nan, np.nan)
        ),
    }
    covariates, down = (
        covariates.assign(progress=_progress(times)),
        np.array(gravity, dtype=float),
    )
    made, begin = [], 0
    for s in series:
        rows = covariates.iloc[begin : begin + len(s)]
        made.append(
            _state(measurement, s, rows, theta, shared, down / np.linalg.norm(down))
        )
        begin += len(s)
    return made


def _progress(times: Array) -> Array:
    """How far the session has gone at each reading, 0 to 1: by the clock, or by order
    where not all have a time.
    """
    at = times if np.isfinite(times).all() else np.arange(len(times), dtype=float)
    return np.asarray(
        (at - at.min(initial=np.inf))
        / max(float(np.ptp(at)) if at.size else 0.0, 1e-12)
    )


def _first(covariates: pd.DataFrame, times: Array) -> dict[str, float]:
    """Temperature of each body at the session's first reading that has one."""
    order = np.argsort(times, kind="stable")
    found = {}
    for name in (str(c) for c in covariates.columns if str(c).startswith(TEMPERATURE)):
        values = _column(covariates, name)[order]
        known = values[np.isfinite(values)]
        found[name.removeprefix(TEMPERATURE)] = (
            float(known[0]) if known.size else np.nan
        )
    return found


def _state(
    measurement: Measurement,
    series: Series,
    rows: pd.DataFrame,
    theta: Array,
    shared: Mapping[str, Any],
    down: Array,
) -> State:
    """Of one series; `shared`: what holds for the whole session, `down`: the unit
    vector (3,) of gravity.
    """
    kinematics, machine = measurement.kinematics, measurement.machine
    p, q = theta[: len(machine.parameters)], series.q
    x = measurement.poses(series, theta)
    tool = np.array(measurement.setups[series.setup].tool)
    rotation, tip, twist = kinematics.frames(x, tool)
    by_joint = twist @ kinematics.joint_sensitivity(x, q, p)
    force = np.einsum("k,mkj->mj", down, by_joint[:, :3])
    base, platform, per_length = _struts(measurement, x, q, p)
    moment = np.nan_to_num(np.cross(platform.mean(axis=1) - tip, down))
    between = platform - base
    length = np.linalg.norm(between, axis=-1)
    owner = _owner(series)  # for each pose the reading whose covariates hold there
    run, order = series.run[owner], rows["order"].to_numpy(dtype=float)[owner]
    order[series.index[:, 0]] = rows["order"].to_numpy(dtype=float)
    referred = np.setdiff1d(np.arange(len(x)), series.index[:, 0])
    order[referred] -= 1.0
    taught = (
        referred
        if measurement.setups[series.setup].teach is not None
        else np.empty(0, dtype=np.intp)
    )
    known: dict[str, Any] = {
        name: _column(rows, name)[owner]
        for name in ("time", "progress", "feed", "payload", "direction")
    }
    bodies = [str(c) for c in rows.columns if str(c).startswith(TEMPERATURE)]
    moved = motion(q, tip, run, order, known["feed"], taught)
    return State(
        machine=machine,
        setup=series.setup,
        pose=x,
        tool=tip,
        axis=rotation[:, :, 2],
        joints=q,
        sense=moved.sense,
        reversal=moved.reversal,
        rate=moved.rate,
        acceleration=moved.acceleration,
        force=force,
        weight=force + np.einsum("mk,mkj->mj", moment, by_joint[:, 3:]),
        twist=by_joint,
        strut=length,
        along=between / length[..., None],
        base=base,
        platform=platform,
        per_length=per_length,
        phase=_phase(tip, run, taught),
        run=run,
        order=order,
        temperature={
            c.removeprefix(TEMPERATURE): _column(rows, c)[owner] for c in bodies
        },
        home=kinematics.inverse(machine.home_command[None])[0][0],
        channels=tuple(
            c.name for c in measurement.setups[series.setup].instrument.channels
        ),
        settings=measurement.setups[series.setup].settings,
        **shared,
        **known,
    )


def _struts(
    measurement: Measurement, x: Array, q: Array, p: Array
) -> tuple[Array, Array, Array]:
    """As `Kinematics.struts`; NaN for a machine that does not tell its struts."""
    if measurement.machine.struts is None:
        lost = np.full((*q.shape, 3), np.nan)
        return lost, lost, np.full(q.shape, np.nan)
    return measurement.kinematics.struts(x, q, p)


def _column(rows: pd.DataFrame, name: str) -> Array:
    if name not in rows.columns:
        return np.full(len(rows), np.nan)
    return np.asarray(rows[name].to_numpy(dtype=float))


def _owner(series: Series) -> Index:
    """For each pose (m,) the first reading that sees it."""
    owner = np.zeros(len(series.q), dtype=np.intp)
    for column in series.index.T[::-1]:
        owner[column[::-1]] = np.arange(len(series))[::-1]
    return owner


def _phase(tip: Array, run: NDArray[np.str_], taught: Index) -> Array:
    """Place (m,) of each pose along its run, rad: the angle in a loop's plane, or the
    way along a line.
    """
    phase = np.zeros(len(tip))
    moving = np.setdiff1d(np.arange(len(tip)), taught)
    for label in dict.fromkeys(run[moving]):
        at = moving[run[moving] == label]
        off = tip[at] - tip[at].mean(axis=0)
        _, extent, axes = np.linalg.svd(off, full_matrices=False)
        if len(at) < 3 or extent[0] < 1e-9:
            continue
        if extent[1] > LOOP * extent[0]:
            phase[at] = _angle(off, axes)
        else:
            along = off @ (axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))]))
            phase[at] = (
                2.0 * np.pi * (along - along.min()) / (np.ptp(along) * (1.0 + 1e-9))
            )
    return phase


def _angle(off: Array, axes: Array) -> Array:
    """Angle (k,) in [0, 2 pi) about the normal of a loop's plane, from the base's x
    axis (or y, across it).
    """
    normal = axes[2] * np.sign(axes[2][np.argmax(np.abs(axes[2]))])
    start = np.eye(3)[0 if abs(normal[0]) < 0.9 else 1]
    first = start - normal * (start @ normal)
    first /= np.linalg.norm(first)
    return np.asarray(
        np.mod(np.arctan2(off @ np.cross(normal, first), off @ first), 2.0 * np.pi)
    )
