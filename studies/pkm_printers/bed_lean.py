"""Whether heights of a delta show that its bed leans: least squares with the lean and without.

A lean bends the heights almost as errors of the towers' angles and endstops do, so a few
heights hide it. With residual sums of squares S6 of endstops, radius and two angles, and S8 of
these with two slopes of the bed, n heights of equal noise without a lean give

    F = (S6 - S8) / 2 / (S8 / (n - 8)),    distributed as F(2, n - 8).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import optimize, stats

from oed.base import Array
from oed.text import format_p_value
from pkm_printers.delta_geometry import DeltaGeometry
from pkm_printers.delta_study import SPARE
from pkm_printers.probed_point import ProbedPoint

#: factors without the lean, and with it
PLAIN, LEANING = 6, 8
#: heights that give the lean with one degree of freedom to spare
LEAST = LEANING + 1
#: probability by chance below which a lean is reported
SIGNIFICANT = 0.01
#: standard deviations by which a lean must stand out to be seen
SEEN = 3.0
#: standard deviation of a lean, times the probed radius and over the noise of a height, from
#: which on the heights hide it
HIDDEN = 30.0


@dataclasses.dataclass(frozen=True)
class Lean:
    """What heights say of the lean of their bed.

    slope, sd      (2,) rise along x and y, mm/mm, and its standard deviation
    plain, scatter  estimated noise of a height without a lean and with it, mm
    probability    that heights of a level bed differ as much by chance
    """

    slope: Array
    sd: Array
    plain: float
    scatter: float
    probability: float


def lean_of(geometry: DeltaGeometry, points: Sequence[ProbedPoint]) -> Lean | None:
    """The lean of the bed; None where the heights hide it."""
    if len(points) < LEAST:
        return None
    commands = np.array([[point.x, point.y, point.z] for point in points])
    moved = geometry.travels(commands)

    def heights(change: Array) -> Array:
        """Heights (n,) of the tool over the bed, mm."""
        slope = geometry.bed_slope + change[6:]
        raised = geometry.changed(change[:6]).tool_heights(moved)
        return np.asarray(raised - commands[:, :2] @ slope)

    start = np.zeros(LEANING)
    with_lean = optimize.least_squares(heights, start, x_scale="jac")
    without = optimize.least_squares(
        lambda p: heights(np.append(p, [0.0, 0.0])), start[:PLAIN], x_scale="jac"
    )
    freedom = len(points) - LEANING
    scatter = math.sqrt(2.0 * with_lean.cost / freedom)
    if np.linalg.matrix_rank(with_lean.jac) < LEANING:
        return None
    unit = np.sqrt(np.diag(np.linalg.inv(with_lean.jac.T @ with_lean.jac)))[PLAIN:]
    radius = max(math.hypot(point.x, point.y) for point in points)
    if unit.max() * radius > HIDDEN:
        return None
    gain = (without.cost - with_lean.cost) / max(with_lean.cost, 1e-300) * freedom / 2.0
    return Lean(
        slope=geometry.bed_slope + with_lean.x[PLAIN:],
        sd=scatter * unit,
        plain=math.sqrt(2.0 * without.cost / (len(points) - PLAIN)),
        scatter=scatter,
        probability=float(stats.f.sf(gain, 2, freedom)),
    )


def is_to_be_fitted(lean: Lean | None, count: int) -> bool:
    """Whether a number of heights that tell the lean estimate their noise too, or show it."""
    is_many = count >= LEANING + SPARE
    return lean is not None and (is_many or lean.probability < SIGNIFICANT)


def lean_sentence(lean: Lean | None, count: int, *, is_fitted: bool) -> str:
    """What the heights say of the bed, and whether the lean is fitted."""
    if lean is None:
        return (
            f"Bed: these {count} heights cannot tell a bed that leans from errors of the"
            f" towers. At least {LEAST} heights at several radii do, out to the edge."
        )
    shown = ", ".join(
        f"{axis} {100.0 * slope:+.2f} +- {100.0 * sd:.2f} %"
        for axis, slope, sd in zip("xy", lean.slope, lean.sd, strict=True)
    )
    if lean.probability > SIGNIFICANT:
        beyond = f"{100.0 * SEEN * lean.sd.max():.2g}"
        return (
            f"Bed: its rise is {shown}. These heights show a lean that the firmware does not"
            f" know from {beyond} % on, and show none."
        )
    end = "fitted" if is_fitted else "not fitted; a line factors = 8 in the log fits it"
    return (
        f"Bed: it rises by {shown}. Heights scatter by {1e3 * lean.scatter:.3g} um with this"
        f" lean, by {1e3 * lean.plain:.3g} um with the one that the firmware has (probability"
        f" by chance {format_p_value(lean.probability)}); it is {end}."
    )
