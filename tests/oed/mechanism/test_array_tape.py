"""Array operations of a CasADi function, against CasADi's interpreter and NumPy."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest
from shipped_models import a3_head, cables_planar, hexapod, linear_delta

from oed.mechanism.expressions import machine_expressions
from oed.mechanism.graph import Graph, read_graph
from oed.mechanism.tape import ArrayTape
from oed.model import Machine

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
SIZE = 7
EXPRESSIONS = {
    "arithmetic": X + Y * 3.0 - X / Y + (-X) ** 2 + 2 * X + 1 / Y,
    "powers": ca.sqrt(X) + X**Y + X**2.5 + ca.exp(X) + ca.log(Y),
    "angles": ca.sin(X) * ca.cos(Y) + ca.tan(X) + ca.atan2(X, Y) + ca.atan(Y),
    "inverse": ca.asin(X / 2) + ca.acos(Y / 2) + ca.sinh(X) + ca.cosh(Y) + ca.tanh(X),
    "choices": ca.if_else(X < Y, X, 5.0)
    + ca.if_else(ca.logic_and(X <= 1, Y != 1), Y, 0),
    "limits": ca.fmin(X, Y) + ca.fmax(X, 1.0) + ca.fabs(X - Y) + ca.sign(X - Y),
    "rounding": ca.floor(3 * X) + ca.ceil(3 * Y) + ca.fmod(3 * X, Y),
    "constant": ca.SX(4.0),
}


def _graph(function: ca.Function) -> Graph:
    graph = read_graph(function)
    assert graph is not None
    return graph


def _tape(function: ca.Function) -> ArrayTape:
    return ArrayTape(_graph(function), SIZE, range(function.n_in()))


def _evaluate(function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    shapes = [function.numel_out(i) for i in range(function.n_out())]
    outputs = [np.empty((len(inputs[0]), entries)) for entries in shapes]
    _tape(function).run(inputs, outputs)
    return outputs


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_equals_the_interpreter(name: str, rng: np.random.Generator) -> None:
    function = ca.Function("f", [X, Y], [EXPRESSIONS[name]])
    # fewer points than the tape's size
    x, y = rng.uniform(0.3, 1.9, (2, SIZE - 2, 1))
    want = [float(function(a, b)) for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    np.testing.assert_allclose(_evaluate(function, [x, y])[0].ravel(), want, rtol=1e-13)


def test_matrices_column_by_column_and_a_second_run(rng: np.random.Generator) -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 3)
    function = ca.Function("f", [a, b], [a @ b.T, ca.sum1(b)])
    tape = _tape(function)
    for _ in range(2):
        u, v = rng.standard_normal((SIZE, 2)), rng.standard_normal((SIZE, 3))
        product, total = np.empty((SIZE, 6)), np.empty((SIZE, 1))
        tape.run([u, v], [product, total])
        wanted = np.einsum("ni,nj->nji", u, v).reshape(SIZE, 6)
        np.testing.assert_allclose(product, wanted, rtol=1e-14)
        np.testing.assert_allclose(total[:, 0], v.sum(axis=1), rtol=1e-13)


def test_not_a_number_stays_at_its_point() -> None:
    function = ca.Function("f", [X, Y], [ca.sqrt(X) / Y])
    x = np.array([[4.0], [-1.0], [9.0]])
    y = np.array([[2.0], [1.0], [0.0]])
    values = _evaluate(function, [x, y])[0].ravel()
    assert values[0] == 1.0
    assert np.isnan(values[1])
    assert np.isinf(values[2])


@pytest.mark.parametrize("special", [ca.erf, ca.log1p])
def test_refuses_what_has_no_array_operation(special: Callable[..., ca.SX]) -> None:
    assert read_graph(ca.Function("f", [X], [special(X)])) is None


def _slopes(machine: Machine) -> ca.Function:
    e = machine_expressions(machine)
    outputs = [e.balance, ca.jacobian(e.balance, e.x), ca.jacobian(e.balance, e.p)]
    dense = [ca.densify(output) for output in outputs]
    return ca.Function("f", [e.x, e.q, e.p], dense, {"cse": True})


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
@pytest.mark.parametrize("varying", [[0], [2], [0, 1, 2]])
def test_slopes_of_a_machine_equal_the_interpreter(
    machine: Machine, varying: list[int], rng: np.random.Generator
) -> None:
    """Also where some inputs stay, and where the first output is computed alone."""
    function = _slopes(machine)
    tape = ArrayTape(_graph(function), SIZE, varying)
    sizes = [function.numel_in(i) for i in range(function.n_in())]
    inputs = [rng.uniform(0.3, 0.9, (SIZE, size)) for size in sizes]
    tape.load(inputs)
    for evaluate, count in ((tape.evaluate, 3), (tape.evaluate_first, 1)):
        for i in varying:
            inputs[i] = rng.uniform(0.3, 0.9, inputs[i].shape)
            tape.inputs[i][:] = inputs[i].T
        evaluate()
        expected = _by_interpreter(function, inputs)
        for output, values in zip(tape.outputs[:count], expected, strict=False):
            np.testing.assert_allclose(output, values, rtol=1e-12, atol=1e-14)


def test_outputs_that_are_inputs_constants_or_equal() -> None:
    """They have no operation of their own, and those that stay are there at once."""
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 2)
    root = ca.sqrt(b[0])
    outputs = [ca.vertcat(a[0], 3.0, b[1], root, root), ca.vertcat(root, a[1])]
    tape = ArrayTape(_graph(ca.Function("f", [a, b], outputs)), SIZE, [1])
    tape.load([np.tile([5.0, 6.0], (SIZE, 1)), np.tile([4.0, 7.0], (SIZE, 1))])
    assert tape.outputs[0][:2, 0].tolist() == [5.0, 3.0]
    tape.evaluate_first()
    assert tape.outputs[0][:, -1].tolist() == [5.0, 3.0, 7.0, 2.0, 2.0]
    tape.evaluate()
    assert tape.outputs[1][:, 0].tolist() == [2.0, 6.0]


def test_the_graph_tells_what_an_input_changes_and_a_value_needs() -> None:
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    graph = _graph(ca.Function("f", [a, b], [ca.sin(a) * b, ca.sqrt(b)]))
    varying = graph.varying([0])
    (product,), (root,) = graph.outputs
    assert product in varying
    assert root not in varying
    needed = graph.needed([root])
    assert {graph.nodes[n].entry for n in needed} == {None, (1, 0)}
    (sine,) = set(graph.nodes[product].sources) & varying
    assert graph.needed([product], [sine]) < graph.needed([product])
