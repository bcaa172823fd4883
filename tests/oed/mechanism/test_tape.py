"""NumPy operations and compiled functions: each digit is that of CasADi's interpreter."""

import casadi as ca
import numpy as np
import pytest

from kernel.mechanism.compiling import (
    compiled,
    compiled_files,
    needs_compiler,
    not_compiled,
)
from oed.mechanism import BatchedFunction, batch
from oed.mechanism import compiled as lanes
from oed.mechanism.graph import read_graph
from oed.mechanism.tape import TAPE_SIZES, ArrayTape

__all__ = ["compiled_files"]

X, Y = ca.SX.sym("x"), ca.SX.sym("y")
#: one output for each operation
OUTPUTS = {
    "arithmetic": X + Y * 3.0 - X / Y + (-X) ** 2 + 2 * X + 1 / Y,
    "power": X**Y, "constant power": X**2.5, "root": ca.sqrt(X), "exp": ca.exp(X),
    "log": ca.log(X), "sin": ca.sin(X), "cos": ca.cos(X),
    "both": ca.sin(X * Y) * ca.cos(X * Y), "tan": ca.tan(X), "asin": ca.asin(X / 9),
    "acos": ca.acos(X / 9), "atan": ca.atan(X), "atan2": ca.atan2(X, Y),
    "sinh": ca.sinh(X), "cosh": ca.cosh(X), "tanh": ca.tanh(X), "hypot": ca.hypot(X, Y),
    "copysign": ca.copysign(X, Y), "sign": ca.sign(X), "abs": ca.fabs(X),
    "least": ca.fmin(X, Y) + ca.fmax(X, 1.0),
    "rounded": ca.floor(3 * X) + ca.ceil(3 * Y) + ca.fmod(X, Y),
    "if": ca.if_else(X < Y, X, 5.0) + ca.if_else(ca.logic_and(X <= 1, Y != 1), Y, 0),
    "or": ca.if_else(ca.logic_or(ca.logic_not(X), X == Y), 1.0, X),
    "constant": ca.SX(4.0), "input": X,
}  # fmt: skip
SPECIAL = np.array([0.0, -0.0, 1.0, -1.0, np.inf, -np.inf, np.nan, 1e-310, 1e300])
COUNTS = (1, 9, 192, 255, 300, 2 * max(TAPE_SIZES) + 7)


def _points(rng: np.random.Generator, count: int) -> list[np.ndarray]:
    """Points (count, 1), some of them special, with values without a result."""
    x, y = rng.uniform(-9.0, 9.0, (2, count, 1))
    if count > len(SPECIAL) ** 2:
        x[: len(SPECIAL) ** 2, 0] = np.repeat(SPECIAL, len(SPECIAL))
        y[: len(SPECIAL) ** 2, 0] = np.tile(SPECIAL, len(SPECIAL))
    return [x, y]


def _is_same(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether all digits are; NaN have many forms."""
    return bool(((one == other) | (np.isnan(one) & np.isnan(other))).all())


@needs_compiler
@pytest.mark.usefixtures("compiled_files")
@pytest.mark.parametrize("count", COUNTS)
def test_three_ways_have_the_same_digits(count, rng, monkeypatch):
    """CasADi's own call is the oracle of the first points."""
    outputs = list(OUTPUTS.values())
    fast = compiled(lambda: BatchedFunction("f", [X, Y], outputs))
    plain = not_compiled(lambda: BatchedFunction("f", [X, Y], outputs))
    points = _points(rng, count)
    by_c = fast(*points)
    assert fast._jobs[lanes.Evaluation].ready is not None
    monkeypatch.setattr(batch, "MIN_ARRAY_POINTS", 1)
    by_numpy = plain(*points)
    monkeypatch.setattr(batch, "MIN_ARRAY_POINTS", 10**9)
    by_interpreter = plain(*points)
    every = zip(OUTPUTS, by_c, by_numpy, by_interpreter, strict=True)
    for name, c, array, interpreted in every:
        assert _is_same(array, interpreted), name
        assert _is_same(c, interpreted), name
    for k in range(min(count, 90)):
        one = ca.Function("f", [X, Y], outputs)(points[0][k], points[1][k])
        for name, values, wanted in zip(OUTPUTS, by_interpreter, one, strict=True):
            assert _is_same(values[k], np.array(wanted).ravel()), name


@pytest.mark.parametrize("special", [ca.erf, ca.log1p])
def test_an_unknown_operation_is_left_to_the_interpreter(special):
    function = ca.Function("f", [X], [special(X)])
    assert not ArrayTape(function).is_known
    assert read_graph(function) is None
    x = np.linspace(0.1, 0.9, 300)[:, None]
    values = compiled(lambda: BatchedFunction("f", [X], [special(X)]))(x)[0]
    assert [float(function(a)) for a in x[:5]] == values[:5, 0].tolist()


def test_the_graph_tells_what_an_input_changes_and_a_value_needs():
    a, b = ca.SX.sym("a"), ca.SX.sym("b")
    graph = read_graph(ca.Function("f", [a, b], [ca.sin(a) * b, ca.sqrt(b)]))
    varying = graph.varying([0])
    (product,), (root,) = graph.outputs
    assert product in varying
    assert root not in varying
    needed = graph.needed([root])
    assert {graph.nodes[n].entry for n in needed} == {None, (1, 0)}
    (sine,) = set(graph.nodes[product].sources) & varying
    assert graph.needed([product], [sine]) < graph.needed([product])
