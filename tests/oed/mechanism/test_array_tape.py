"""Array operations of a CasADi function, against CasADi's interpreter and NumPy."""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np
import pytest

from oed.mechanism.array_code.layout import Layout
from oed.mechanism.array_code.operations import is_supported
from oed.mechanism.array_code.tape import ArrayTape

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


def _evaluate(function: ca.Function, inputs: list[np.ndarray]) -> list[np.ndarray]:
    shapes = [function.numel_out(i) for i in range(function.n_out())]
    outputs = [np.empty((len(inputs[0]), entries)) for entries in shapes]
    ArrayTape(Layout(function), SIZE).run(inputs, outputs)
    return outputs


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_equals_the_interpreter(name: str, rng: np.random.Generator) -> None:
    function = ca.Function("f", [X, Y], [EXPRESSIONS[name]])
    assert is_supported(function)
    # fewer points than the tape's size
    x, y = rng.uniform(0.3, 1.9, (2, SIZE - 2, 1))
    want = [float(function(a, b)) for a, b in zip(x.ravel(), y.ravel(), strict=True)]
    np.testing.assert_allclose(_evaluate(function, [x, y])[0].ravel(), want, rtol=1e-13)


def test_matrices_column_by_column_and_a_second_run(rng: np.random.Generator) -> None:
    a, b = ca.SX.sym("a", 2), ca.SX.sym("b", 3)
    function = ca.Function("f", [a, b], [a @ b.T, ca.sum1(b)])
    tape = ArrayTape(Layout(function), SIZE)
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
    assert not is_supported(ca.Function("f", [X], [special(X)]))
