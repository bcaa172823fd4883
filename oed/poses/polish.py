"""Poses and set-up variables polished together to the next local optimum.

The variables are poses x, joints q and commands c of every pose, and the free set-up
variables (cup, bar length, tool). They are tied by

    phi(x, q, p) = 0,   commanded(x, tip) = target(c)          at nominal parameters,
    y - holds(settings) = 0, or within the bar's travel        where the instrument holds its reading,
    sign det phi_x >= clearance |det phi_x at home|            where asked, on either side of a singularity,

within workspace, joint ranges and the ranges of the free variables. The objective is a
smooth criterion of M = M0 + H^T H (`Criterion.polished`), with H from
`oed.poses.reading_plan`. IPOPT_OPTIONS solves the programme. Its result counts only after the
measurement has computed it again: in range, on hold, and better than the start.

Another tool moves the workspace, and the
teach pose with it, so the variable of a command is c less the tool's shift. CasADi gives
first derivatives.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.base import Array, Index
from oed.design import CRITERIA, Criterion
from oed.identifiability import Scaling, scaled
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.poses import reading_plan
from oed.poses.reading_plan import (
    HOLD_TOLERANCE,
    Ranges,
    ReadingPlan,
    find_fault,
    home_determinant,
    largest_hold_error,
    move_to_commands,
    restore_hold,
    settings_and_tool,
    tool_shift,
)

IPOPT_OPTIONS: dict[str, Any] = {
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 30,
    "print_level": 0,
    "sb": "yes",
    "option_file_name": "",  # otherwise ipopt.opt of the current folder
    "tol": 1e-7,
    "constr_viol_tol": 1e-10,
    # a flat optimum ends once ten steps changed nothing
    "acceptable_tol": 0.1,
    "acceptable_constr_viol_tol": 1e-8,
    "acceptable_obj_change_tol": 1e-8,
    "acceptable_iter": 10,
    "bound_relax_factor": 0.0,
    "bound_push": 1e-4,
    "bound_frac": 1e-4,
    "mu_init": 1e-3,
    "limited_memory_initialization": "constant",
}


class _SymbolicSetup(NamedTuple):
    """Settings in the instrument's order, and tool: numbers or variables."""

    settings: Any
    tool: Any


class _SymbolicSeries(NamedTuple):
    """Poses, joints, and commands less the tool's shift, one column a pose."""

    x: Any
    q: Any
    command: Any


#: a part of the variables or constraints, with the bounds of its entries
_Bounded = tuple[Any, Array, Array]


def _stacked(parts: Sequence[_Bounded]) -> _Bounded:
    """All parts as one column, with their lower and upper bounds."""
    expressions, lower, upper = zip(*parts, strict=True)
    column: Any = ca.vertcat(*map(ca.vec, expressions))
    return column, np.concatenate(lower), np.concatenate(upper)


class PolishProgram:
    """The programme of one start: build it, set its objective, solve it."""

    def __init__(
        self,
        start: ReadingPlan,
        variables: Ranges,
        travel: float | None,
        clearance: float | None,
    ) -> None:
        self.start, self.travel, self.clearance = start, travel, clearance
        self.machine = start.measurement.machine
        self._variables: list[_Bounded] = []
        self._constraints: list[_Bounded] = []
        self._start_values: list[Array] = []
        self._objective: Any = None
        self._setups = {
            name: self._add_setup(start.measurement.setups[name], variables[name])
            for name in variables
        }
        self._pose = reading_plan.symbolic_pose(start.measurement.kinematics)
        self._shift = tool_shift(start.measurement)
        self._series = [self._add_series(series) for series in start.series]

    # -- variables and constraints -----------------------------------------------------
    def _add_variable(self, value: Array, lower: Array, upper: Array) -> Any:
        """A matrix (., m) of variables from values (m, .)."""
        name = f"z{len(self._start_values)}"
        variable = ca.MX.sym(name, value.shape[1], value.shape[0])
        lower_all = np.broadcast_to(lower, value.shape).ravel()
        upper_all = np.broadcast_to(upper, value.shape).ravel()
        self._variables.append((variable, lower_all, upper_all))
        self._start_values.append(np.clip(value, lower, upper).ravel())
        return variable

    def _constrain(self, expression: Any, lower: float, upper: float) -> None:
        size = expression.numel()
        bounds = np.full(size, lower), np.full(size, upper)
        self._constraints.append((expression, *bounds))

    def _add_setup(
        self, setup: Setup, ranges: Mapping[str, tuple[float, float]]
    ) -> _SymbolicSetup:
        symbols: dict[str, Any] = {}
        for name, value in settings_and_tool(setup).items():
            if name in ranges:
                lower, upper = ranges[name]
                symbols[name] = self._add_variable(
                    np.array([[value]]), np.array(lower), np.array(upper)
                )
            else:
                symbols[name] = ca.MX(value)
        settings = [symbols[item.name] for item in setup.instrument.settings]
        tool = [symbols[name] for name in reading_plan.TOOL_NAMES]
        no_settings = ca.MX(0, 1)
        return _SymbolicSetup(
            ca.vertcat(*settings) if settings else no_settings, ca.vertcat(*tool)
        )

    def _add_series(self, series: Series) -> _SymbolicSeries:
        """Variables of the poses of a series, tied by their equations."""
        setup = self.start.setup(series)
        tool = self._setups[series.setup].tool
        joints, command = self.machine.joints, self.machine.command
        count = len(series.q)
        # the last pose is fixed where it is the teach pose, but for the tool
        fixed = int(self.start.has_teach_pose(series))
        movable = count - (fixed if tool.is_constant() else 0)
        unbounded = np.full(series.start.shape[1], np.inf)
        x = self._add_variable(series.start[:movable], -unbounded, unbounded)
        q = self._add_variable(
            series.q[:movable],
            np.array([j.lower for j in joints]),
            np.array([j.upper for j in joints]),
        )
        unshifted = series.command - np.array(setup.tool) @ self._shift.T
        c = self._add_variable(
            unshifted[: count - fixed],
            np.array([i.lower for i in command]),
            np.array([i.upper for i in command]),
        )
        all_commands = ca.horzcat(c, ca.DM(unshifted[count - fixed :].T))
        shifts = ca.repmat(ca.DM(self._shift) @ tool, 1, movable)
        shifted = all_commands[:, :movable] + shifts
        tools = ca.repmat(tool, 1, movable)
        residual = self._pose.residual.map(movable)(x, q, shifted, tools)
        self._constrain(residual, 0.0, 0.0)
        if self.clearance is not None and self._pose.determinant.numel_out(0):
            home = home_determinant(self.start.measurement)
            shares = self._pose.determinant.map(movable)(x, q) / home
            self._constrain(shares, self.clearance, np.inf)
        return _SymbolicSeries(
            ca.horzcat(x, ca.DM(series.start[movable:].T)),
            ca.horzcat(q, ca.DM(series.q[movable:].T)),
            all_commands,
        )

    def _reading_inputs(self, k: int, index: Index) -> list[Any]:
        """Inputs of the readings of series k that see the poses `index` (n, arity)."""
        symbolic = self._series[k]
        settings, tool = self._setups[self.start.series[k].setup]
        inputs: list[Any] = []
        for j in range(index.shape[1]):
            columns = [int(i) for i in index[:, j]]
            inputs += [symbolic.x[:, columns], symbolic.q[:, columns]]
        count = len(index)
        return [*inputs, ca.repmat(settings, 1, count), ca.repmat(tool, 1, count)]

    def _constrain_hold(self, k: int, value: Any) -> None:
        """The first channel of each reading is the value that the instrument holds."""
        series = self.start.series[k]
        instrument = self.start.setup(series).instrument
        if instrument.fixed_reading is None:
            return
        settings = self._setups[series.setup].settings
        by_name = {item.name: settings[i] for i, item in enumerate(instrument.settings)}
        index = np.unique(series.index, axis=0)
        y = value.map(len(index))(*self._reading_inputs(k, index))
        slack = self.travel or 0.0
        self._constrain(y[0, :] - instrument.fixed_reading(by_name), -slack, slack)

    def set_objective(self, goal: "_PolishEvaluator") -> None:
        """The criterion over the columns of its basis, and the held readings."""
        m = ca.MX(ca.DM(goal.prior))
        for k, series in enumerate(self.start.series):
            setup = self.start.setup(series)
            reading = reading_plan.symbolic_reading(
                self.start.measurement, setup, goal.scaling, goal.basis
            )
            inputs = self._reading_inputs(k, series.index)
            columns = reading.rows.map(len(series))(*inputs)
            m += columns @ columns.T
            self._constrain_hold(k, reading.value)
        symbol = ca.SX.sym("m", *m.shape)
        value = goal.criterion.expression(symbol)
        function = ca.Function("criterion", [symbol], [value], {"cse": True})
        self._objective = function(m)

    # -- solution ----------------------------------------------------------------------
    def solve(self, curvature: float, iterations: int) -> tuple[str, Array]:
        """IPOPT's status, and its last point."""
        x, lower, upper = _stacked(self._variables)
        g, g_lower, g_upper = _stacked(self._constraints)
        nlp: Any = {"x": x, "f": -self._objective, "g": g}
        ipopt = {
            **IPOPT_OPTIONS,
            "limited_memory_init_val": curvature,
            "max_iter": iterations,
        }
        options: Any = {
            "ipopt": ipopt,
            "print_time": False,
            "show_eval_warnings": False,
        }
        solver = ca.nlpsol("polish", "ipopt", nlp, options)
        start = np.concatenate(self._start_values)
        solution = solver(x0=start, lbx=lower, ubx=upper, lbg=g_lower, ubg=g_upper)
        status = str(solver.stats()["return_status"]).replace("_", " ").lower()
        status = f"{status} after {solver.stats()['iter_count']} iterations"
        return status, np.asarray(solution["x"], dtype=float).ravel()

    def plan(self, z: Array) -> ReadingPlan:
        """Set-ups and readings at a point, computed anew from commands and settings."""
        variables, lower, upper = _stacked(self._variables)
        z = np.clip(z, lower, upper)
        outputs: list[Any] = []
        for symbolic in self._setups.values():
            outputs += [symbolic.settings, symbolic.tool]
        outputs += [series.command.T for series in self._series]
        evaluate = ca.Function("evaluate", [variables], outputs)
        numbers = [np.asarray(v, dtype=float) for v in evaluate.call([ca.DM(z)])]
        setups = []
        for i, name in enumerate(self._setups):
            setup = self.start.measurement.setups[name]
            settings, tool = numbers[2 * i], numbers[2 * i + 1]
            setups.append(self._set_values(setup, settings, tool))
        unshifted = numbers[2 * len(self._setups) :]
        measurement = self.start.measurement.with_setups(setups)
        plan = ReadingPlan(measurement, self.start.series)
        commands = []
        for series, command in zip(plan.series, unshifted, strict=True):
            shift = np.array(plan.setup(series).tool) @ self._shift.T
            commands.append(command + shift)
        return move_to_commands(plan, commands)

    def _set_values(self, setup: Setup, settings: Array, tool: Array) -> Setup:
        """The set-up with other settings and another tool, its teach pose moved by it."""
        items = zip(setup.instrument.settings, settings.ravel(), strict=True)
        values = {item.name: float(value) for item, value in items}
        tool_x, tool_y, tool_z = (float(v) for v in tool.ravel())
        teach = None
        if setup.teach is not None:
            change = np.array((tool_x, tool_y, tool_z)) - np.array(setup.tool)
            teach = tuple(np.array(setup.teach) + self._shift @ change)
        return dataclasses.replace(
            setup, settings=values, tool=(tool_x, tool_y, tool_z), teach=teach
        )


#: a start whose readings are further than this from the value held is refused
START_TOLERANCE = 1e-6
#: singular values below this share of the largest count as undetermined by the start
UNDETERMINED_SHARE = 1e-6
MIN_GAIN = 1e-9  #: gain below which the start is kept
#: curvature that the quasi-Newton matrix starts from, tried in turn: low ones step far,
#: and may fail
START_CURVATURES = (30.0, 1000.0)


@dataclasses.dataclass(frozen=True)
class PolishResult:
    """Polished readings."""

    series: tuple[Series, ...]  #: as given, with other commands, joints and poses
    measurement: Measurement  #: with the set-ups as they are now
    #: criterion of the start, over the directions that it determines (with a prior:
    #: over all)
    value_before: float
    value_after: float  #: criterion of the polished readings
    summary: str  #: what was gained, or why the start is kept

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
    iterations  of IPOPT_OPTIONS, at the most

    Raises ValueError for a criterion that has none, unknown names, a start outside the ranges or off hold, recorded
    joints without commands, and noise that a run shares.
    """
    start = ReadingPlan(measurement, tuple(series))
    variables = _check_start(start, free or {}, travel)
    if criterion is None:
        criterion = CRITERIA.build("D", int(measurement.free.sum()))
    if criterion.polished is None:
        raise ValueError(f"{criterion.name} has no gradient to polish along")
    evaluator = _evaluator(start, criterion.polished, scaling, prior)
    before = evaluator.value(start)
    if not np.isfinite(before):
        raise ValueError(
            "the start is singular: give readings that determine every direction, or a prior"
        )
    program = PolishProgram(start, variables, travel, clearance)
    program.set_objective(evaluator)
    reasons = []
    for curvature in START_CURVATURES:
        status, z = program.solve(curvature, iterations)
        try:
            polished = restore_hold(program.plan(z), travel)
            fault = find_fault(polished, variables, travel, clearance)
            after = evaluator.value(polished) if fault is None else -np.inf
        except AssemblyError as error:
            fault = str(error)
            after = -np.inf
        if after > before + MIN_GAIN:
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
        current = settings_and_tool(setups[name])
        for variable, (lower, upper) in ranges.items():
            if variable not in current:
                raise ValueError(
                    f"set-up {name}: {variable!r} is none of {sorted(current)}"
                )
            if not lower <= current[variable] <= upper:
                raise ValueError(
                    f"set-up {name}: {variable} = {current[variable]:g} is outside"
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
    start: ReadingPlan, criterion: Criterion, scaling: Scaling, prior: Array | None
) -> _PolishEvaluator:
    """Over all free parameters with a prior, else over what the start determines."""
    m = start.measurement
    columns = np.eye(len(m.parameters))[:, m.free]
    if prior is not None:
        information_current = np.asarray(prior, dtype=float)
        return _PolishEvaluator(criterion, scaling, columns, information_current)
    rows = scaled(m, start.series, m.nominal, scaling) @ columns
    _, singular_values, vt = np.linalg.svd(rows, full_matrices=False)
    estimable = vt[singular_values > UNDETERMINED_SHARE * singular_values[0]].T
    nothing_current = np.zeros((estimable.shape[1],) * 2)
    restricted = criterion.restrict(estimable)
    lost = restricted.log_size < criterion.log_size
    if lost and not criterion.any_coordinates:
        raise ValueError(
            "the readings do not determine the directions of interest: choose other"
            " directions or readings"
        )
    return _PolishEvaluator(restricted, scaling, columns @ estimable, nothing_current)
