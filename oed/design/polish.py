"""Readings polished: poses and set-up variables (cup, bar length, tool) moved together
to the next local optimum.

Full space: every pose keeps its pose x, joints q and command c as variables, tied by

    phi(x, q, p) = 0,   commanded(x, tip) = target(c)          at nominal parameters,
    y - holds(settings) = 0, or within the bar's travel        where the instrument holds its reading,
    sign det phi_x >= clearance |det phi_x at home|            where asked, on either side of a singularity,

within workspace, joint ranges and the ranges of the free set-up variables. Maximised is
a smooth criterion of M = M0 + H^T H (`oed.design.smooth`), H as
`oed.design.reading_slopes` tells. Another tool moves the workspace, and the teach pose
with it: the variable is c less the tool's shift. IPOPT does the work, with first
derivatives by CasADi.

What IPOPT finds counts only after it was computed again by `oed.measurement`: in range,
on hold, and better.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed import information
from oed.arrays import Array, Index
from oed.design import reading_slopes, smooth
from oed.design.reading_plan import (
    HELD,
    Ranges,
    ReadingPlan,
    commanded,
    fault,
    home_clear,
    missed,
    repaired,
    shift,
    values,
)
from oed.design.smooth import Smooth
from oed.instrument import Setup
from oed.kinematics import AssemblyError
from oed.measurement import Measurement, Series

#: a start further than this from what it should hold is refused
OFF = 1e-6
#: relative singular value below which a direction counts as unseen by the start
UNSEEN = 1e-6
#: gain below which the start is kept
GAIN = 1e-9
IPOPT: dict[str, Any] = {
    "hessian_approximation": "limited-memory",
    "limited_memory_max_history": 30,
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-7,
    "constr_viol_tol": 1e-10,
    # an optimum that is flat is left once ten steps changed nothing
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
#: curvature that the quasi-Newton matrix starts from, tried in turn: low ones step far,
#: and may lose the way
CURVATURE = (30.0, 1000.0)


@dataclasses.dataclass(frozen=True)
class Polished:
    """Polished readings.

    series        as given, with other commands, joints and poses
    measurement   with the set-ups as they are now
    value_before, value_after   criterion over the directions that the start sees (with
                                a prior: over all)
    words         what was gained, or why the start is kept
    """

    series: tuple[Series, ...]
    measurement: Measurement
    value_before: float
    value_after: float
    words: str

    @property
    def setups(self) -> tuple[Setup, ...]:
        """Set-ups with their new settings, tools and teach poses."""
        return tuple(self.measurement.setups.values())


def polish_readings(
    measurement: Measurement,
    series: Sequence[Series],
    criterion: Smooth | None = None,
    scaling: information.Scaling = "tolerance",
    *,
    free: Ranges | None = None,
    prior: Array | None = None,
    travel: float | None = None,
    clearance: float | None = None,
    iterations: int = 500,
) -> Polished:
    """Readings moved to a local optimum; the start itself, with the reason, where that
    fails or gains nothing.

    criterion and prior (n, n) are over the free parameters in the stated scaling. free:
    set-up -> setting or tool_x, tool_y, tool_z -> range (SI). travel (m): by how much a
    held reading may differ from its nominal; None: not at all. clearance: least |det
    phi_x| as a share of that at home. Raises ValueError for unknown names, a start
    outside the ranges or off hold, recorded joints without commands, and noise that a
    run shares.
    """
    start = ReadingPlan(measurement, tuple(series))
    variables = _checked(start, free or {}, travel)
    basis, judge = _judge(
        start, smooth.determinant() if criterion is None else criterion, scaling, prior
    )
    before = judge(start)
    if not np.isfinite(before):
        raise ValueError(
            "the start is singular: give readings that see every direction, or a prior"
        )
    nlp = _Program(start, variables, travel, clearance)
    nlp.aim(
        basis,
        np.zeros((basis.shape[1],) * 2) if prior is None else prior,
        judge.criterion,
        scaling,
    )
    words = []
    for curvature in CURVATURE:
        told, z = nlp.solve(curvature, iterations)
        try:
            found = repaired(nlp.plan(z), travel)
            problem = fault(found, variables, travel, clearance)
            after = judge(found) if problem is None else -np.inf
        except AssemblyError as error:
            problem, after = str(error), -np.inf
        if after > before + GAIN:
            gained = f"polishing gained {after - before:.4g} ({told})"
            return Polished(found.series, found.measurement, before, after, gained)
        words.append(f"{told}: {problem or 'nothing better was found nearby'}")
    return Polished(
        start.series,
        measurement,
        before,
        before,
        f"the start is kept; {'; '.join(words)}",
    )


# -- what is varied, and how it is judged ----------------------------------------------


def _checked(
    start: ReadingPlan, free: Ranges, travel: float | None
) -> dict[str, dict[str, tuple[float, float]]]:
    """The free set-up variables; raises ValueError for what cannot be a start."""
    setups = start.measurement.setups
    used = {s.setup for s in start.series}
    variables: dict[str, dict[str, tuple[float, float]]] = {name: {} for name in setups}
    for name, ranges in free.items():
        if name not in used:
            raise ValueError(
                f"set-up {name!r} reads nothing here; there are {sorted(used)}"
            )
        known = values(setups[name])
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
    for s in start.series:
        if np.isnan(s.command).any():
            raise ValueError(
                f"set-up {s.setup}: joints were recorded there, and no commands that"
                " could be moved"
            )
    miss = missed(start, travel)
    if miss > OFF:
        raise ValueError(
            f"the start is {miss:.3g} m off what its instrument holds: solve it with"
            " Measurement.hold"
        )
    problem = fault(start, variables, None if miss > HELD else travel, None, hold=False)
    if problem is not None:
        raise ValueError(f"not a start: {problem}")
    return variables


@dataclasses.dataclass(frozen=True)
class _PolishJudge:
    criterion: Smooth
    scaling: information.Scaling
    basis: Array
    prior: Array

    def __call__(self, plan: ReadingPlan) -> float:
        m = plan.measurement
        rows = information.scaled(m, plan.series, m.nominal, self.scaling) @ self.basis
        return self.criterion.value(self.prior + rows.T @ rows)


def _judge(
    start: ReadingPlan,
    criterion: Smooth,
    scaling: information.Scaling,
    prior: Array | None,
) -> tuple[Array, _PolishJudge]:
    """Basis (n, r) of what is judged, and the judge."""
    m = start.measurement
    columns = np.eye(len(m.parameters))[:, m.free]
    if prior is not None:
        return columns, _PolishJudge(
            criterion, scaling, columns, np.asarray(prior, dtype=float)
        )
    _, s, vt = np.linalg.svd(
        information.scaled(m, start.series, m.nominal, scaling) @ columns,
        full_matrices=False,
    )
    seen = vt[s > UNSEEN * s[0]].T
    basis = columns @ seen
    return basis, _PolishJudge(
        criterion.within(seen), scaling, basis, np.zeros((seen.shape[1],) * 2)
    )


# -- the programme ---------------------------------------------------------------------


class _Program:
    """The nonlinear programme: variables with bounds and start, constraints, and the
    way back to readings.
    """

    def __init__(
        self,
        start: ReadingPlan,
        variables: Ranges,
        travel: float | None,
        clearance: float | None,
    ) -> None:
        self.start, self.travel, self.clearance = start, travel, clearance
        self.machine = start.measurement.machine
        self._parts: list[Any] = []
        self._z: list[Array] = []
        self._lower: list[Array] = []
        self._upper: list[Array] = []
        self._g: list[Any] = []
        self._g_lower: list[Array] = []
        self._g_upper: list[Array] = []
        self._setups = {
            name: self._setup(start.measurement.setups[name], variables[name])
            for name in variables
        }
        self._pose = reading_slopes.pose(self.machine)
        self._shift = shift(start.measurement)
        self._poses = [self._series(s) for s in start.series]

    def _variable(self, value: Array, lower: Array, upper: Array) -> Any:
        """A matrix (., m) of variables from values (m, .)."""
        part = ca.MX.sym(f"z{len(self._parts)}", value.shape[1], value.shape[0])
        self._parts.append(ca.vec(part))
        self._z.append(np.clip(value, lower, upper).ravel())
        self._lower.append(np.broadcast_to(lower, value.shape).ravel())
        self._upper.append(np.broadcast_to(upper, value.shape).ravel())
        return part

    def _constrain(self, g: Any, lower: float, upper: float) -> None:
        size = g.numel()
        self._g.append(ca.vec(g))
        self._g_lower.append(np.full(size, lower))
        self._g_upper.append(np.full(size, upper))

    def _setup(
        self, setup: Setup, ranges: Mapping[str, tuple[float, float]]
    ) -> tuple[Any, Any]:
        """Settings and tool: numbers, or variables where they are free."""
        made = []
        for name, value in values(setup).items():
            if name in ranges:
                lower, upper = ranges[name]
                made.append(
                    self._variable(
                        np.array([[value]]), np.array(lower), np.array(upper)
                    )
                )
            else:
                made.append(ca.MX(value))
        split = len(setup.settings)
        order = list(setup.settings)
        settings = [made[order.index(item.name)] for item in setup.instrument.settings]
        return ca.vertcat(*settings) if settings else ca.MX(0, 1), ca.vertcat(
            *made[split:]
        )

    def _series(self, s: Series) -> tuple[Any, Any, Any]:
        """Pose, joints, and command less the tool's shift, tied together."""
        setup, (_, tool) = self.start.setup(s), self._setups[s.setup]
        m, joints, command = len(s.q), self.machine.joints, self.machine.command
        fixed = int(
            self.start.taught(s)
        )  # the last pose, where taught: fixed but for the tool
        still = fixed if tool.is_constant() else 0
        move = m - still
        none = np.full(s.start.shape[1], np.inf)
        x = self._variable(s.start[:move], -none, none)
        q = self._variable(
            s.q[:move],
            np.array([j.lower for j in joints]),
            np.array([j.upper for j in joints]),
        )
        own = s.command - np.array(setup.tool) @ self._shift.T
        c = self._variable(
            own[: m - fixed],
            np.array([i.lower for i in command]),
            np.array([i.upper for i in command]),
        )
        all_c = ca.horzcat(c, ca.DM(own[m - fixed :].T))
        moved = all_c[:, :move] + ca.repmat(ca.DM(self._shift) @ tool, 1, move)
        self._constrain(
            self._pose.closed.map(move)(x, q, moved, ca.repmat(tool, 1, move)), 0.0, 0.0
        )
        if self.clearance is not None and self._pose.clear.numel_out(0):
            home = home_clear(self.start.measurement)
            self._constrain(
                self._pose.clear.map(move)(x, q) / home, self.clearance, np.inf
            )
        return (
            ca.horzcat(x, ca.DM(s.start[move:].T)),
            ca.horzcat(q, ca.DM(s.q[move:].T)),
            all_c,
        )

    def _seen(self, k: int, index: Index) -> list[Any]:
        """Inputs of the readings that see the poses `index` (n, arity) of series k."""
        x, q, _ = self._poses[k]
        settings, tool = self._setups[self.start.series[k].setup]
        n = len(index)
        inputs = [
            v[:, [int(i) for i in index[:, j]]]
            for j in range(index.shape[1])
            for v in (x, q)
        ]
        return [*inputs, ca.repmat(settings, 1, n), ca.repmat(tool, 1, n)]

    def _hold(self, k: int, value: Any) -> None:
        """The first channel of each reading is what the instrument holds."""
        s = self.start.series[k]
        setup = self.start.setup(s)
        if setup.instrument.holds is None:
            return
        settings, _ = self._setups[s.setup]
        known = {
            item.name: settings[i] for i, item in enumerate(setup.instrument.settings)
        }
        index = np.unique(s.index, axis=0)
        y = value.map(len(index))(*self._seen(k, index))
        slack = self.travel or 0.0
        self._constrain(y[0, :] - setup.instrument.holds(known), -slack, slack)

    def aim(
        self,
        basis: Array,
        prior: Array,
        criterion: Smooth,
        scaling: information.Scaling,
    ) -> None:
        """Put up the objective and the held readings."""
        m = ca.MX(ca.DM(prior))
        for k, s in enumerate(self.start.series):
            one = reading_slopes.reading(
                self.start.measurement, self.start.setup(s), scaling, basis
            )
            columns = one.rows.map(len(s))(*self._seen(k, s.index))
            m += columns @ columns.T
            self._hold(k, one.value)
        whole = ca.SX.sym("m", *m.shape)
        self._judge = ca.Function(
            "judge", [whole], [criterion.expression(whole)], {"cse": True}
        )(m)

    def solve(self, curvature: float, iterations: int) -> tuple[str, Array]:
        """IPOPT's words and its last point."""
        nlp: Any = {
            "x": ca.vertcat(*self._parts),
            "f": -self._judge,
            "g": ca.vertcat(*self._g),
        }
        ipopt = {**IPOPT, "limited_memory_init_val": curvature, "max_iter": iterations}
        options: Any = {
            "ipopt": ipopt,
            "print_time": False,
            "show_eval_warnings": False,
        }
        solver = ca.nlpsol("polish", "ipopt", nlp, options)
        found = solver(
            x0=np.concatenate(self._z),
            lbx=np.concatenate(self._lower),
            ubx=np.concatenate(self._upper),
            lbg=np.concatenate(self._g_lower),
            ubg=np.concatenate(self._g_upper),
        )
        told = str(solver.stats()["return_status"]).replace("_", " ").lower()
        return (
            f"{told} after {solver.stats()['iter_count']} iterations",
            np.asarray(found["x"], dtype=float).ravel(),
        )

    def plan(self, z: Array) -> ReadingPlan:
        """Set-ups and readings at a point, computed anew from its commands and settings
        alone.
        """
        z = np.clip(z, np.concatenate(self._lower), np.concatenate(self._upper))
        wanted = [v for pair in self._setups.values() for v in pair] + [
            c.T for _, _, c in self._poses
        ]
        read = ca.Function("read", [ca.vertcat(*self._parts)], wanted)
        numbers = [np.asarray(v, dtype=float) for v in read.call([ca.DM(z)])]
        setups, commands = [], numbers[2 * len(self._setups) :]
        for i, name in enumerate(self._setups):
            setups.append(
                self._changed(
                    self.start.measurement.setups[name],
                    numbers[2 * i],
                    numbers[2 * i + 1],
                )
            )
        measurement = Measurement(self.machine, setups)
        plan = ReadingPlan(measurement, self.start.series)
        shifted = [
            c + np.array(plan.setup(s).tool) @ self._shift.T
            for s, c in zip(plan.series, commands, strict=True)
        ]
        return commanded(plan, shifted)

    def _changed(self, setup: Setup, settings: Array, tool: Array) -> Setup:
        values = {
            item.name: float(v)
            for item, v in zip(setup.instrument.settings, settings.ravel(), strict=True)
        }
        own = tuple(float(v) for v in tool.ravel())
        teach = None
        if setup.teach is not None:
            teach = tuple(
                np.array(setup.teach)
                + self._shift @ (np.array(own) - np.array(setup.tool))
            )
        return dataclasses.replace(
            setup, settings=values, tool=(own[0], own[1], own[2]), teach=teach
        )
