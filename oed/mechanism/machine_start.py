"""A machine where its solver starts: how far from assembled, and how it looks there."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import casadi as ca
import numpy as np

from oed.base.arrays import Array
from oed.model.expressions import MachineExpressions, machine_expressions
from oed.model.machine import Machine


@dataclasses.dataclass(frozen=True)
class MachineStart:
    """The guess for a command.

    equations  value of each closure equation, by `equation 1` ..., m or rad
    skeleton   polylines of points (n, 3), m; none where the machine draws none
    """

    equations: Mapping[str, float]
    skeleton: tuple[Array, ...]


def closure_at_guess(machine: Machine, command: Array) -> MachineStart:
    """The closure and the drawing at the guess for a command (n_dof,), SI.

    Nothing is solved, so that a machine that does not assemble can be looked at.
    """
    e = machine_expressions(machine)
    parts = machine.start(e.c_by_name, e.p_by_name)
    pose, joints = (ca.vertcat(*part) for part in parts)
    start = ca.Function("start", [e.c, e.p], [pose, joints])
    x, q = start(np.asarray(command, dtype=float), machine.nominal)
    values = ca.Function("closure", [e.x, e.q, e.p], [e.phi])(x, q, machine.nominal)
    rows = np.array(values).ravel()
    named = {f"equation {k}": float(v) for k, v in enumerate(rows, start=1)}
    return MachineStart(named, _skeleton(machine, e, x, q))


def _skeleton(
    machine: Machine, e: MachineExpressions, x: ca.DM, q: ca.DM
) -> tuple[Array, ...]:
    if machine.skeleton is None:
        return ()
    lines = machine.skeleton(e.x_by_name, e.q_by_name, e.p_by_name)
    points = [
        ca.Function("line", [e.x, e.q, e.p], [ca.horzcat(*line)])(x, q, machine.nominal)
        for line in lines
    ]
    return tuple(np.array(line).T for line in points)
