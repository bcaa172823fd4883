"""Criteria as CasADi expressions, against their definitions."""

import casadi as ca
import numpy as np
import pytest

from oed.design import CRITERIA, Criterion
from oed.design.forms import Determinant, PowerMean, Variance

INTEREST = np.array([[1.0, 0.2, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0]]).T
FACTOR = np.diag(np.sqrt([1.0, 2.0, 0.0, 0.5]))
FORMS: dict[str, Criterion] = {
    "D": Determinant(4), "A": CRITERIA.build("A", 4), "I": Variance(FACTOR),
    "Ds": CRITERIA.build("Ds", 4, INTEREST), "power 1": PowerMean(1.0),
    "power 5": PowerMean(5.0),
}  # fmt: skip


def by_definition(name: str, m: np.ndarray) -> float:
    """The logarithm as its definition is written."""
    inverse = np.linalg.inv(m)
    if name == "D":
        return float(np.log(np.linalg.det(m)))
    if name == "A":
        return -float(np.log(np.trace(inverse)))
    if name == "I":
        return -float(np.log(inverse[0, 0] + 2 * inverse[1, 1] + 0.5 * inverse[3, 3]))
    if name == "Ds":
        return -float(np.log(np.linalg.det(INTEREST.T @ inverse @ INTEREST)))
    p = int(name.split()[1])
    return -float(np.log(np.trace(np.linalg.matrix_power(inverse, p)))) / p


@pytest.mark.parametrize("name", FORMS)
def test_an_expression_follows_the_definition(name, rng):
    rows = rng.standard_normal((9, 4))
    m = rows.T @ rows
    symbol = ca.SX.sym("m", 4, 4)
    function = ca.Function("f", [symbol], [FORMS[name].expression(symbol)])
    assert float(function(m)) == pytest.approx(by_definition(name, m))


def test_the_least_eigenvalue_is_polished_by_a_power_mean():
    for name in ("E", "O3"):
        assert isinstance(CRITERIA.build(name, 4).polished, PowerMean)
    for name in ("kappa", "O2", "O4", "O5"):
        assert CRITERIA.build(name, 4).polished is None


@pytest.mark.parametrize("name", FORMS)
def test_expression_and_value_differ_by_a_constant(name, rng):
    symbol = ca.SX.sym("m", 4, 4)
    form = FORMS[name]
    function = ca.Function("f", [symbol], [form.expression(symbol)])
    matrices = [h.T @ h for h in rng.standard_normal((3, 9, 4))]
    differences = [float(function(m)) - form.log_size * form.value(m) for m in matrices]
    assert np.ptp(differences) < 1e-9
