"""Array operations that stand for the instructions of a CasADi function."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import DTypeLike

from oed.base.arrays import Array

#: what writes its last argument from the others
Operation = Callable[..., Any]
#: an operation, and its arguments with the result last
Call = tuple[Operation, tuple[Any, ...]]
#: bytes of a line of the processor's cache, or a multiple
CACHE_LINE = 64


def memory(
    shape: tuple[int, ...], fill: float = 0.0, kind: DTypeLike = np.float64
) -> Any:
    """An array that starts with a line of the processor's cache.

    Its vector units then read and write whole lines, a fifth faster.
    """
    count = math.prod(shape)
    spare = CACHE_LINE // np.dtype(kind).itemsize
    numbers = np.full(count + spare, fill, dtype=kind)
    first = -(numbers.ctypes.data // numbers.itemsize) % spare
    return numbers[first : first + count].reshape(shape)


def assign(x: Array, out: Array) -> None:
    """Copy x into out, in the precision of out."""
    np.copyto(out, x, casting="same_kind")


def fill_bits(condition: Array, out: Any) -> None:
    """All bits of `out` (integers) where the condition holds, none elsewhere."""
    np.negative(condition != 0.0, out=out, dtype=out.dtype)


def copy_bits(x: Any, out: Any) -> None:
    """Copy bits (integers) that are all set or none, in the size of out."""
    np.copyto(out, x, casting="same_kind")


#: x where the bits of a condition are set, 0 elsewhere, also for infinite x and NaN
keep_bits: Operation = np.bitwise_and
#: operations whose arguments are integers, but for the condition of `fill_bits`
BITWISE = {fill_bits, keep_bits, copy_bits}
COMMUTATIVE = {np.add, np.multiply, np.fmin, np.fmax, np.hypot}

UNARY: dict[int, Operation] = {
    ca.OP_ASSIGN: assign,
    ca.OP_NEG: np.negative,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SQRT: np.sqrt,
    ca.OP_SQ: np.square,
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
}
#: instructions that `oed.mechanism.array_code.graph` expresses by others, or as memory
SPECIAL = {ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_TWICE, ca.OP_IF_ELSE_ZERO}


def make(calls: Sequence[Call]) -> None:
    """Make the calls; values without a result, as of sqrt(-1), become NaN."""
    with np.errstate(all="ignore"):
        for operation, arguments in calls:
            operation(*arguments)


def is_supported(function: Any) -> bool:
    """Whether every instruction of an SX function has an array operation."""
    known = SPECIAL | set(UNARY) | set(BINARY)
    count = function.n_instructions()
    return all(function.instruction_id(k) in known for k in range(count))
