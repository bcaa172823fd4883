"""Identification rows of one reading as a CasADi expression, for polishing.

The settings and the tool of the set-up are symbols. A reading
y = g(x_1, x_2, q_1, q_2, p, s; k, tool) sees one pose or two, each with
phi(x, q, p) = 0. With lambda_j from settled_x^T lambda_j = g_xj^T (`oed.mechanism.kinematics`
defines what a redundant machine settles to) its row is

    dy/d(p, s) = [ g_p - sum_j lambda_j^T settled_p,  g_s ],

at nominal parameters. Whitening follows `oed.measurement.measurement`: by sigma of each channel, or
by the instrument's own error sources.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from oed.identifiability import Scaling, column_scale
from oed.measurement import Measurement
from oed.model.expressions import machine_frame, symbols
from oed.model.instrument import Frame, Setup
from oed.model.machine import Machine

TOOL = ("tool_x", "tool_y", "tool_z")
#: options of every CasADi function: common subexpressions are evaluated once
OPTIONS = {"cse": True}


@dataclasses.dataclass(frozen=True)
class SymbolicPose:
    """CasADi functions of one pose.

    residual     (x, q, c, tool) -> closure and controller equations, all to be zero
    determinant  (x, q) -> det phi_x, lengths in units of the lever; (0,) for a
                 redundant machine
    """

    residual: Any
    determinant: Any


@dataclasses.dataclass(frozen=True)
class SymbolicReading:
    """CasADi functions of one reading of a set-up.

    The arguments of both are (x_1, q_1, [x_2, q_2,] settings, tool), with settings (nk,)
    in the instrument's order and tool (3,).

    rows   -> H^T (n, k): scaled rows, transposed
    value  -> channels (k,)
    """

    rows: Any
    value: Any


def symbolic_pose(machine: Machine) -> SymbolicPose:
    """Equations of one pose at nominal parameters."""
    x, xs = symbols("x", machine.pose)
    q, qs = symbols("q", machine.joints)
    c, cs = symbols("c", machine.command)
    p, ps = symbols("p", machine.parameters)
    tool = ca.SX.sym("tool", 3)
    phi = ca.vertcat(*machine.closure(xs, qs, ps))
    rotation, point = machine.platform(xs)
    reached = machine.commanded(xs, point + rotation @ tool)
    target = machine.target(cs)
    errors = [a - b for a, b in zip(reached, target, strict=True)]
    equations = ca.vertcat(phi, ca.vertcat(*errors))
    residual, phi_x = _at_nominal(machine, p, equations, ca.jacobian(phi, x))
    levers = [1.0 if item.unit == "rad" else machine.lever for item in machine.pose]
    determinant: Any = ca.SX(0, 1)
    if phi_x.shape[0] == phi_x.shape[1]:
        determinant = ca.det(phi_x @ ca.diag(ca.DM(levers)))
    return SymbolicPose(
        ca.Function("residual", [x, q, c, tool], [residual], OPTIONS),
        ca.Function("determinant", [x, q], [determinant], OPTIONS),
    )


def symbolic_reading(
    measurement: Measurement, setup: Setup, scaling: Scaling, basis: Any
) -> SymbolicReading:
    """One reading with its rows times `basis` (n, r), for n entries of theta.

    Raises ValueError for noise that a run shares.
    """
    machine, instrument = measurement.machine, setup.instrument
    shares = any(c.shared for c in instrument.channels) or setup.statement.seating
    if scaling == "tolerance" and shares:
        raise ValueError(
            f"set-up {setup.name}: the readings of a run share an error (that of a"
            " reference, of a bar put up anew or of a seat): polish others"
        )
    p, ps = symbols("p", machine.parameters)
    s, ss = symbols("s", setup.nuisances)
    settings = ca.SX.sym("k", len(instrument.settings))
    known = {item.name: settings[i] for i, item in enumerate(instrument.settings)}
    tool = ca.SX.sym("tool", 3)
    poses: list[tuple[Any, Any, Any]] = []
    frames: list[Frame] = []
    for j in range(instrument.arity):
        x, xs = symbols(f"x{j}", machine.pose)
        q, qs = symbols(f"q{j}", machine.joints)
        phi = ca.vertcat(*machine.closure(xs, qs, ps))
        frames.append(machine_frame(machine, x, (xs, qs, ps), tool))
        poses.append((x, q, phi))
    y = ca.vertcat(*instrument.observe(frames, ss, known))
    by_machine = ca.jacobian(y, p)
    for x, _, phi in poses:
        by_machine += _through_pose(y, x, phi, p)
    rows: Any = _all_columns(measurement, setup, by_machine, ca.jacobian(y, s))
    rows = rows @ ca.diag(ca.DM(column_scale(measurement, scaling)))
    if scaling == "tolerance":
        sources = instrument.sources and instrument.sources(frames, ss, known)
        rows = _whiten(rows, setup, sources)
    elif scaling == "length":
        rows = ca.diag(ca.DM(_channel_lengths(machine, setup))) @ rows
    nuisances = ca.DM([n.nominal for n in setup.nuisances])
    at_nominal: Any = [
        ca.substitute(e, s, nuisances) for e in _at_nominal(machine, p, rows, y)
    ]
    rows, y = at_nominal
    pose_symbols = [symbol for x, q, _ in poses for symbol in (x, q)]
    inputs = [*pose_symbols, settings, tool]
    projected = (rows @ ca.DM(np.asarray(basis))).T
    return SymbolicReading(
        ca.Function("rows", inputs, [projected], OPTIONS),
        ca.Function("value", inputs, [y], OPTIONS),
    )


def _through_pose(y: Any, x: Any, phi: Any, p: Any) -> Any:
    """Slope of y over p by way of the pose x."""
    settled = phi if phi.numel() == x.numel() else ca.jacobian(phi, x).T @ phi
    adjoint = ca.solve(ca.jacobian(settled, x).T, ca.jacobian(y, x).T)
    return -adjoint.T @ ca.jacobian(settled, p)


def _at_nominal(machine: Machine, p: Any, *expressions: Any) -> list[Any]:
    nominal = ca.DM(machine.nominal)
    return [ca.substitute(e, p, nominal) for e in expressions]


def _all_columns(
    measurement: Measurement, setup: Setup, by_machine: Any, by_setup: Any
) -> Any:
    """Rows over all of theta: the unknowns of other set-ups do not enter."""
    parts = [by_machine]
    for name, other in measurement.setups.items():
        if name == setup.name:
            parts.append(by_setup)
        else:
            parts.append(ca.SX(by_machine.shape[0], len(other.nuisances)))
    return ca.densify(ca.horzcat(*parts))


def _channel_lengths(machine: Machine, setup: Setup) -> list[float]:
    """Factors that turn the channels into lengths."""
    channels = setup.instrument.channels
    return [1.0 if c.unit == "m" else machine.lever for c in channels]


def _whiten(rows: Any, setup: Setup, sources: Any | None) -> Any:
    """Rows over the channels' noise, or over the root of the sources' covariance."""
    if sources is None:
        return ca.diag(1.0 / ca.DM(setup.sigma)) @ rows
    channels = zip(setup.sigma, setup.instrument.channels, strict=True)
    factors = [sigma / channel.sigma for sigma, channel in channels]
    root = ca.diag(ca.DM(factors)) @ sources
    return ca.solve(ca.chol(root @ root.T).T, rows)
