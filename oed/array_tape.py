"""A CasADi function as one array operation for each of its instructions.

CasADi interprets its instructions point by point. For hundreds of points, the same
instructions run faster one after the other, each as a NumPy operation over all points:
the interpreter's cost is then shared by the points, and the processor's vector units
work. Registers of a chunk of points stay in the processor's cache.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.arrays import Array

#: what writes its last argument from the others
Operation = Callable[..., Any]


def _twice(x: Array, out: Array) -> None:
    np.add(x, x, out=out)


def _if_else_zero(condition: Array, x: Array, out: Array) -> None:
    np.copyto(out, np.where(condition != 0.0, x, 0.0))


def _assign(x: Array, out: Array) -> None:
    np.copyto(out, x)


UNARY: dict[int, Operation] = {
    ca.OP_ASSIGN: _assign,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: _twice,
    ca.OP_INV: np.reciprocal,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_NOT: np.logical_not,
}
BINARY: dict[int, Operation] = {
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_HYPOT: np.hypot,
    ca.OP_COPYSIGN: np.copysign,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_FMOD: np.fmod,
    ca.OP_LT: np.less,
    ca.OP_LE: np.less_equal,
    ca.OP_EQ: np.equal,
    ca.OP_NE: np.not_equal,
    ca.OP_AND: np.logical_and,
    ca.OP_OR: np.logical_or,
    ca.OP_IF_ELSE_ZERO: _if_else_zero,
}
STORAGE = {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}


def is_supported(function: Any) -> bool:
    """Whether every instruction of an SX function has an array operation."""
    known = STORAGE | set(UNARY) | set(BINARY)
    count = function.n_instructions()
    return all(function.instruction_id(k) in known for k in range(count))


class ArrayTape:
    """A dense SX function at `size` points, on memory of its own."""

    def __init__(self, function: Any, size: int) -> None:
        inputs, outputs = range(function.n_in()), range(function.n_out())
        # ones: unused points of a short batch must stay clear of singular values
        self._inputs = [np.ones((function.numel_in(i), size)) for i in inputs]
        self._outputs = [np.zeros((function.numel_out(i), size)) for i in outputs]
        self._registers = np.empty((function.sz_w(), size))
        self._steps: list[tuple[Operation, tuple[Array, ...]]] = []
        values: dict[int, Array] = {}
        for k in range(function.n_instructions()):
            self._append(function, k, values)

    def _append(self, function: Any, k: int, values: dict[int, Array]) -> None:
        """Adds instruction k; `values` has what each register stands for so far.

        Constants and inputs are read where they are, and not copied into registers.
        """
        operation = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if operation == ca.OP_CONST:
            values[targets[0]] = np.array([function.instruction_constant(k)])
        elif operation == ca.OP_INPUT:
            values[targets[0]] = self._inputs[sources[0]][sources[1]]
        elif operation == ca.OP_OUTPUT:
            entry = self._outputs[targets[0]][targets[1]]
            self._steps.append((_assign, (values[sources[0]], entry)))
        else:
            run = UNARY.get(operation) or BINARY[operation]
            arity = 1 if operation in UNARY else 2
            arguments = [values[source] for source in sources[:arity]]
            result = self._registers[targets[0]]
            self._steps.append((run, (*arguments, result)))
            values[targets[0]] = result

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` points (n, entries); writes `outputs` in place."""
        for memory, values in zip(self._inputs, inputs, strict=True):
            memory[:, : len(values)] = values.T
        with np.errstate(all="ignore"):
            for operation, arguments in self._steps:
                operation(*arguments)
        for values, memory in zip(outputs, self._outputs, strict=True):
            values[:] = memory[:, : len(values)].T
