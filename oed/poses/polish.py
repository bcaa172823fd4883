"""Poses and set-up variables polished together to the next local optimum.

The variables are poses x, joints q and commands c of every pose, and the free set-up
variables (cup, bar length, tool). They are tied by

    phi(x, q, p) = 0,   commanded(x, tip) = target(c)          at nominal parameters,
    y - holds(settings) = 0, or within the bar's travel        where the instrument holds its reading,
    sign det phi_x >= clearance |det phi_x at home|            where asked, on either side of a singularity,

within workspace, joint ranges and the ranges of the free variables. The objective is a
smooth criterion of M = M0 + H^T H (`Criterion.polished`), with H from
`oed.poses.reading_plan`. IPOPT solves the programme (`oed.poses.polish_program`).

IPOPT's result counts only after `oed.measurement.measurement` has computed it again: in range, on
hold, and better than the start.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.design import CRITERIA, Criterion
from oed.identifiability import Scaling, scaled
from oed.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.model.instrument import Setup
from oed.poses.polish_program import PolishProgram
from oed.poses.reading_plan import (
    HOLD_TOLERANCE,
    Ranges,
    ReadingPlan,
    find_fault,
    largest_hold_error,
    restore_hold,
    settings_and_tool,
)

#: a start whose readings are further than this from the value held is refused
START_TOLERANCE = 1e-6
#: singular values below this share of the largest count as undetermined by the start
UNDETERMINED = 1e-6
#: gain below which the start is kept
GAIN = 1e-9
#: curvature that the quasi-Newton matrix starts from, tried in turn: low ones step far,
#: and may fail
CURVATURE = (30.0, 1000.0)


@dataclasses.dataclass(frozen=True)
class PolishResult:
    """Polished readings.

    series        as given, with other commands, joints and poses
    measurement   with the set-ups as they are now
    value_before  criterion of the start, over the directions that it determines (with a
                  prior: over all)
    value_after   criterion of the polished readings
    summary       what was gained, or why the start is kept
    """

    series: tuple[Series, ...]
    measurement: Measurement
    value_before: float
    value_after: float
    summary: str

    @property
    def setups(self) -> tuple[Setup, ...]:
        """Set-ups with their new settings, tools and teach poses."""
        return tuple(self.measurement.setups.values())


def polish_readings(
    measurement: Measurement,
    series: Sequence[Series],
    criterion: Criterion | None = None,
    scaling: Scaling = "tolerance",
    *,
    free: Ranges | None = None,
    prior: Array | None = None,
    travel: float | None = None,
    clearance: float | None = None,
    iterations: int = 500,
) -> PolishResult:
    """Readings moved to a local optimum; the start where nothing is gained.

    criterion   over the free parameters in the stated scaling; D by default. One that is
                not smooth is polished by the smooth one that stands for it
    free        set-up -> setting or tool_x, tool_y, tool_z -> range, SI
    prior       (n, n) prior information, over the free parameters
    travel      m, by how much a held reading may differ from its nominal; None: not
    clearance   least |det phi_x| as a share of that at home
    iterations  of IPOPT, at the most

    Raises ValueError for a criterion that has none, unknown names, a start outside the ranges or off hold, recorded
    joints without commands, and noise that a run shares.
    """
    start = ReadingPlan(measurement, tuple(series))
    variables = _check_start(start, free or {}, travel)
    if criterion is None:
        criterion = CRITERIA.over("D", int(measurement.free.sum()))
    if criterion.polished is None:
        raise ValueError(f"{criterion.name} has no gradient to polish along")
    evaluator = _evaluator(start, criterion.polished, scaling, prior)
    before = evaluator.value(start)
    if not np.isfinite(before):
        raise ValueError(
            "the start is singular: give readings that determine every direction, or a"
            " prior"
        )
    program = PolishProgram(start, variables, travel, clearance)
    program.set_objective(
        evaluator.basis, evaluator.prior, evaluator.criterion, scaling
    )
    reasons = []
    for curvature in CURVATURE:
        status, z = program.solve(curvature, iterations)
        try:
            polished = restore_hold(program.plan(z), travel)
            fault = find_fault(polished, variables, travel, clearance)
            after = evaluator.value(polished) if fault is None else -np.inf
        except AssemblyError as error:
            fault, after = str(error), -np.inf
        if after > before + GAIN:
            summary = f"polishing gained {after - before:.4g} ({status})"
            return PolishResult(
                polished.series, polished.measurement, before, after, summary
            )
        reasons.append(f"{status}: {fault or 'nothing better was found nearby'}")
    summary = f"the start is kept; {'; '.join(reasons)}"
    return PolishResult(start.series, measurement, before, before, summary)


def _check_start(
    start: ReadingPlan, free: Ranges, travel: float | None
) -> dict[str, dict[str, tuple[float, float]]]:
    """The free set-up variables by set-up; raises ValueError for an impossible start."""
    variables = _free_variables(start, free)
    for series in start.series:
        if np.isnan(series.command).any():
            raise ValueError(
                f"set-up {series.setup}: joints were recorded there, and no commands"
                " that could be moved"
            )
    error = largest_hold_error(start, travel)
    if error > START_TOLERANCE:
        raise ValueError(
            f"the start is {error:.3g} m off the value that its instrument holds: solve"
            " it with Measurement.hold"
        )
    exact_travel = None if error > HOLD_TOLERANCE else travel
    fault = find_fault(start, variables, exact_travel, None, hold=False)
    if fault is not None:
        raise ValueError(f"not a start: {fault}")
    return variables


def _free_variables(
    start: ReadingPlan, free: Ranges
) -> dict[str, dict[str, tuple[float, float]]]:
    setups = start.measurement.setups
    used = {series.setup for series in start.series}
    variables: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in setups}
    for name, ranges in free.items():
        if name not in used:
            raise ValueError(
                f"set-up {name!r} has no readings here; {sorted(used)} have"
            )
        known = settings_and_tool(setups[name])
        for variable, (lower, upper) in ranges.items():
            if variable not in known:
                raise ValueError(
                    f"set-up {name}: {variable!r} is none of {sorted(known)}"
                )
            if not lower <= known[variable] <= upper:
                raise ValueError(
                    f"set-up {name}: {variable} = {known[variable]:g} is outside"
                    f" {lower:g} to {upper:g}"
                )
            variables[name][variable] = (float(lower), float(upper))
    return variables


# -- values of plans -------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _PolishEvaluator:
    """The criterion over the columns of `basis` (n, r), with prior information (r, r).

    Its value is the logarithm that users know: log det M, or the log of a variance.
    """

    criterion: Criterion
    scaling: Scaling
    basis: Array
    prior: Array

    def value(self, plan: ReadingPlan) -> float:
        """Criterion of a plan."""
        m = plan.measurement
        rows = scaled(m, plan.series, m.nominal, self.scaling) @ self.basis
        log_phi = self.criterion.value(self.prior + rows.T @ rows)
        return self.criterion.log_size * log_phi


def _evaluator(
    start: ReadingPlan,
    criterion: Criterion,
    scaling: Scaling,
    prior: Array | None,
) -> _PolishEvaluator:
    """Over all free parameters with a prior, else over what the start determines."""
    m = start.measurement
    columns = np.eye(len(m.parameters))[:, m.free]
    if prior is not None:
        information_known = np.asarray(prior, dtype=float)
        return _PolishEvaluator(criterion, scaling, columns, information_known)
    rows = scaled(m, start.series, m.nominal, scaling) @ columns
    _, singular_values, vt = np.linalg.svd(rows, full_matrices=False)
    estimable = vt[singular_values > UNDETERMINED * singular_values[0]].T
    nothing_known = np.zeros((estimable.shape[1],) * 2)
    restricted = criterion.restrict(estimable)
    lost = restricted.log_size < criterion.log_size
    if lost and not criterion.any_coordinates:
        raise ValueError(
            "the readings do not determine the directions of interest: choose other"
            " directions or readings"
        )
    return _PolishEvaluator(restricted, scaling, columns @ estimable, nothing_known)
