"""State of the machine at every pose of a series: what effects are functions of."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray

from oed.base import Array, Index
from oed.dataset import temperature_body
from oed.effect_model import State
from oed.measurement import Measurement, Series

# Rate, acceleration, sense and distance since reversal of the joints along each run.
#
# A run is a smooth path through its poses. It is closed where it ends as near to its
# start as one pose is to the next; a closed run is entered rolling. A joint may turn back
# between two readings, so that the path locates the reversal, not the steps. At a reading
# where a joint turns back, its sense is that in which it arrived: play is not yet taken up
# there, and the slope, zero but for rounding, has no sign to go by. Between poses that
# are points and no path, joints move straight, and the last step has their sense.
#
# A corner ends a path: the machine arrives there as it came, and sets out anew. So does a
# step much longer than the others, which only brings the machine to the start of a path;
# a path that begins so is entered rolling, as ISO 230-2 has it.
#
# The feed is the speed of the tool point. Where the tool turns and its point hardly moves,
# it is the speed at the machine's lever about that point. So a step of length ds takes
# ds / feed, with ds the larger of both chords: joint rates stay those of the machine.

MIN_POSES = 4  #: poses of a run from which on a path is laid through them
#: median turn of the tool's direction at the poses beyond which poses are points and no
#: path, rad
CORNER_ANGLE = np.deg2rad(50.0)
#: distance from end to start of a closed run, in steps between its poses
CLOSING_STEPS = 1.5
#: length of a step, in median steps of its run, from which on it belongs to no path
FAR_STEPS = 3.0
#: length of a step, in the longest of its run, up to which the machine stands still
STILL_SHARE = 1e-5
#: last part of a step between poses over which the sense of arrival is taken
ARRIVAL_SHARE = 0.02


@dataclasses.dataclass(frozen=True, slots=True)
class Motion:
    """Motion of the joints at every pose, (m, nq) each, as in `State`."""

    sense: Array  #: sign of the joint's last motion
    #: per second; NaN where the feed is not known, and in runs in which the tool
    #: neither moves nor turns
    rate: Array
    acceleration: Array  #: per second squared; NaN likewise
    reversal: Array  #: distance since the joint last turned back


def motion(
    q: Array,
    point: Array,
    run: NDArray[np.str_],
    order: Array,
    feed: Array,
    still: Index,
) -> Motion:
    """Motion of joints q (m, nq) in runs, `point` (m, 12); stands at `still`."""
    shape = q.shape
    sense, reversal = np.zeros(shape), np.zeros(shape)
    rate, acceleration = np.full(shape, np.nan), np.full(shape, np.nan)
    rate[still] = acceleration[still] = 0.0
    moving = np.setdiff1d(np.arange(len(q)), still)
    for members in rows_by_label(run[moving]):
        poses = moving[members]
        poses = poses[np.argsort(order[poses], kind="stable")]
        if len(poses) < 2:
            rate[poses] = acceleration[poses] = 0.0
            continue
        along = _run_motion(q[poses], point[poses])
        sense[poses], reversal[poses] = along.sense, along.reversal
        speed = feed[poses, None]
        rate[poses] = along.rate * speed
        acceleration[poses] = along.acceleration * speed**2
    return Motion(sense, rate, acceleration, reversal)


def rows_by_label(labels: NDArray[np.str_]) -> list[Index]:
    """Rows of each label, in order; the labels are sorted."""
    _, number, counts = np.unique(labels, return_inverse=True, return_counts=True)
    order = np.argsort(number, kind="stable")
    return np.split(order, np.cumsum(counts)[:-1])


def tool_places(tip: Array, rotation: Array, lever: float) -> Array:
    """Tool points (m, 3), then the tool's axes (m, 9) so that they turn at a lever; m.

    rotation  (m, 3, 3) of the tool

    Axes turned by an angle t are 2 sin(t / 2) apart times the lever: R and R' differ by
    2 sqrt(2) sin(t / 2) in the Frobenius norm.
    """
    axes = (lever / np.sqrt(2.0)) * rotation.reshape(len(rotation), 9)
    return np.hstack([tip, axes])


def _distance(move: Array) -> Array:
    """Length (k,) of moves (k, 12): of the tool point, or at the lever about it."""
    point = np.linalg.norm(move[:, :3], axis=1)
    return np.asarray(np.maximum(point, np.linalg.norm(move[:, 3:], axis=1)))


def _run_motion(q: Array, point: Array) -> Motion:
    """Motion of a run's k >= 2 poses over the length of path, by its derivatives."""
    along = _straight(q, point)
    breaks = _breaks(point[:, :3])
    if breaks is None:
        return along
    corners, far = breaks
    pieces = np.split(np.arange(len(q)), far)
    for points in pieces:
        inside = corners[np.isin(corners, points[1:-1])]
        start = int(points[0])
        rolling = True
        for stop in (*inside, points[-1]):
            _lay_path(along, q, point, np.arange(start, stop + 1), rolling)
            start = int(stop)
            rolling = False
    return along


def _straight(q: Array, point: Array) -> Motion:
    """Joints that move straight from pose to pose."""
    places = _path_length(point)[0][: len(point)]
    slope, curvature = np.full(q.shape, np.nan), np.full(q.shape, np.nan)
    if places[-1] > 0.0:
        slope[:] = np.gradient(q, places, axis=0)
        curvature[:] = np.gradient(slope, places, axis=0)
    sense = _sense(np.diff(q, axis=0, prepend=q[:1]))
    return Motion(sense, slope, curvature, _since_reversal_by_steps(q, sense))


def _breaks(tip: Array) -> tuple[Index, Index] | None:
    """Poses (k, 3) at which a path has a corner, and those to which a far step leads.

    None where poses follow no path: scattered points turn sharply at most.
    """
    step = np.diff(tip, axis=0)
    size = np.linalg.norm(step, axis=1)
    if len(tip) < MIN_POSES or size.min() <= STILL_SHARE * size.max():
        return None
    cosine = (step[1:] * step[:-1]).sum(axis=1) / (size[1:] * size[:-1])
    turns = np.arccos(np.clip(cosine, -1.0, 1.0))
    if np.median(turns) > CORNER_ANGLE:
        return None
    far = np.flatnonzero(size > FAR_STEPS * np.median(size)) + 1
    return np.flatnonzero(turns > CORNER_ANGLE) + 1, far


def _lay_path(
    along: Motion, q: Array, point: Array, poses: Index, rolling: bool
) -> None:
    """Write what a smooth path through the poses `poses` says of them into `along`.

    rolling  whether the path is entered rolling; else its first pose is a corner, which
             keeps what the path that led there says
    """
    if len(poses) < MIN_POSES:
        return
    length, closed = _path_length(point[poses])
    places = length[: len(poses)]
    around = np.vstack([q[poses], q[poses[:1]]]) if closed else q[poses]
    ends = "periodic" if closed else "not-a-knot"
    path = scipy.interpolate.CubicSpline(length, around, bc_type=ends)
    steps = np.diff(length)
    # before a closed run's first pose comes its last; of an open one nothing is known
    before_first = steps[-1] if closed else steps[0]
    approach = ARRIVAL_SHARE * np.append(before_first, steps)[: len(poses)]
    arriving = path(places) - path(places - approach)
    sense = _sense(arriving / approach[:, None])
    reversal = _since_reversal(path, length, places - approach / 2, closed)
    if not rolling:
        corner = int(poses[0])  # before the first turn, distances are from here
        gone = np.abs(q[poses] - q[corner])
        onward = sense == along.sense[corner]
        before = np.where(onward, along.reversal[corner] + gone, gone)
        reversal = np.where(np.isinf(reversal), before, reversal)
    new = slice(0 if rolling else 1, None)
    along.rate[poses[new]] = path(places, 1)[new]
    along.acceleration[poses[new]] = path(places, 2)[new]
    along.sense[poses[new]] = sense[new]
    along.reversal[poses[new]] = reversal[new]


def _path_length(point: Array) -> tuple[Array, bool]:
    """Length of path at k poses, one more of a closed run, and whether it is closed."""
    steps = _distance(np.diff(point, axis=0))
    still = STILL_SHARE * float(steps.max())
    steps = np.maximum(steps, still)
    last = float(_distance(point[:1] - point[-1:])[0])
    near = still < last < CLOSING_STEPS * float(np.median(steps))
    closed = len(point) >= 2 * MIN_POSES and near
    lengths = np.cumsum([*steps, last] if closed else steps)
    return np.concatenate([[0.0], lengths]), closed


def _sense(moved: Array) -> Array:
    """Signs of the joints' motion (k, nq); where one stands still, of its last motion."""
    size = np.abs(moved)
    least = 1e-6 * max(float(size.max()), 1e-12)
    sign = pd.DataFrame(np.where(size > least, np.sign(moved), np.nan))
    return np.array(sign.ffill().bfill().fillna(0.0), dtype=float)


def _since_reversal(
    path: scipy.interpolate.CubicSpline, length: Array, arrival: Array, closed: bool
) -> Array:
    """Distance (k, nq) since the path last turned back, before arrivals (k,); infinite
    before an open run's first turn.
    """
    q = path(length[: len(arrival)])
    distance = np.full(q.shape, np.inf)
    roots = path.derivative().roots(extrapolate=False)
    for joint, turns in enumerate(roots):
        turns = np.unique(turns[np.isfinite(turns)])
        if closed:
            turns = np.concatenate([turns - length[-1], turns])
        last = np.searchsorted(turns, arrival, side="right") - 1
        turned = last >= 0
        at_turn = path(turns[last[turned]])[:, joint]
        distance[turned, joint] = np.abs(q[turned, joint] - at_turn)
    return distance


def _since_reversal_by_steps(q: Array, sense: Array) -> Array:
    """Distance (k, nq) since the last change of sense, by steps; inf before any."""
    step = np.abs(np.diff(q, axis=0, prepend=q[:1]))
    distance = np.full(q.shape, np.inf)
    for k in range(1, len(q)):
        onward = sense[k] == sense[k - 1]
        distance[k] = np.where(onward, distance[k - 1] + step[k], step[k])
    return distance


DOWN = (0.0, 0.0, -1.0)
#: covariates of a reading that a State has under the same name
COVARIATES = ("time", "session_progress", "feed", "payload", "direction")
#: share of a run's longest extent that the second must have for it to be a loop rather
#: than a line
LOOP_SHARE = 0.2
#: share of its distance from the base's origin by which a tool that stays in its place
#: moves by rounding, and an angle that is none, rad
STILL_TOLERANCE = 1e-9


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
    by_series = []
    start = 0
    for s in series:
        stop = start + len(s)
        rows = covariates.iloc[start:stop]
        point = np.array(measurement.setups[s.setup].tool) if tool is None else tool
        geometry = _geometry(measurement, s, theta, down, point)
        by_series.append(_state(measurement, s, rows, geometry, session))
        start = stop
    return by_series


def _session(
    covariates: pd.DataFrame, times: Array, series: tuple[Series, ...]
) -> dict[str, Any]:
    """Fields of a State that hold for the whole session."""
    session = np.unique(times[np.isfinite(times)])
    joints = np.vstack([s.q for s in series])
    load = np.abs(_column(covariates, "payload"))
    feed = _column(covariates, "feed")
    span = (np.nan, np.nan)
    if session.size:
        span = (float(session[0]), float(session[-1]))
    in_time = covariates.iloc[np.argsort(times, kind="stable")]
    return {
        "max_payload": float(np.nanmax(load, initial=0.0)),
        "max_feed": float(np.nanmax(feed, initial=0.0)),
        "session_times": session,
        "start_temperature": {
            body: float(next(iter(in_time[name].dropna()), np.nan))
            for name, body in _temperature_columns(covariates).items()
        },
        "joint_range": np.array([joints.min(axis=0), joints.max(axis=0)]),
        "session_span": span,
    }


def _progress(times: Array) -> Array:
    """How far the session has gone at each reading, 0 to 1, by the clock or order."""
    clock = times
    if not np.isfinite(times).all():
        clock = np.arange(len(times), dtype=float)
    span = float(np.ptp(clock)) if clock.size else 0.0
    elapsed = clock - clock.min(initial=np.inf)
    return np.asarray(elapsed / max(span, 1e-12))


def _temperature_columns(covariates: pd.DataFrame) -> dict[str, str]:
    """{column: the body that it is the temperature of}."""
    bodies = {str(c): temperature_body(str(c)) for c in covariates.columns}
    return {name: body for name, body in bodies.items() if body is not None}


def _state(
    measurement: Measurement,
    series: Series,
    rows: pd.DataFrame,
    geometry: Mapping[str, Any],
    session: Mapping[str, Any],
) -> State:
    """State of one series, with fields that follow from its poses and the session."""
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
    for column, body in _temperature_columns(rows).items():
        temperature[body] = _column(rows, column)[owner]
    tensions = [f"tension_{k + 1}" for k in range(series.q.shape[1])]
    order = _order(series, rows, owner, referred)
    tip, feed = geometry["tool"], covariates["feed"]
    point = tool_places(tip, geometry["rotation"], machine.lever)
    moved = motion(series.q, point, run, order, feed, taught)
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
    measurement: Measurement, series: Series, theta: Array, down: Array, tool: Array
) -> dict[str, Any]:
    """Fields that follow from the poses, `down` (3,) and the tool point (3,), m."""
    kinematics, machine = measurement.kinematics, measurement.machine
    p, q = theta[: len(machine.parameters)], series.q
    x = measurement.poses(series, theta)
    rotation, tip, twist = kinematics.frames(x, tool)
    by_joint = twist @ kinematics.slopes.pose_by_joint(x, q, p)
    force = np.einsum("k,mkj->mj", down, by_joint[:, :3])
    base = platform = np.full((*q.shape, 3), np.nan)  # where no struts are stated
    per_length = np.full(q.shape, np.nan)
    if machine.struts is not None:
        base, platform, per_length = kinematics.struts(x, q, p)
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


def _order(series: Series, rows: pd.DataFrame, owner: Index, referred: Index) -> Array:
    """Number (m,) of each pose in its run; a reference comes before its reading."""
    number = rows["order"].to_numpy(dtype=float)
    order = number[owner]
    order[series.index[:, 0]] = number
    order[referred] -= 1.0
    return np.asarray(order)


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
    """Phase (m,) along the run, rad; 0 at `taught` poses and in short runs."""
    phase = np.zeros(len(tip))
    moving = np.setdiff1d(np.arange(len(tip)), taught)
    for members in rows_by_label(run[moving]):
        poses = moving[members]
        if len(poses) < 3:
            continue
        offset = tip[poses] - tip[poses].mean(axis=0)
        _, extent, axes = np.linalg.svd(offset, full_matrices=False)
        if extent[0] <= STILL_TOLERANCE * np.linalg.norm(tip[poses]):
            continue
        if extent[1] > LOOP_SHARE * extent[0]:
            phase[poses] = _angle(offset, axes)
            continue
        along = offset @ _oriented(axes[0])  # a line: the share of its length
        length = np.ptp(along) * (1.0 + 1e-9)
        phase[poses] = 2.0 * np.pi * (along - along.min()) / length
    return phase


def _oriented(axis: Array) -> Array:
    """An axis (3,) with its largest component positive."""
    largest = np.argmax(np.abs(axis))
    return np.asarray(axis * np.sign(axis[largest]))


def _angle(offset: Array, axes: Array) -> Array:
    """Angle (k,) in [0, 2 pi) about a loop's normal, from the base's x or y axis."""
    normal = _oriented(axes[2])
    start = np.eye(3)[1 if abs(normal[0]) >= 0.9 else 0]
    first = start - normal * (start @ normal)
    first /= np.linalg.norm(first)
    second = np.cross(normal, first)
    angle = np.mod(np.arctan2(offset @ second, offset @ first), 2.0 * np.pi)
    # a circle that begins at 0 would end in either place by rounding
    return np.where(angle > 2.0 * np.pi - STILL_TOLERANCE, 0.0, angle)
