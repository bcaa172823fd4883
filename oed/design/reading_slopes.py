"""Identification rows of one reading as a CasADi expression, with the set-up's settings
and tool as symbols.

A reading y = g(x_1, x_2, q_1, q_2, p, s; k, tool) sees one pose or two, each with
phi(x, q, p) = 0. With lambda_j from settled_x^T lambda_j = g_xj^T (`oed.kinematics` on
what a redundant machine settles to) its row is

    dy/d(p, s) = [ g_p - sum_j lambda_j^T settled_p,  g_s ],

at nominal parameters. Whitening follows `oed.measurement`: sigma of each channel, or
the instrument's own sources.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import casadi as ca
import numpy as np

from oed.information import Scaling, column_scale
from oed.instrument import Frame, Setup
from oed.kinematics import misfit, symbols
from oed.machine import Machine
from oed.measurement import Measurement

TOOL = ("tool_x", "tool_y", "tool_z")


@dataclasses.dataclass(frozen=True)
class SymbolicPose:
    """CasADi functions of one pose.

    closed  (x, q, c, tool) -> closure and what the controller holds, all to be zero
    clear   (x, q) -> det phi_x, lengths in units of the lever; (0,) for a redundant
            machine
    """

    closed: Any
    clear: Any


@dataclasses.dataclass(frozen=True)
class SymbolicReading:
    """CasADi functions of one reading of a set-up; settings (nk,) in the instrument's
    order, tool (3,).

    rows   (x_1, q_1, [x_2, q_2,] settings, tool) -> H^T (n, k): scaled rows, transposed
    value  the same -> channels (k,)
    """

    rows: Any
    value: Any


def pose(machine: Machine) -> SymbolicPose:
    """Equations of one pose at nominal parameters."""
    x, xs = symbols("x", machine.pose)
    q, qs = symbols("q", machine.joints)
    c, cs = symbols("c", machine.command)
    p, ps = symbols("p", machine.parameters)
    tool = ca.SX.sym("tool", 3)
    phi = ca.vertcat(*machine.closure(xs, qs, ps))
    rotation, point = machine.platform(xs)
    held = machine.commanded(xs, point + rotation @ tool)
    wish = ca.vertcat(*[a - b for a, b in zip(held, machine.target(cs), strict=True)])
    both, phi_x = _at(machine, p, ca.vertcat(phi, wish), ca.jacobian(phi, x))
    lever = ca.DM([1.0 if i.unit == "rad" else machine.lever for i in machine.pose])
    square = phi_x.shape[0] == phi_x.shape[1]
    clear = ca.det(phi_x @ ca.diag(lever)) if square else ca.SX(0, 1)
    options = {"cse": True}
    return SymbolicPose(
        ca.Function("closed", [x, q, c, tool], [both], options),
        ca.Function("clear", [x, q], [clear], options),
    )


def reading(
    measurement: Measurement, setup: Setup, scaling: Scaling, basis: Any
) -> SymbolicReading:
    """Rows of one reading times `basis` (n, r), n entries of theta. Raises ValueError
    for noise shared by a run.
    """
    machine, instrument = measurement.machine, setup.instrument
    if scaling == "tolerance" and any(c.shared for c in instrument.channels):
        raise ValueError(
            f"set-up {setup.name}: readings told against a run's reference share its"
            " noise: polish others"
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
        rotation, point = machine.platform(xs)
        frames.append(Frame(rotation, point + rotation @ tool, misfit(phi, x)))
        poses.append((x, q, phi))
    y = ca.vertcat(*instrument.observe(frames, ss, known))
    by_machine = ca.jacobian(y, p)
    for x, _, phi in poses:
        by_machine += _through(y, x, phi, p)
    rows: Any = _placed(measurement, setup, by_machine, ca.jacobian(y, s))
    rows = rows @ ca.diag(ca.DM(column_scale(measurement, scaling)))
    if scaling == "tolerance":
        rows = _whitened(
            rows, setup, instrument.sources and instrument.sources(frames, ss, known)
        )
    elif scaling == "length":
        rows = (
            ca.diag(
                ca.DM(
                    [
                        1.0 if c.unit == "m" else machine.lever
                        for c in instrument.channels
                    ]
                )
            )
            @ rows
        )
    unknown = ca.DM([n.nominal for n in setup.nuisances])
    at_nominal: Any = [ca.substitute(e, s, unknown) for e in _at(machine, p, rows, y)]
    rows, y = at_nominal
    inputs = [v for x, q, _ in poses for v in (x, q)] + [settings, tool]
    options = {"cse": True}
    return SymbolicReading(
        ca.Function("rows", inputs, [(rows @ ca.DM(np.asarray(basis))).T], options),
        ca.Function("value", inputs, [y], options),
    )


def _through(y: Any, x: Any, phi: Any, p: Any) -> Any:
    """Slope of y over p by way of the pose x."""
    settled = phi if phi.numel() == x.numel() else ca.jacobian(phi, x).T @ phi
    adjoint = ca.solve(ca.jacobian(settled, x).T, ca.jacobian(y, x).T)
    return -adjoint.T @ ca.jacobian(settled, p)


def _at(machine: Machine, p: Any, *expressions: Any) -> list[Any]:
    nominal = ca.DM(machine.nominal)
    return [ca.substitute(e, p, nominal) for e in expressions]


def _placed(
    measurement: Measurement, setup: Setup, by_machine: Any, by_setup: Any
) -> Any:
    """Rows over all of theta: other set-ups' unknowns do not enter."""
    parts = [by_machine]
    for name, other in measurement.setups.items():
        parts.append(
            by_setup
            if name == setup.name
            else ca.SX(by_machine.shape[0], len(other.nuisances))
        )
    return ca.densify(ca.horzcat(*parts))


def _whitened(rows: Any, setup: Setup, sources: Any | None) -> Any:
    """Rows over the channels' noise, or over the root of the covariance of the
    instrument's own sources.
    """
    if sources is None:
        return ca.diag(1.0 / ca.DM(setup.sigma)) @ rows
    factor = [
        s / c.sigma for s, c in zip(setup.sigma, setup.instrument.channels, strict=True)
    ]
    root = ca.diag(ca.DM(factor)) @ sources
    return ca.solve(ca.chol(root @ root.T).T, rows)
