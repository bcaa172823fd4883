"""Criteria as cones: the solver's value of a given matrix is the criterion's."""

import cvxpy as cp
import numpy as np
import pytest

from oed.design import Criterion
from oed.design.conic import ConicCriterion, dual_root
from oed.design.forms import PowerMean
from oed.design.forms.determinant import Determinant
from oed.design.forms.eigenvalues import ExtremeEigenvalues
from oed.design.forms.variance import LargestVariance, Variance

N = 3
_rng = np.random.default_rng(2)
FACTORS = _rng.standard_normal((3, 2, N))
CRITERIA: dict[str, Criterion] = {
    "D": Determinant(N),
    "Ds": Determinant(N, np.linalg.qr(_rng.standard_normal((N, 2)))[0], "Ds"),
    "I": Variance(FACTORS[0]),
    "G": LargestVariance(FACTORS),
    "E": ExtremeEigenvalues(),
    "phi_1": PowerMean(1.0, N),
    "phi_2": PowerMean(2.0, N),
    "phi_1/2": PowerMean(0.5, N, "O5"),
}


def matrix(seed: int) -> np.ndarray:
    rows = np.random.default_rng(seed).standard_normal((6, N))
    return rows.T @ rows + 0.1 * np.eye(N)


@pytest.mark.parametrize("name", CRITERIA)
def test_differences_of_the_log_are_those_of_the_criterion(name: str) -> None:
    """The hypograph's log is the criterion's up to a constant, at two matrices."""
    criterion, typical = CRITERIA[name], matrix(0)
    turn = np.linalg.inv(np.linalg.cholesky(typical))
    values = []
    for seed in (1, 2):
        m = turn @ matrix(seed) @ turn.T
        term = ConicCriterion(criterion, cp.Constant(m), turn, typical)
        goal = cp.Problem(cp.Maximize(term.log), term.constraints)
        goal.solve(solver=cp.CLARABEL)
        values.append(float(term.log.value))
    exact = [criterion.value(matrix(seed)) for seed in (1, 2)]
    assert values[1] - values[0] == pytest.approx(exact[1] - exact[0], abs=1e-5)


def test_a_dual_has_a_root_of_trace_one() -> None:
    dual = matrix(3)
    dual[0, 1] += 1e-6
    root = dual_root(dual)
    symmetric = 0.5 * (dual + dual.T)
    assert root @ root.T == pytest.approx(symmetric / np.trace(symmetric))


@pytest.mark.parametrize("criterion", [PowerMean(3.0, N), ExtremeEigenvalues(0.5, 0.5)])
def test_criteria_without_a_cone_are_refused(criterion: Criterion) -> None:
    with pytest.raises(ValueError, match="no conic form here"):
        ConicCriterion(criterion, cp.Constant(np.eye(N)), np.eye(N), np.eye(N))
