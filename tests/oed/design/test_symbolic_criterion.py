"""Criteria as CasADi expressions, against their definitions."""

import casadi as ca
import numpy as np
import pytest

from oed.design import criteria, symbolic_criterion
from oed.design.symbolic_criterion import SymbolicCriterion

INTEREST = np.array([[1.0, 0.2, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0]]).T
CRITERIA = {
    "D": symbolic_criterion.determinant(),
    "A": symbolic_criterion.variance(),
    "I": symbolic_criterion.variance(np.diag([1.0, 2.0, 0.0, 0.5])),
    "Ds": symbolic_criterion.determinant_of_interest(INTEREST),
    "power 1": symbolic_criterion.power_mean(1),
    "power 5": symbolic_criterion.power_mean(5),
}


def by_definition(name: str, m: np.ndarray) -> float:
    """The criterion as its definition is written."""
    inverse = np.linalg.inv(m)
    if name == "D":
        return float(np.log(np.linalg.det(m)))
    if name == "A":
        return -np.log(-criteria.a(m))
    if name == "I":
        return -np.log(inverse[0, 0] + 2 * inverse[1, 1] + 0.5 * inverse[3, 3])
    if name == "Ds":
        return -float(np.log(np.linalg.det(INTEREST.T @ inverse @ INTEREST)))
    p = int(name.split()[1])
    return -float(np.log(np.trace(np.linalg.matrix_power(inverse, p)))) / p


@pytest.mark.parametrize("name", CRITERIA)
def test_value_and_expression_follow_the_definition(
    name: str, rng: np.random.Generator
) -> None:
    rows = rng.standard_normal((9, 4))
    m = rows.T @ rows
    expected = by_definition(name, m)
    assert CRITERIA[name].value(m) == pytest.approx(expected, abs=1e-10)
    symbol = ca.SX.sym("m", 4, 4)
    function = ca.Function("f", [symbol], [CRITERIA[name].expression(symbol)])
    assert float(function(m)) == pytest.approx(expected)


@pytest.mark.parametrize("name", CRITERIA)
def test_a_singular_matrix_has_no_value(name: str) -> None:
    assert CRITERIA[name].value(np.diag([1.0, 1.0, 1.0, -1.0])) == -np.inf


@pytest.mark.parametrize("name", CRITERIA)
def test_restriction_to_a_basis_keeps_the_value(
    name: str, rng: np.random.Generator
) -> None:
    """In any orthonormal basis of the whole space the criterion is the same."""
    rows = rng.standard_normal((9, 4))
    basis = np.linalg.qr(rng.standard_normal((4, 4)))[0]
    m = rows.T @ rows
    turned: SymbolicCriterion = CRITERIA[name].restrict(basis)
    assert turned.value(basis.T @ m @ basis) == pytest.approx(CRITERIA[name].value(m))


def test_directions_of_interest_that_no_reading_determines_are_refused() -> None:
    with pytest.raises(ValueError, match="do not determine the directions"):
        CRITERIA["Ds"].restrict(np.eye(4)[:, :2])


def test_a_power_below_one_is_refused() -> None:
    with pytest.raises(ValueError, match="p >= 1"):
        symbolic_criterion.power_mean(0)
