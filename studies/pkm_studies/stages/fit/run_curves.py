"""Readings along runs: residuals of a diagnosis, and what is predicted and measured of curves."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.compensate import compensated_joints
from oed.estimation import Estimate
from oed.gap import Diagnosis, phase_along_runs
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.result import RunCurve, Spot, Trace
from pkm_studies.resolve import PASS_SUFFIX

if TYPE_CHECKING:
    import pandas as pd

# Lays out the residuals of a diagnosis run by run, and over the workspace.

MAX_SPREAD = 0.1  #: largest spread of a circle's radii, as a share of their mean
MAX_HEIGHT = 0.05  #: largest height of a line, as a share of its length
MIN_POINTS = 5  #: least number of points of a circle or a line
SAME_PLACE = 1e-4  #: tool points nearer than this are one place, m
DIGITS = 4  #: decimals of residuals
PLACE_DIGITS = 3  #: decimals of positions
SIGMA = "sigma"  #: the unit of residuals given as multiples of the stated noise
MM_PER_MIN = units.factor("mm") / units.factor("min")  #: m/s in a mm/min

T = TypeVar("T")


def traces(diagnosis: Diagnosis) -> list[Trace]:
    """Every channel of every run, in order; short runs of a set-up make one trace."""
    tips = _tool_points(diagnosis)
    parts = {
        "before": diagnosis.before,
        "after": diagnosis.after,
        "explained": diagnosis.after_calibration(diagnosis.explained),
        "unexplained": diagnosis.after_calibration(diagnosis.unexplained),
    }
    every_channel = diagnosis.problem.rows["channel"].to_numpy()
    listing = []
    # readings of each run; runs too short to be drawn are joined by set-up
    long: list[Index] = []
    short: dict[str, list[Index]] = {}
    for members in diagnosis.problem.members:
        first = diagnosis.problem.rows.iloc[members[0]]
        if (every_channel[members] == first["channel"]).sum() < MIN_POINTS:
            short.setdefault(str(first["setup"]), []).append(members)
        else:
            long.append(members)
    for members in [*long, *map(np.concatenate, short.values())]:
        channels = every_channel[members]
        for channel in dict.fromkeys(channels):
            rows = members[channels == channel]
            listing.append(_trace(diagnosis, rows, str(channel), tips, parts))
    return listing


def _trace(
    diagnosis: Diagnosis,
    members: Index,
    channel: str,
    tips: Array,
    parts: Mapping[str, Array],
) -> Trace:
    rows = diagnosis.problem.rows.iloc[members]
    setup, names = str(rows.iloc[0]["setup"]), list(dict.fromkeys(rows["run"]))
    run = str(names[0]) if len(names) == 1 else f"{len(names)} runs"
    kind, along, radius = run_shape(tips[members], rows["phase"].to_numpy(dtype=float))
    if len(names) > 1:
        kind = "points"
        along = np.arange(1.0, len(members) + 1.0)
        radius = None
    order = np.argsort(along, kind="stable")
    unit = units.FINE[_channel_unit(diagnosis, setup, channel)]

    def displayed(part: Array) -> list[float]:
        """The members' values in order along the run, in the fine unit."""
        return _rounded(units.from_si(part[members][order], unit), DIGITS)

    # the run's name without its pass; the number of its series stays
    number = re.search(r" \(\d+\)$", run)
    tail = number.group() if number else ""
    return Trace(
        setup=setup,
        run=run,
        base=PASS_SUFFIX.sub("", run.removesuffix(tail)) + tail,
        channel=channel,
        unit=unit,
        kind=kind,
        at=_rounded(along[order], PLACE_DIGITS),
        before=displayed(parts["before"]),
        explained=displayed(parts["explained"]),
        unexplained=displayed(parts["unexplained"]),
        after=displayed(parts["after"]),
        direction=_constant(rows, "direction", int),
        payload=_constant(rows, "payload", float),
        feed_mm_min=_constant(rows, "feed", lambda v: round(float(v) / MM_PER_MIN, 6)),
        radius_mm=None if radius is None else round(_mm(radius), PLACE_DIGITS),
    )


def _rounded(values: Array, digits: int) -> list[float]:
    return [round(float(value), digits) for value in values]


def _mm(value: float) -> float:
    return float(units.from_si(value, "mm"))


def _constant(rows: pd.DataFrame, name: str, convert: Callable[[float], T]) -> T | None:
    """A covariate that does not change in a run; None where it does or is unknown."""
    if name not in rows.columns:
        return None
    values = rows[name].to_numpy(dtype=float)
    if not np.isfinite(values).all() or np.ptp(values) != 0.0:
        return None
    return convert(values[0])


def _channel_unit(diagnosis: Diagnosis, setup: str, channel: str) -> str:
    channels = diagnosis.problem.measurement.setups[setup].instrument.channels
    return next(c.unit for c in channels if c.name == channel)


def _tool_points(diagnosis: Diagnosis) -> Array:
    """Tool point (N, 3) of the pose of each reading, m."""
    problem = diagnosis.problem
    points = []
    for state, s in zip(problem.states, problem.series, strict=True):
        channels = len(problem.measurement.setups[s.setup].instrument.channels)
        points.append(np.repeat(state.tool[s.index[:, 0]], channels, axis=0))
    return np.vstack(points)


def run_shape(tips: Array, phase: Array) -> tuple[str, Array, float | None]:
    """Kind of a run, positions along it (deg, mm or numbers), and a circle's radius."""
    numbers = np.arange(1.0, len(tips) + 1.0)
    offset = tips - tips.mean(axis=0)
    _, extent, axes = np.linalg.svd(offset, full_matrices=False)
    if len(tips) < MIN_POINTS or extent[0] < SAME_PLACE:
        return "points", numbers, None
    if extent[1] < MAX_HEIGHT * extent[0]:
        axis = axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))])
        along = offset @ axis
        return "line", np.asarray(units.from_si(along - along.min(), "mm")), None
    points = offset @ axes[:2].T  # radii are those of the circle fitted to them
    system = np.column_stack([2.0 * points, np.ones(len(points))])
    squares = np.sum(points**2, axis=1)
    centre = np.linalg.lstsq(system, squares, rcond=None)[0][:2]
    radii = np.asarray(np.linalg.norm(points - centre, axis=1))
    if radii.std() < MAX_SPREAD * radii.mean() and extent[2] < MAX_SPREAD * extent[0]:
        return "circle", np.degrees(phase), float(radii.mean())
    return "points", numbers, None


def spots(diagnosis: Diagnosis) -> tuple[list[Spot], str]:
    """Rms residual at each place before and after; unit, or multiples of the noise."""
    problem = diagnosis.problem
    pairs = zip(problem.rows["setup"], problem.rows["channel"], strict=True)
    kinds = {_channel_unit(diagnosis, str(s), str(c)) for s, c in set(pairs)}
    unit, scale = SIGMA, problem.sigma
    if len(kinds) == 1:
        unit = units.FINE[kinds.pop()]
        scale = np.full(len(problem), units.factor(unit))
    tips = _tool_points(diagnosis)
    cells = np.round(tips / SAME_PLACE)
    owner = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
    places = []
    for k in dict.fromkeys(owner):
        members = owner == k
        position = units.from_si(tips[members].mean(axis=0), "mm")
        before = _rms(diagnosis.before[members] / scale[members])
        after = _rms(diagnosis.after[members] / scale[members])
        places.append(Spot(_rounded(position, PLACE_DIGITS), before, after))
    return places, unit


def _rms(values: Array) -> float:
    return round(float(np.sqrt(np.mean(values**2))), DIGITS)


HALF_WIDTH = 1.96  #: half width of a 95 % interval, in standard deviations
DRAWN = ("circle", "line")  #: kinds of runs that are drawn along their way


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReadingCurves:
    """Readings (N,), SI, less those of the nominal machine, with standard deviations."""

    measured: Array  #: taken
    predicted: Array  #: of the identified machine, and sd of a reading about it
    sd: Array
    #: predicted after compensation, with its sd; None where it is unknown
    compensated: Array | None = None
    compensated_sd: Array | None = None


def fitted_curves(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> list[RunCurve]:
    """A curve for each channel of each circle or line that was fitted."""
    theta = estimate.theta
    nominal = _nominal_readings(measurement, series)
    change = measurement.readings(series, theta) - nominal
    curves = ReadingCurves(
        measured=change + estimate.residuals,
        predicted=change,
        sd=_reading_sd(measurement, series, estimate),
    )
    compensated = compensated_series(measurement, series, theta)
    if compensated is not None:
        remaining = measurement.readings(compensated, theta) - nominal
        curves = dataclasses.replace(
            curves,
            compensated=remaining,
            compensated_sd=_reading_sd(measurement, compensated, estimate),
        )
    return list(run_curves(measurement, series, curves))


def measured_curves(
    measurement: Measurement,
    series: Sequence[Series],
    measured: Array,
    predicted: Array,
    sd: Array,
) -> list[RunCurve]:
    """A curve a channel and run of readings (N,), SI, as taken, beside predicted, sd."""
    nominal = _nominal_readings(measurement, series)
    curves = ReadingCurves(
        measured=measured - nominal, predicted=predicted - nominal, sd=sd
    )
    return list(run_curves(measurement, series, curves))


def _nominal_readings(measurement: Measurement, series: Sequence[Series]) -> Array:
    """Readings (N,), SI, of the nominal machine at the commands, or at the joints."""
    nominal = measurement.nominal
    commanded = compensated_series(measurement, series, nominal)
    return measurement.readings(commanded or series, nominal)


def compensated_series(
    measurement: Measurement, series: Sequence[Series], theta: Array
) -> list[Series] | None:
    """The series at joints of a controller with theta (n,), SI; None if unknown."""
    machine_parameters = theta[: len(measurement.machine.parameters)]
    if not all(np.isfinite(s.command).all() and s.q.ndim == 2 for s in series):
        return None
    moved = []
    for s in series:
        tool = np.array(measurement.setups[s.setup].tool)
        try:
            joints = compensated_joints(
                measurement.kinematics, s.command, machine_parameters, tool
            )
        except AssemblyError:
            return None
        moved.append(dataclasses.replace(s, q=joints))
    return moved


def _reading_sd(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> Array:
    """Standard deviation (N,) of a new reading: parameters and noise."""
    jacobian = measurement.jacobian(series, estimate.theta)
    variance = np.einsum("ij,jk,ik->i", jacobian, estimate.covariance, jacobian)
    return np.asarray(np.sqrt(variance + estimate.noise.sigma**2))


# -- run by run ------------------------------------------------------------------------
def run_curves(
    measurement: Measurement, series: Sequence[Series], curves: ReadingCurves
) -> Iterator[RunCurve]:
    """The curves of each channel of each circle or line, in order along it."""
    first = 0
    for s in series:
        channels = measurement.setups[s.setup].instrument.channels
        tips, phase = _run_phase(measurement, s)
        for run in dict.fromkeys(s.run):
            members = np.flatnonzero(s.run == run)
            kind, along, _ = run_shape(tips[members], phase[members])
            if kind not in DRAWN or len(members) < MIN_POINTS:
                continue
            order = np.argsort(along, kind="stable")
            for k, channel in enumerate(channels):
                rows = first + members[order] * len(channels) + k
                unit = units.FINE[channel.unit]
                yield RunCurve(
                    setup=s.setup,
                    run=str(run),
                    channel=channel.name,
                    unit=unit,
                    kind=kind,
                    at=_rounded(along[order], DIGITS),
                    measured=_displayed(curves.measured, rows, unit),
                    predicted=_displayed(curves.predicted, rows, unit),
                    half_widths=_displayed(curves.sd, rows, unit, HALF_WIDTH),
                    compensated=_displayed(curves.compensated, rows, unit),
                    compensated_half_widths=_displayed(
                        curves.compensated_sd, rows, unit, HALF_WIDTH
                    ),
                )
        first += len(s) * len(channels)


def _run_phase(measurement: Measurement, series: Series) -> tuple[Array, Array]:
    """Nominal tool point (n, 3), m, of each reading, and its phase (n,), rad."""
    setup = measurement.setups[series.setup]
    poses = measurement.poses(series, measurement.nominal)
    points = measurement.kinematics.frames(poses, np.array(setup.tool))[1]
    tips = points[series.index[:, 0]]
    return tips, phase_along_runs(tips, series.run, np.empty(0, dtype=np.intp))


def _displayed(
    values: Array | None, rows: Index, unit: str, factor: float = 1.0
) -> list[float]:
    if values is None:
        return []
    return _rounded(units.from_si(factor * values[rows], unit), DIGITS)
