"""Bounds of the condition number, O4 and E: relaxations with certificates.

With M = M0 + sum_i w_i A_i, A_i = X_i^T X_i, its extreme eigenvalues l_min and l_max,
0 <= w_i <= cap_i, sum w = N,

    F(z) = max_w  l_min(M) - z l_max(M)

is a concave problem (`oed.design.eigenvalue_path`). F(0) is the E criterion. F(z) = 0
at z = 1 / kappa^2 of the best plan, kappa = sqrt(l_max / l_min) (Dinkelbach 1967,
Management Science 13, 492-498). As l_min <= F(z) + z l_max for every z, lines of
several z bound O4 = l_min / sqrt(l_max): no plan lies above their lower envelope. Along
a line O4 is largest at an end, so only corners of the envelope can exceed what is
known. The next z is the slope between the plans on both sides of the worst corner
(sandwich algorithm, Rote 1992, Computing 48, 337-361).
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from oed.base import Array
from oed.design.eigenvalue_path import ROUNDING, EigenvaluePoint, follow
from oed.design.interior import build_problem
from oed.design.relaxation import Relaxation

#: lines that bound O4, at the most
LINES = 16
#: share of the tolerance that each line of O4 is solved to
LINE_TOLERANCE = 0.3


@dataclasses.dataclass(frozen=True)
class EigenvalueRelaxation:
    """Optimal weights for a criterion of the extreme eigenvalues.

    weights  (C,)
    value    the criterion at the weights
    bound    of every feasible plan: from below for kappa, from above for E and O4
    slopes   (C,) of the log criterion (of -log kappa) along each weight: how much a
             candidate is wanted
    """

    weights: Array
    value: float
    bound: float
    slopes: Array

    @property
    def duality_gap(self) -> float:
        """|log bound - log value|: how loose the bound can be, as a relaxation."""
        return float(abs(np.log(self.bound / self.value)))

    def in_log_phi(self, power: float) -> Relaxation:
        """The relaxation of log phi, where the criterion to a power is phi."""
        value = power * float(np.log(max(self.value, 1e-300)))
        bound = power * float(np.log(self.bound))
        return Relaxation(self.weights, value, bound, self.slopes)


def relax(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-4,
) -> EigenvalueRelaxation:
    """Least kappa(H) = sqrt(l_max / l_min), to a log duality gap `tolerance`.

    Arguments as for `relaxation.relax`. Raises ValueError where the caps cannot carry
    `size`, or where candidates and prior leave directions undetermined.
    """
    point = follow(build_problem(rows, size, prior, cap), None, 2.0 * tolerance)
    kappa = float(np.sqrt(point.plan.largest / point.plan.least))
    bound = float(np.sqrt(point.dual.ratio))
    slopes = 0.5 * point.log_slopes(1.0)
    return EigenvalueRelaxation(point.plan.weights, kappa, bound, slopes)


def e_optimal(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-4,
) -> EigenvalueRelaxation:
    """Largest l_min (E), F(0). Raises as `relax`."""
    point = follow(build_problem(rows, size, prior, cap), 0.0, tolerance)
    slopes = point.log_slopes(0.0)
    return EigenvalueRelaxation(
        point.plan.weights, point.plan.least, point.dual.bound, slopes
    )


def o4(
    rows: Array,
    size: float,
    prior: Array | None = None,
    cap: Array | float = 1.0,
    tolerance: float = 1e-3,
) -> EigenvalueRelaxation:
    """Largest O4 = l_min / sqrt(l_max), to a log duality gap `tolerance`.

    Raises as `relax`.
    """
    problem = build_problem(rows, size, prior, cap)
    line_tolerance = LINE_TOLERANCE * tolerance
    level = follow(problem, 0.0, line_tolerance)
    through_origin = follow(problem, None, line_tolerance)
    lines = [
        _Line(level.dual.bound, 0.0, level),
        _Line(0.0, 1.0 / through_origin.dual.ratio, through_origin),
    ]
    best = max((level, through_origin), key=_o4)
    while True:
        bound, flatter, steeper = _worst_corner(lines)
        if np.log(bound / _o4(best)) <= tolerance or len(lines) >= LINES:
            slopes = best.log_slopes(0.5)
            return EigenvalueRelaxation(best.plan.weights, _o4(best), bound, slopes)
        slope = _slope_between(flatter, steeper)
        near = dataclasses.replace(problem, start=flatter.point.plan.weights)
        point = follow(near, slope, line_tolerance)
        lines.append(_Line(point.dual.bound, slope, point))
        best = max(best, point, key=_o4)


class _Line(NamedTuple):
    """l_min <= constant + slope l_max for all plans; `point` nearly attains it."""

    constant: float
    slope: float
    point: EigenvaluePoint


def _o4(point: EigenvaluePoint) -> float:
    return float(point.plan.least / np.sqrt(point.plan.largest))


def _worst_corner(lines: list[_Line]) -> tuple[float, _Line, _Line]:
    """Largest l_min / sqrt(l_max) under the lines, and the two that meet there.

    The flatter line comes first. The first line is level and one passes through the
    origin, so the envelope's largest value is at a crossing.
    """
    constant = np.array([line.constant for line in lines])
    slope = np.array([line.slope for line in lines])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (constant[:, None] - constant) / (slope - slope[:, None])
    steeper_than = slope > slope[:, None]
    pairs = np.isfinite(crossing) & (crossing > 0) & steeper_than
    flatter, steeper = np.nonzero(pairs)
    at = crossing[flatter, steeper]
    envelope = np.min(constant + at[:, None] * slope, axis=1)
    height = constant[flatter] + at * slope[flatter]
    on_envelope = envelope >= height * (1 - 1e-12)
    values = np.where(on_envelope, envelope / np.sqrt(at), -np.inf)
    k = int(np.argmax(values))
    bound = float(values[k]) * (1.0 + ROUNDING)
    return bound, lines[int(flatter[k])], lines[int(steeper[k])]


def _slope_between(flatter: _Line, steeper: _Line) -> float:
    """Slope of the chord between the plans that two lines touch.

    Halfway between the lines' slopes where the chord's slope is not between them.
    """
    run = flatter.point.plan.largest - steeper.point.plan.largest
    rise = flatter.point.plan.least - steeper.point.plan.least
    chord = rise / run if run > 0 else -1.0
    margin = 0.01 * (steeper.slope - flatter.slope)
    if flatter.slope + margin < chord < steeper.slope - margin:
        return float(chord)
    return 0.5 * (flatter.slope + steeper.slope)
