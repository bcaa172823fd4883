"""A CasADi function as one array operation for each of its instructions.

CasADi interprets its instructions point by point. For hundreds of points, the same
instructions run faster one after the other, each as a NumPy operation over all points:
the interpreter's cost is then shared by the points, and the processor's vector units
work. Registers of a chunk of points stay in the processor's cache.

Where some inputs stay the same from one evaluation to the next, as joints and
parameters do in Newton's method, what depends on them alone is evaluated once.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import casadi as ca
import numpy as np

from oed.array_operations import (
    BINARY,
    UNARY,
    Call,
    Operation,
    assign,
    fill_bits,
    make,
    memory,
)
from oed.arrays import Array

#: number of a value that no instruction computes: a constant, an input
GIVEN = -1


class _Value(NamedTuple):
    """What a register holds: where, by which instruction, and whether it changes."""

    array: Array
    instruction: int
    varies: bool


TWO = _Value(np.array(2.0), GIVEN, varies=False)


class _Step(NamedTuple):
    """The call of an instruction, and the instructions that it takes values from."""

    call: Call
    instruction: int
    sources: tuple[int, ...]


class ArrayTape:
    """A dense SX function at `size` points, on memory of its own.

    varying  number of leading inputs that change between evaluations; all by default

    Attributes:

    inputs   for each input, the memory (entries, size)
    outputs  for each output, the memory (entries, size), column by column of a matrix
    """

    def __init__(self, function: Any, size: int, varying: int | None = None) -> None:
        entries = [function.numel_in(i) for i in range(function.n_in())]
        outputs = range(function.n_out())
        # ones: unused points of a short batch must stay clear of singular values
        self.inputs = [memory((count, size), 1.0) for count in entries]
        self.outputs = [memory((function.numel_out(i), size)) for i in outputs]
        self._varying = len(entries) if varying is None else varying
        self._registers = memory((function.sz_w(), size))
        self._size, self._count = size, function.n_instructions()
        self._entries = _output_entries(function)
        self._copies: dict[int, int] = {}
        self._bits: dict[int, _Value] = {}
        self._fixed: list[Call] = []
        self._steps: list[_Step] = []
        values: dict[int, _Value] = {}
        for k in range(self._count):
            self._append(function, k, values)
        self._calls = [step.call for step in self._steps]

    def _append(self, function: Any, k: int, values: dict[int, _Value]) -> None:
        """Add instruction k; `values` has what each register stands for so far.

        Constants and inputs are read where they are, and not copied into registers.
        """
        operation = function.instruction_id(k)
        sources = function.instruction_input(k)
        targets = function.instruction_output(k)
        if operation == ca.OP_CONST:
            constant = np.array(function.instruction_constant(k))
            values[targets[0]] = _Value(constant, GIVEN, varies=False)
        elif operation == ca.OP_INPUT:
            entry = self.inputs[sources[0]][sources[1]]
            values[targets[0]] = _Value(entry, GIVEN, sources[0] < self._varying)
        elif operation == ca.OP_OUTPUT:
            source = values[sources[0]]
            if self._entries.get(source.instruction) != (targets[0], targets[1]):
                self._add(k, assign, [source], self.outputs[targets[0]][targets[1]])
                self._copies[k] = targets[0]
        elif operation == ca.OP_IF_ELSE_ZERO:
            condition, x = values[sources[0]], values[sources[1]]
            values[targets[0]] = self._if_else_zero(k, condition, x, targets[0])
        elif operation == ca.OP_TWICE:
            arguments = [TWO, values[sources[0]]]
            out = self._memory(k, arguments, targets[0])
            values[targets[0]] = self._add(k, np.multiply, arguments, out)
        else:
            arity = 1 if operation in UNARY else 2
            arguments = [values[source] for source in sources[:arity]]
            run = UNARY.get(operation) or BINARY[operation]
            out = self._memory(k, arguments, targets[0])
            values[targets[0]] = self._add(k, run, arguments, out)

    def _if_else_zero(
        self, k: int, condition: _Value, x: _Value, register: int
    ) -> _Value:
        """x where the condition holds, else 0: its bits, or none of them.

        Products with 0 would keep infinite values and NaN.
        """
        if condition.instruction not in self._bits or condition.instruction == GIVEN:
            mask = memory((self._size,)).view(np.int64)
            number = self._count + k
            bits = self._add(number, fill_bits, [condition], mask)
            self._bits[condition.instruction] = bits
        bits = self._bits[condition.instruction]
        out = self._memory(k, [bits, x], register)
        as_bits = x._replace(array=x.array.view(np.int64))
        value = self._add(k, np.bitwise_and, [bits, as_bits], out.view(np.int64))
        return value._replace(array=out)

    def _memory(self, k: int, sources: Sequence[_Value], register: int) -> Array:
        """Where instruction k writes its result."""
        if k in self._entries:
            output, entry = self._entries[k]
            row: Array = self.outputs[output][entry]
            return row
        if any(source.varies for source in sources):
            row = self._registers[register]
            return row
        return memory((self._size,))

    def _add(
        self, number: int, run: Operation, sources: Sequence[_Value], out: Any
    ) -> _Value:
        """Add a call to those of every evaluation, or to those made once."""
        varies = any(source.varies for source in sources)
        call = (run, (*(source.array for source in sources), out))
        if varies:
            needed = tuple(source.instruction for source in sources)
            self._steps.append(_Step(call, number, needed))
        else:
            self._fixed.append(call)
        return _Value(out, number, varies)

    def calls_for(self, output: int) -> list[Call]:
        """The calls that one output needs, for `evaluate`."""
        needed = {k for k, (i, _) in self._entries.items() if i == output}
        needed |= {k for k, i in self._copies.items() if i == output}
        calls = []
        for step in reversed(self._steps):
            if step.instruction in needed:
                needed.update(step.sources)
                calls.append(step.call)
        return calls[::-1]

    def prepare(self) -> None:
        """Evaluate what depends on the inputs that do not vary, after they change."""
        make(self._fixed)

    def evaluate(self, calls: Sequence[Call] | None = None) -> None:
        """Compute `outputs` from `inputs`; all, or what `calls` write."""
        make(self._calls if calls is None else calls)

    def run(self, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate up to `size` points (n, entries); writes `outputs` in place."""
        for entries, values in zip(self.inputs, inputs, strict=True):
            entries[:, : len(values)] = values.T
        self.prepare()
        self.evaluate()
        for values, entries in zip(outputs, self.outputs, strict=True):
            values[:] = entries[:, : len(values)].T


def _output_entries(function: Any) -> dict[int, tuple[int, int]]:
    """The output and its entry that an instruction may write at once, by instruction."""
    entries: dict[int, tuple[int, int]] = {}
    writer: dict[int, int] = {}
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        targets = function.instruction_output(k)
        if operation in {ca.OP_CONST, ca.OP_INPUT}:
            writer[targets[0]] = GIVEN
        elif operation == ca.OP_OUTPUT:
            instruction = writer[function.instruction_input(k)[0]]
            if instruction != GIVEN:
                entries.setdefault(instruction, (targets[0], targets[1]))
        else:
            writer[targets[0]] = k
    return entries
