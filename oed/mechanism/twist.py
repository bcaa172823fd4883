"""Slopes of a machine's equations over small motions of its platform.

Equations mostly depend on the pose through the platform's point and rotation alone. A
small turn about axis k adds [e_k x] R to the rotation R: its rows are rows of R. The
slope of a joint's place R a is then a component of R a itself, where derivatives over
angles would differentiate R's formula, entry by entry.
"""

from __future__ import annotations

import itertools
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.mechanism.expressions import MachineExpressions, twist_slope
from oed.model import Expr, Machine

#: least determinant of the changes of three entries by turns, over the largest
MIN_VOLUME_SHARE = 0.5


class TwistSlopes(NamedTuple):
    """Slopes of k equations over the platform's twist.

    slope   (k, 6): column c over the coordinate c where it moves the platform's point,
            over a turn in the places of `angles`
    change  (3, 3) change of the angles for turns about the axes
    angles  coordinates that turn the platform
    """

    slope: Expr
    change: Expr
    angles: tuple[int, int, int]


def twist_slopes(
    machine: Machine, equations: Expr, e: MachineExpressions
) -> TwistSlopes | None:
    """Slopes over the twist, for a pose of the platform's point and three angles.

    None for other poses, and where the equations take the angles by another way than
    the rotation.
    """
    point = ca.substitute(e.tip, e.tool, ca.DM.zeros(3))
    moved = twist_slope(e.rotation, point, e.x)
    split = _split_coordinates(moved, point, e.x)
    if split is None:
        return None
    lengths, angles = split
    rotation = ca.SX.sym("rotation", 3, 3)
    at_rotation = _at_rotation(equations, e, rotation)
    if at_rotation is None or ca.depends_on(at_rotation, e.x[list(angles)]):
        return None
    columns = {c: ca.jacobian(at_rotation, e.x[c]) for c in lengths}
    columns |= dict(zip(angles, _turned(at_rotation, rotation), strict=True))
    slope = ca.horzcat(*(columns[c] for c in range(6)))
    slope = ca.substitute(slope, ca.vec(rotation), ca.vec(e.rotation))
    return TwistSlopes(slope, _change_of_angles(machine, e, angles), angles)


def _change_of_angles(
    machine: Machine, e: MachineExpressions, angles: tuple[int, int, int]
) -> Expr:
    """Change (3, 3) of the angles for turns about the three axes.

    Three entries of the rotation determine the angles: what a turn changes in them is
    what the angles change.
    """
    axes = ca.SX.eye(3)
    entries_of = list(itertools.product(range(3), range(3)))
    turns = [ca.cross(e.rotation[:, j], axes[:, i]).T for i, j in entries_of]
    slopes = [ca.jacobian(e.rotation[i, j], e.x[list(angles)]) for i, j in entries_of]
    best = _cheapest_entries(machine, e, turns, slopes)
    first, second, third = (slopes[k] for k in best)
    crossed = [
        ca.cross(second, third).T,
        ca.cross(third, first).T,
        ca.cross(first, second).T,
    ]
    inverse = ca.horzcat(*crossed) / ca.dot(first, crossed[0].T)
    return inverse @ ca.vertcat(*(turns[k] for k in best))


def _cheapest_entries(
    machine: Machine, e: MachineExpressions, turns: list[Expr], slopes: list[Expr]
) -> tuple[int, ...]:
    """Three of the rotation's nine entries, with few instructions for their slopes.

    At home, the changes of these entries determine a turn well.
    """
    start = [ca.vertcat(*part) for part in machine.start(e.c_by_name, e.p_by_name)]
    at_home = ca.Function("home", [e.c, e.p], start[:1])
    home = at_home(machine.home_command, machine.nominal)
    changes = np.array(ca.Function("turns", [e.x], [ca.vertcat(*turns)])(home))
    cost = [_instructions(slope, e.x) for slope in slopes]
    triples = list(itertools.combinations(range(9), 3))
    volumes = [abs(np.linalg.det(changes[list(triple)])) for triple in triples]
    least = MIN_VOLUME_SHARE * np.nanmax([0.0, *volumes])
    pairs = zip(triples, volumes, strict=True)
    regular = [triple for triple, volume in pairs if not volume < least]
    return min(regular, key=lambda triple: sum(cost[k] for k in triple))


def _instructions(expression: Expr, x: Expr) -> int:
    """Number of instructions of an expression."""
    function = ca.Function("f", [x], [ca.densify(expression)])
    return int(function.n_instructions())


def _split_coordinates(
    moved: Expr, point: Expr, x: Expr
) -> tuple[tuple[int, ...], tuple[int, int, int]] | None:
    """Coordinates that are the platform's point, and those that turn it."""
    angles = tuple(c for c in range(x.numel()) if moved[3:, c].nnz())
    lengths = tuple(c for c in range(x.numel()) if c not in angles)
    if len(lengths) != 3 or len(angles) != 3:
        return None
    if not all(ca.is_equal(point[i], x[c]) for i, c in enumerate(lengths)):
        return None
    return lengths, angles


def _at_rotation(equations: Expr, e: MachineExpressions, rotation: Expr) -> Expr | None:
    """The equations with their own rotation replaced by symbols; None without one."""
    outputs = [ca.densify(ca.vec(e.rotation)), ca.densify(equations)]
    inputs = [e.x, e.q, e.p]
    function = ca.Function("f", inputs, outputs, {"cse": True})
    entries_of = _writers(function)
    if len({k for k, _ in entries_of}) < 9:
        return None
    entries: list[Any] = ca.vertsplit(ca.vec(rotation))
    symbols = {k: sign * r for (k, sign), r in zip(entries_of, entries, strict=True)}
    values: dict[int, Any] = {}
    rows: list[Any] = [None] * equations.numel()
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            if targets[0] == 1:
                rows[targets[1]] = values[sources[0]]
            continue
        if code == ca.OP_CONST:
            value = ca.SX(function.instruction_constant(k))
        elif code == ca.OP_INPUT:
            value = inputs[sources[0]][sources[1]]
        elif len(sources) == 1:
            value = ca.SX.unary(code, values[sources[0]])
        else:
            value = ca.SX.binary(code, values[sources[0]], values[sources[1]])
        values[targets[0]] = symbols.get(k, value)
    return ca.vertcat(*rows)


def _writers(function: Any) -> list[tuple[int, float]]:
    """Instructions that compute the first output's entries, up to a sign.

    Of the negative of a value, CasADi uses the value. Entries that are constants or
    inputs are left out.
    """
    writer: dict[int, tuple[int, float] | None] = {}
    entries_of = {}
    for k in range(function.n_instructions()):
        code = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if code == ca.OP_OUTPUT:
            writer_of = writer[sources[0]]
            if targets[0] == 0 and writer_of is not None:
                entries_of[targets[1]] = writer_of
        elif code in {ca.OP_CONST, ca.OP_INPUT}:
            writer[targets[0]] = None
        else:
            negative = writer[sources[0]] if code == ca.OP_NEG else None
            writer[targets[0]] = (
                (k, 1.0) if negative is None else (negative[0], -negative[1])
            )
    return [entries_of[i] for i in sorted(entries_of)]


def _turned(equations: Expr, rotation: Expr) -> list[Expr]:
    """Slopes (k, 1) over turns about the three axes."""

    def moved(row: int, by: int) -> Expr:
        """Change of the equations where a row of the rotation moves by another."""
        rows = [rotation[by, :] if i == row else ca.SX(1, 3) for i in range(3)]
        change = ca.vec(ca.vertcat(*rows))
        return ca.jtimes(equations, ca.vec(rotation), change)

    pairs = ((2, 1), (0, 2), (1, 0))
    return [moved(row, by) - moved(by, row) for row, by in pairs]
