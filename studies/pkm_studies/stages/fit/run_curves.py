"""Lays out readings along circles and lines: measured, predicted, after compensation.

A compensated machine goes to the joints that hold each command with the identified
parameters. What its instrument then reads departs from the nominal readings by what no
drive corrects and by the errors of the set-up (Tian et al. 2016, Eq. (25), Figs. 8, 9).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.compensate import compensated_joints
from oed.estimation import Estimate
from oed.gap import phase_along_runs
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.result import RunCurve
from pkm_studies.stages.gap.traces import MIN_POINTS, run_shape

#: half width of a 95 % interval, in standard deviations
HALF_WIDTH = 1.96
DIGITS = 4
#: kinds of runs that are drawn along their way
DRAWN = ("circle", "line")


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReadingCurves:
    """Readings (N,), SI, less those of the nominal machine, with standard deviations.

    measured     taken
    predicted    of the identified machine, and sd of a reading about it
    compensated  predicted after compensation, with its sd; None where it is unknown
    """

    measured: Array
    predicted: Array
    sd: Array
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
    """A curve for each channel of each circle or line, from readings (N,), SI, as taken.

    predicted, sd  what the identified machine reads there, and the sd of a reading
    """
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
    """The series at the joints of a controller with parameters theta (n,), SI.

    None where commands are unknown or out of reach.
    """
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
                    at=[round(float(v), DIGITS) for v in along[order]],
                    measured=_displayed(curves.measured, rows, unit),
                    predicted=_displayed(curves.predicted, rows, unit),
                    half_widths=_displayed(HALF_WIDTH * curves.sd, rows, unit),
                    compensated=_displayed(curves.compensated, rows, unit),
                    compensated_half_widths=_half_widths(curves, rows, unit),
                )
        first += len(s) * len(channels)


def _run_phase(measurement: Measurement, series: Series) -> tuple[Array, Array]:
    """Nominal tool point (n, 3), m, of each reading, and its phase (n,), rad."""
    setup = measurement.setups[series.setup]
    poses = measurement.poses(series, measurement.nominal)
    points = measurement.kinematics.frames(poses, np.array(setup.tool))[1]
    tips = points[series.index[:, 0]]
    return tips, phase_along_runs(tips, series.run, np.empty(0, dtype=np.intp))


def _half_widths(curves: ReadingCurves, rows: Index, unit: str) -> list[float]:
    if curves.compensated_sd is None:
        return []
    return _displayed(HALF_WIDTH * curves.compensated_sd, rows, unit)


def _displayed(values: Array | None, rows: Index, unit: str) -> list[float]:
    if values is None:
        return []
    return [round(float(v), DIGITS) for v in units.from_si(values[rows], unit)]
