"""A plan of readings that can be moved to other commands, restored to hold, and checked.

All numbers come from the measurement. Nothing here depends on the programme that
found a plan (`oed.poses.polish`): what it reports is computed anew.

For polishing, the rows of a reading are a CasADi expression. The settings and the tool
of the set-up are symbols. A reading y = g(x_1, x_2, q_1, q_2, p, s; k, tool) sees one
pose or two, each with phi(x, q, p) = 0. With lambda_j from settled_x^T lambda_j =
g_xj^T (`oed.mechanism.kinematics` defines what a redundant machine settles to) its row
is

    dy/d(p, s) = [ g_p - sum_j lambda_j^T settled_p,  g_s ],

at nominal parameters. Whitening follows `oed.measurement`: by sigma of each channel, or
by the instrument's own error sources.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array
from oed.identifiability import Scaling, column_scale
from oed.instrument import Frame, Setup
from oed.measurement import Measurement, Series
from oed.mechanism import Kinematics, MachineFrame, symbols
from oed.model import Machine

TOOL_NAMES = ("tool_x", "tool_y", "tool_z")
#: options of every CasADi function: common subexpressions are evaluated once
CASADI_OPTIONS = {"cse": True}


@dataclasses.dataclass(frozen=True)
class SymbolicPose:
    """CasADi functions of one pose."""

    #: (x, q, c, tool) -> closure and controller equations, all to be zero
    residual: Any
    #: (x, q) -> det phi_x, lengths in units of the lever; (0,) for a redundant machine
    determinant: Any


@dataclasses.dataclass(frozen=True)
class SymbolicReading:
    """CasADi functions of one reading of a set-up.

    The arguments of both are (x_1, q_1, [x_2, q_2,] settings, tool), with settings (nk,)
    in the instrument's order and tool (3,).
    """

    rows: Any  #: -> H^T (n, k): scaled rows, transposed
    value: Any  #: -> channels (k,)


def symbolic_pose(kinematics: Kinematics) -> SymbolicPose:
    """Equations of one pose at nominal parameters."""
    machine, e = kinematics.machine, kinematics.expressions
    equations = ca.vertcat(e.phi, e.unmet_command)
    slope = ca.jacobian(e.phi, e.x)
    residual, phi_x = _nominal_values(machine, e.p, equations, slope)
    levers = [1.0 if item.unit == "rad" else machine.lever for item in machine.pose]
    determinant: Any = ca.SX(0, 1)
    if phi_x.shape[0] == phi_x.shape[1]:
        determinant = ca.det(phi_x @ ca.diag(ca.DM(levers)))
    return SymbolicPose(
        ca.Function("residual", [e.x, e.q, e.c, e.tool], [residual], CASADI_OPTIONS),
        ca.Function("determinant", [e.x, e.q], [determinant], CASADI_OPTIONS),
    )


def symbolic_reading(
    measurement: Measurement, setup: Setup, scaling: Scaling, basis: Any
) -> SymbolicReading:
    """One reading, rows times `basis` (n, r). Raises ValueError for noise of a run."""
    machine, instrument = measurement.machine, setup.instrument
    others = measurement.setups
    shares = any(c.shared for c in instrument.channels) or setup.statement.seating
    if scaling == "tolerance" and shares:
        raise ValueError(
            f"set-up {setup.name}: the readings of a run share an error (that of a"
            " reference, of a bar put up anew or of a seat): polish others"
        )
    p, ps = symbols("p", machine.parameters)
    s, ss = symbols("s", setup.nuisances)
    settings = ca.SX.sym("k", len(instrument.settings))
    by_name = {item.name: settings[i] for i, item in enumerate(instrument.settings)}
    tool = ca.SX.sym("tool", 3)
    poses: list[tuple[Any, Any, Any]] = []
    frames: list[Frame] = []
    for j in range(instrument.arity):
        x, xs = symbols(f"x{j}", machine.pose)
        q, qs = symbols(f"q{j}", machine.joints)
        phi = ca.vertcat(*machine.closure(xs, qs, ps))
        frames.append(MachineFrame(machine, x, (xs, qs, ps), tool))
        poses.append((x, q, phi))
    y = ca.vertcat(*instrument.observe(frames, ss, by_name))
    by_machine = ca.jacobian(y, p)
    for x, _, phi in poses:
        settled = phi if phi.numel() == x.numel() else ca.jacobian(phi, x).T @ phi
        adjoint = ca.solve(ca.jacobian(settled, x).T, ca.jacobian(y, x).T)
        by_machine -= adjoint.T @ ca.jacobian(settled, p)
    # the unknowns of other set-ups do not enter
    by_setup = {name: ca.SX(y.numel(), len(o.nuisances)) for name, o in others.items()}
    by_setup[setup.name] = ca.jacobian(y, s)
    rows: Any = ca.densify(ca.horzcat(by_machine, *by_setup.values()))
    rows = rows @ ca.diag(ca.DM(column_scale(measurement, scaling)))
    if scaling == "tolerance":
        sources = instrument.sources and instrument.sources(frames, ss, by_name)
        rows = _whiten(rows, setup, sources)
    elif scaling == "length":
        units = [channel.unit for channel in instrument.channels]
        lengths = [1.0 if unit == "m" else machine.lever for unit in units]
        rows = ca.diag(ca.DM(lengths)) @ rows
    nuisances = ca.DM([n.nominal for n in setup.nuisances])
    at_nominal: Any = [
        ca.substitute(e, s, nuisances) for e in _nominal_values(machine, p, rows, y)
    ]
    rows, y = at_nominal
    pose_symbols = [symbol for x, q, _ in poses for symbol in (x, q)]
    inputs = [*pose_symbols, settings, tool]
    projected = (rows @ ca.DM(np.asarray(basis))).T
    return SymbolicReading(
        ca.Function("rows", inputs, [projected], CASADI_OPTIONS),
        ca.Function("value", inputs, [y], CASADI_OPTIONS),
    )


def _nominal_values(machine: Machine, p: Any, *expressions: Any) -> list[Any]:
    nominal = ca.DM(machine.nominal)
    return [ca.substitute(e, p, nominal) for e in expressions]


def _whiten(rows: Any, setup: Setup, sources: Any | None) -> Any:
    """Rows over the channels' noise, or over the root of the sources' covariance."""
    if sources is None:
        return ca.diag(1.0 / ca.DM(setup.sigma)) @ rows
    channels = zip(setup.sigma, setup.instrument.channels, strict=True)
    factors = [sigma / channel.sigma for sigma, channel in channels]
    root = ca.diag(ca.DM(factors)) @ sources
    return ca.solve(ca.chol(root @ root.T).T, rows)


#: by how much a held reading may miss in the end, m or rad: a thousandth of what is read
HOLD_TOLERANCE = 1e-9
JOINT_TOLERANCE = 1e-9  #: by how much a joint may leave its range in the end, m or rad
MAX_RESTORE_STEPS = 6  #: number of Newton steps that restore the hold
#: step of their central differences, m or rad: near the cube root of the rounding
DIFFERENCE_STEP = 1e-6
#: a command nearer than this to the edge of the workspace is not moved
EDGE_TOLERANCE = 1e-8

#: set-up -> variable -> range, SI
Ranges = Mapping[str, Mapping[str, tuple[float, float]]]


@dataclasses.dataclass(frozen=True)
class ReadingPlan:
    """Readings with the measurement they belong to."""

    measurement: Measurement
    series: tuple[Series, ...]

    def setup(self, series: Series) -> Setup:
        """Set-up of a series."""
        return self.measurement.setups[series.setup]

    def has_teach_pose(self, series: Series) -> bool:
        """Whether the last pose of a series is its teach pose."""
        return self.setup(series).teach is not None


def tool_shift(measurement: Measurement) -> Array:
    """(n_dof, 3): by how much a tool moves each command coordinate."""
    names = [c.name for c in measurement.machine.command]
    return np.array([[float(name == axis) for axis in "xyz"] for name in names])


def settings_and_tool(setup: Setup) -> dict[str, float]:
    """Settings and tool of a set-up by name, SI."""
    return {**setup.settings, **dict(zip(TOOL_NAMES, setup.tool, strict=True))}


def move_to_commands(plan: ReadingPlan, commands: Sequence[Array]) -> ReadingPlan:
    """The readings at other commands (m, n_dof). Raises AssemblyError."""
    moved = []
    for series, command in zip(plan.series, commands, strict=True):
        command = command.copy()
        setup = plan.setup(series)
        if plan.has_teach_pose(series):
            command[-1] = setup.teach
        x, q = plan.measurement.kinematics.sent(command, np.array(setup.tool))
        moved.append(dataclasses.replace(series, q=q, start=x, command=command))
    return ReadingPlan(plan.measurement, tuple(moved))


def home_determinant(measurement: Measurement) -> float:
    """det phi_x at home, with its sign; not for redundant machines."""
    kinematics = measurement.kinematics
    x, q = kinematics.inverse(kinematics.machine.home_command)
    return float(symbolic_pose(kinematics).determinant(x[0], q[0]))


# -- readings that the instrument holds ------------------------------------------------
def _first_channel(measurement: Measurement, series: Series) -> Array:
    """First channel (n,) of the readings of a series on the nominal machine."""
    readings = measurement.readings([series], measurement.nominal)
    return readings.reshape(len(series), -1)[:, 0]


def _hold_errors(
    plan: ReadingPlan, series: Series, travel: float | None
) -> Array | None:
    """Distance (n,) of readings beyond travel about a held value; None without one."""
    setup = plan.setup(series)
    if setup.instrument.fixed_reading is None:
        return None
    reading = _first_channel(plan.measurement, series)
    error = reading - setup.instrument.fixed_reading(setup.settings)
    return error - np.clip(error, -(travel or 0.0), travel or 0.0)


def largest_hold_error(plan: ReadingPlan, travel: float | None) -> float:
    """Largest distance (m, rad) of a reading from the value held, beyond the travel."""
    errors = [_hold_errors(plan, series, travel) for series in plan.series]
    largest = [float(np.abs(e).max()) for e in errors if e is not None]
    return max(largest, default=0.0)


def restore_hold(plan: ReadingPlan, travel: float | None) -> ReadingPlan:
    """The plan after Newton steps that remove rounding of holds, in the workspace."""
    for _ in range(MAX_RESTORE_STEPS):
        if largest_hold_error(plan, travel) <= HOLD_TOLERANCE / 10:
            break
        commands = [_newton_step(plan, series, travel) for series in plan.series]
        plan = move_to_commands(plan, commands)
    return plan


def _newton_step(plan: ReadingPlan, series: Series, travel: float | None) -> Array:
    """Commands after the least step that restores each reading's hold to first order."""
    error = _hold_errors(plan, series, travel)
    command = series.command
    if error is None:
        return command
    box = plan.measurement.machine.workspace(plan.setup(series).tool)
    lower, upper = [c.lower for c in box], [c.upper for c in box]
    rows = series.index[:, 0]
    first = np.unique(rows, return_index=True)[1]
    slope = _command_slopes(plan, series)
    at_lower = command[rows] <= np.array(lower) + EDGE_TOLERANCE
    at_upper = command[rows] >= np.array(upper) - EDGE_TOLERANCE
    slope[at_lower | at_upper] = 0.0
    square = np.maximum(np.sum(slope**2, axis=1, keepdims=True), 1e-12)
    moved = command.copy()
    moved[rows[first]] -= (error[:, None] * slope / square)[first]
    return np.clip(moved, lower, upper)


def _command_slopes(plan: ReadingPlan, series: Series) -> Array:
    """Slopes (n, n_dof) of the readings along their commands, by differences."""
    single = ReadingPlan(plan.measurement, (series,))
    rows, command = series.index[:, 0], series.command
    slope = np.zeros((len(series), command.shape[1]))
    for j in range(command.shape[1]):
        ends = []
        for step in (DIFFERENCE_STEP, -DIFFERENCE_STEP):
            moved = command.copy()
            moved[rows, j] += step
            moved_series = move_to_commands(single, [moved]).series[0]
            ends.append(_first_channel(plan.measurement, moved_series))
        slope[:, j] = (ends[0] - ends[1]) / (2 * DIFFERENCE_STEP)
    return slope


# -- checks ----------------------------------------------------------------------------
def find_fault(
    plan: ReadingPlan,
    variables: Ranges,
    travel: float | None,
    clearance: float | None,
    hold: bool = True,
) -> str | None:
    """The first fault in words, as of a determinant below `clearance`; None without."""
    for name, ranges in variables.items():
        current = settings_and_tool(plan.measurement.setups[name])
        for variable, (lower, upper) in ranges.items():
            if not lower <= current[variable] <= upper:
                return f"{variable} of set-up {name} leaves its range"
    for series in plan.series:
        fault = _range_fault(plan, series)
        if fault is None and clearance is not None:
            fault = _singularity_fault(plan, series, clearance)
        if fault is not None:
            return fault
    if hold and (error := largest_hold_error(plan, travel)) > HOLD_TOLERANCE:
        return f"a held reading is off by {error:.2g} m"
    return None


def _range_fault(plan: ReadingPlan, series: Series) -> str | None:
    """A coordinate or a joint that leaves its range."""
    machine = plan.measurement.machine
    command = series.command
    if plan.has_teach_pose(series):
        command = command[:-1]
    for _, name, *_ in machine.out_of_range(command, plan.setup(series).tool):
        return f"{name} leaves the workspace"
    for k, joint in enumerate(machine.joints):
        least, largest = series.q[:, k].min(), series.q[:, k].max()
        below = least < joint.lower - JOINT_TOLERANCE
        if below or largest > joint.upper + JOINT_TOLERANCE:
            return f"{joint.name} leaves its range"
    return None


def _singularity_fault(
    plan: ReadingPlan, series: Series, clearance: float
) -> str | None:
    """Poses too near to a singular one."""
    determinant = symbolic_pose(plan.measurement.kinematics).determinant
    values = determinant.map(len(series.q))(series.start.T, series.q.T)
    determinants = np.asarray(values, dtype=float).ravel()
    if not determinants.size:
        return None
    shares = determinants / home_determinant(plan.measurement)
    if shares.min() < clearance * (1 - 1e-6):
        return "a pose is nearer to a singular one than allowed"
    return None
