"""Packs and memory of array operations, against CasADi's interpreter."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from shipped_models import a3_head, cables_planar, hexapod, linear_delta

from oed.mechanism.array_code.layout import Arena, Layout
from oed.mechanism.array_code.tape import ArrayTape
from oed.model import Machine, machine_expressions

SIZE = 16


def _function(machine: Machine) -> ca.Function:
    e = machine_expressions(machine)
    outputs = [e.balance, ca.jacobian(e.balance, e.x), ca.jacobian(e.balance, e.p)]
    dense = [ca.densify(output) for output in outputs]
    return ca.Function("f", [e.x, e.q, e.p], dense, {"cse": True})


def _inputs(function: ca.Function, rng: np.random.Generator) -> list[np.ndarray]:
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    return [rng.uniform(0.3, 0.9, (SIZE, size)) for size in sizes]


def _by_interpreter(
    function: ca.Function, inputs: list[np.ndarray]
) -> list[np.ndarray]:
    points = [function(*at) for at in zip(*inputs, strict=True)]
    columns = zip(*points, strict=True)
    return [
        np.array([np.asarray(value).ravel(order="F") for value in column]).T
        for column in columns
    ]


@pytest.mark.parametrize(
    "machine",
    [a3_head.machine, hexapod.machine, cables_planar.machine, linear_delta.machine],
    ids=lambda m: m.name,
)
@pytest.mark.parametrize("varying", [1, 3])
def test_equals_the_interpreter(
    machine: Machine, varying: int, rng: np.random.Generator
) -> None:
    function = _function(machine)
    tape = ArrayTape(Layout(function, varying), SIZE)
    for _ in range(2):
        inputs = _inputs(function, rng)
        tape.load(inputs)
        tape.evaluate()
        wanted = _by_interpreter(function, inputs)
        for output, values in zip(tape.outputs, wanted, strict=True):
            np.testing.assert_allclose(output, values, rtol=1e-12, atol=1e-14)


def test_outputs_one_after_the_other_are_those_together(
    rng: np.random.Generator,
) -> None:
    function = _function(hexapod.machine)
    tape, inputs = ArrayTape(Layout(function), SIZE), _inputs(function, rng)
    tape.load(inputs)
    tape.evaluate()
    together = [output.copy() for output in tape.outputs]
    for output in tape.outputs:
        output[:] = np.nan
    tape.prepare()  # entries that are constants
    tape.evaluate(tape.calls_for([0, 1]))
    assert np.isnan(tape.outputs[2]).any()
    tape.evaluate(tape.calls_after([0, 1]))
    for output, values in zip(tape.outputs, together, strict=True):
        np.testing.assert_array_equal(output, values)


def test_single_precision_leaves_the_other_outputs_exact(
    rng: np.random.Generator,
) -> None:
    function = _function(a3_head.machine)
    inputs = _inputs(function, rng)
    tapes = [ArrayTape(Layout(function, 1, single), SIZE) for single in ((), (1,))]
    for tape in tapes:
        tape.load(inputs)
        tape.evaluate()
    double, single = tapes
    np.testing.assert_array_equal(single.outputs[0], double.outputs[0])
    np.testing.assert_array_equal(single.outputs[2], double.outputs[2])
    assert single.outputs[1].dtype == np.float32
    np.testing.assert_allclose(single.outputs[1], double.outputs[1], atol=1e-5)


def test_alike_values_share_a_call() -> None:
    """Six legs: one operation for all six, but for those on a shared value."""
    a, b = ca.SX.sym("a", 6), ca.SX.sym("b", 6)
    function = ca.Function("f", [a, b], [ca.sqrt(a**2 + ca.sin(b) * 2.0)])
    tape = ArrayTape(Layout(function), SIZE)
    # square, sine by a tangent (6), double, sum, root
    assert len(tape.calls_for([0])) == 10


def test_memory_is_taken_again() -> None:
    arena = Arena()
    first, second, third = (arena.take(size) for size in (4, 2, 3))
    assert (first, second, third) == (0, 4, 6)
    arena.leave(first, 4)
    arena.leave(second, 2)
    assert arena.take(6) == 0
    arena.leave(third, 3)
    assert arena.take(5) == 6
    assert arena.size == 11
