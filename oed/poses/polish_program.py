"""The nonlinear programme of polishing: variables, constraints, objective, solution.

`oed.poses.polish` states the programme. Another tool moves the workspace, and the
teach pose with it, so the variable of a command is c less the tool's shift. IPOPT
solves it, with first derivatives by CasADi.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.base import Array, Index
from oed.design import Criterion
from oed.identifiability import Scaling
from oed.measurement import Series
from oed.model.instrument import Setup
from oed.poses import reading_plan
from oed.poses.reading_plan import (
    Ranges,
    ReadingPlan,
    at_commands,
    home_determinant,
    settings_and_tool,
    tool_shift,
)

IPOPT: dict[str, Any] = {
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


class _Bounded:
    """Stacked variables or constraints with their bounds."""

    def __init__(self) -> None:
        self.parts: list[Any] = []
        self.lower: list[Array] = []
        self.upper: list[Array] = []

    def add(self, part: Any, lower: Array, upper: Array) -> None:
        """Adds a part with bounds of its size."""
        self.parts.append(ca.vec(part))
        self.lower.append(lower)
        self.upper.append(upper)

    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper bounds of all parts."""
        return np.concatenate(self.lower), np.concatenate(self.upper)


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
        self._variables, self._constraints = _Bounded(), _Bounded()
        self._start_values: list[Array] = []
        self._objective: Any = None
        self._setups = {
            name: self._add_setup(start.measurement.setups[name], variables[name])
            for name in variables
        }
        self._pose = reading_plan.symbolic_pose(self.machine)
        self._shift = tool_shift(start.measurement)
        self._series = [self._add_series(series) for series in start.series]

    # -- variables and constraints -----------------------------------------------------

    def _add_variable(self, value: Array, lower: Array, upper: Array) -> Any:
        """A matrix (., m) of variables from values (m, .)."""
        name = f"z{len(self._start_values)}"
        variable = ca.MX.sym(name, value.shape[1], value.shape[0])
        lower_all = np.broadcast_to(lower, value.shape).ravel()
        upper_all = np.broadcast_to(upper, value.shape).ravel()
        self._variables.add(variable, lower_all, upper_all)
        self._start_values.append(np.clip(value, lower, upper).ravel())
        return variable

    def _constrain(self, expression: Any, lower: float, upper: float) -> None:
        size = expression.numel()
        self._constraints.add(expression, np.full(size, lower), np.full(size, upper))

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
        tool = [symbols[name] for name in reading_plan.TOOL]
        no_settings = ca.MX(0, 1)
        return _SymbolicSetup(
            ca.vertcat(*settings) if settings else no_settings, ca.vertcat(*tool)
        )

    def _add_series(self, series: Series) -> _SymbolicSeries:
        """Variables of the poses of a series, tied by their equations."""
        setup, tool = self.start.setup(series), self._setups[series.setup].tool
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
        known = {item.name: settings[i] for i, item in enumerate(instrument.settings)}
        index = np.unique(series.index, axis=0)
        y = value.map(len(index))(*self._reading_inputs(k, index))
        slack = self.travel or 0.0
        self._constrain(y[0, :] - instrument.fixed_reading(known), -slack, slack)

    def set_objective(
        self,
        basis: Array,
        prior: Array,
        criterion: Criterion,
        scaling: Scaling,
    ) -> None:
        """The criterion over the columns of `basis`, and the held readings."""
        m = ca.MX(ca.DM(prior))
        for k, series in enumerate(self.start.series):
            setup = self.start.setup(series)
            reading = reading_plan.symbolic_reading(
                self.start.measurement, setup, scaling, basis
            )
            inputs = self._reading_inputs(k, series.index)
            columns = reading.rows.map(len(series))(*inputs)
            m += columns @ columns.T
            self._constrain_hold(k, reading.value)
        symbol = ca.SX.sym("m", *m.shape)
        value = criterion.expression(symbol)
        function = ca.Function("criterion", [symbol], [value], {"cse": True})
        self._objective = function(m)

    # -- solution ----------------------------------------------------------------------

    def solve(self, curvature: float, iterations: int) -> tuple[str, Array]:
        """IPOPT's status, and its last point."""
        nlp: Any = {
            "x": ca.vertcat(*self._variables.parts),
            "f": -self._objective,
            "g": ca.vertcat(*self._constraints.parts),
        }
        ipopt = {**IPOPT, "limited_memory_init_val": curvature, "max_iter": iterations}
        options: Any = {
            "ipopt": ipopt,
            "print_time": False,
            "show_eval_warnings": False,
        }
        solver = ca.nlpsol("polish", "ipopt", nlp, options)
        lower, upper = self._variables.bounds()
        g_lower, g_upper = self._constraints.bounds()
        start = np.concatenate(self._start_values)
        solution = solver(x0=start, lbx=lower, ubx=upper, lbg=g_lower, ubg=g_upper)
        status = str(solver.stats()["return_status"]).replace("_", " ").lower()
        status = f"{status} after {solver.stats()['iter_count']} iterations"
        return status, np.asarray(solution["x"], dtype=float).ravel()

    def plan(self, z: Array) -> ReadingPlan:
        """Set-ups and readings at a point.

        They are computed anew from its commands and settings alone.
        """
        z = np.clip(z, *self._variables.bounds())
        outputs: list[Any] = []
        for symbolic in self._setups.values():
            outputs += [symbolic.settings, symbolic.tool]
        outputs += [series.command.T for series in self._series]
        variables = ca.vertcat(*self._variables.parts)
        evaluate = ca.Function("evaluate", [variables], outputs)
        numbers = [np.asarray(v, dtype=float) for v in evaluate.call([ca.DM(z)])]
        setups = []
        for i, name in enumerate(self._setups):
            setup = self.start.measurement.setups[name]
            settings, tool = numbers[2 * i], numbers[2 * i + 1]
            setups.append(self._with_values(setup, settings, tool))
        unshifted = numbers[2 * len(self._setups) :]
        measurement = self.start.measurement.with_setups(setups)
        plan = ReadingPlan(measurement, self.start.series)
        commands = []
        for series, command in zip(plan.series, unshifted, strict=True):
            shift = np.array(plan.setup(series).tool) @ self._shift.T
            commands.append(command + shift)
        return at_commands(plan, commands)

    def _with_values(self, setup: Setup, settings: Array, tool: Array) -> Setup:
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
