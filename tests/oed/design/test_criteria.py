"""Criteria against closed forms, NumPy and SciPy, and as CasADi expressions."""

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from oed.design import CRITERIA, Criterion, criteria
from oed.design.forms import Determinant, PowerMean, Variance


def of_information(name, m, ingredient=None):
    """The number that users know, of an information matrix."""
    criterion = CRITERIA.build(name, len(m), ingredient)
    return criterion.conventional_value(criterion.value(m), 1)


@st.composite
def matrices(draw: st.DrawFn) -> np.ndarray:
    """H (N, n), N > n, of moderate condition."""
    n = draw(st.integers(1, 8))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    u = np.linalg.qr(rng.standard_normal((n + draw(st.integers(1, 12)), n)))[0]
    v = np.linalg.qr(rng.standard_normal((n, n)))[0]
    return (u * 10.0 ** rng.uniform(-2, 2, n)) @ v


@settings(max_examples=100, deadline=None)
@given(matrices())
def test_alphabetic_criteria_are_sums_over_singular_values(h):
    s, m = np.linalg.svd(h, compute_uv=False), h.T @ h
    assert of_information("D", m) == pytest.approx(2 * np.log(s).sum(), abs=1e-6)
    assert of_information("A", m) == pytest.approx(-np.sum(1 / s**2), rel=1e-6)
    assert of_information("E", m) == pytest.approx(s.min() ** 2, rel=1e-6)
    jacobian = h[:3]
    inverse = np.linalg.inv(m)
    assert of_information("I", m, jacobian[None]) == pytest.approx(
        -np.trace(jacobian @ inverse @ jacobian.T), rel=1e-6
    )
    assert of_information("I", m, np.eye(len(m))[None]) == of_information("A", m)
    assert CRITERIA.index("kappa", s) == pytest.approx(np.linalg.cond(h), rel=1e-9)


def test_observability_indices_of_a_diagonal():
    """Singular values 8, 4, 1 and 9 readings, worked by hand."""
    s = np.array([8.0, 4.0, 1.0])
    wanted = {
        "O1": 32 ** (1 / 3) / 3, "O2": 1 / 8, "O3": 1.0, "O4": 1 / 8, "O5": 8 / 11,
    }  # fmt: skip
    assert CRITERIA.observability(s, 9) == pytest.approx(wanted)
    assert CRITERIA.index("kappa", s) == 8.0
    assert CRITERIA.index("kappa", s) * CRITERIA.index("O2", s) == 1.0


def test_noise_amplification_is_a_geometric_mean(rng):
    """Chang, Li and Li (2011), Eq. (17): root of L singular values over that of the poses."""
    s = rng.uniform(0.1, 10, 7)
    assert CRITERIA.index("noise_amplification", s, 25) == pytest.approx(
        stats.gmean(s) / 5
    )
    assert CRITERIA.index(
        "noise_amplification", np.array([2.0, 8.0]), 4
    ) == pytest.approx(2.0)


def test_long_products_neither_overflow_nor_vanish():
    assert CRITERIA.index("O1", np.full(400, 1e200), 1) == pytest.approx(1e200)
    assert CRITERIA.index("O1", np.full(400, 1e-200), 1) == pytest.approx(1e-200)


@pytest.mark.parametrize(
    "m", [np.zeros((3, 3)), np.diag([1.0, 2.0, 0.0]), np.ones((4, 4))]
)
def test_a_singular_design_is_worth_nothing(m):
    assert of_information("D", m) == -np.inf
    assert of_information("A", m) == -np.inf
    assert of_information("I", m, np.eye(len(m))[None]) == -np.inf
    assert of_information("E", m) == pytest.approx(0.0, abs=1e-15)


def test_the_catalogue_lists_what_is_computed():
    alphabetic = {"D", "Ds", "A", "c", "I", "G", "E"}
    indices = {"kappa", "O1", "O2", "O3", "O4", "O5", "noise_amplification"}
    assert alphabetic | indices <= set(CRITERIA.entries)
    files = [*Path(criteria.__path__[0]).glob("[!_]*.py")]
    assert len(CRITERIA.entries) == len(files)
    assert all(c.source and c.about for c in CRITERIA.entries.values())
    assert all(c.meaning for c in CRITERIA.entries.values() if c.form is not None)
    assert all(
        c.index_meaning for c in CRITERIA.entries.values() if c.index is not None
    )


@pytest.mark.parametrize("name", ["O1", "O2", "O3", "O4", "O5", "kappa"])
def test_an_index_is_the_criterion_of_the_information(name, rng):
    """Of the singular values, and of the matrix that they belong to."""
    h = rng.standard_normal((9, 4))
    of_values = CRITERIA.index(name, np.linalg.svd(h, compute_uv=False), 9)
    criterion = CRITERIA.build(name, 4)
    of_matrix = criterion.conventional_value(criterion.value(h.T @ h), 9)
    assert of_values == pytest.approx(of_matrix, rel=1e-9)


def test_properties_by_the_books():
    """Pukelsheim (2006), chapter 6: which are smooth; kappa, O2, O4 are not concave."""
    assert CRITERIA.smooth == ("A", "c", "D", "Ds", "I", "O1", "O5")
    assert CRITERIA.polished == ("A", "c", "D", "Ds", "E", "I", "O1", "O3")
    concave = {n for n in CRITERIA.plan_names if CRITERIA[n].properties.concave}
    assert set(CRITERIA.plan_names) - concave == {"kappa", "O2", "O4"}
    spectral = {n for n in CRITERIA.plan_names if CRITERIA[n].properties.spectral}
    assert spectral == {"E", "kappa", "O2", "O3", "O4", "O5"}


@pytest.mark.parametrize("name", ["D", "A", "E", "kappa", "O1", "O2", "O3", "O4", "O5"])
def test_phi_follows_from_the_number(name, rng):
    """phi of one matrix over phi of another, from log phi and from the numbers."""
    criterion = CRITERIA.build(name, 4)
    first, second = (h.T @ h for h in rng.standard_normal((2, 9, 4)))
    log_phi = [criterion.value(m) for m in (first, second)]
    numbers = [criterion.conventional_value(value, 9) for value in log_phi]
    ratio = CRITERIA[name].phi_ratio(numbers[0], numbers[1], 4)
    expected = np.exp(log_phi[0] - log_phi[1])
    assert ratio == pytest.approx(expected, rel=1e-9)


def test_profiled_combined_and_worst_variances(rng):
    """Ds, c and G against the covariance itself."""
    a = rng.standard_normal((9, 4))
    m, covariance = a.T @ a, np.linalg.inv(a.T @ a)
    assert of_information("Ds", m, np.eye(4)[:, :2]) == pytest.approx(
        -np.linalg.slogdet(covariance[:2, :2])[1]
    )
    row = rng.standard_normal(4)
    assert of_information("c", m, row[None]) == pytest.approx(-row @ covariance @ row)
    rows = rng.standard_normal((3, 1, 4))
    assert of_information("G", m, rows) == pytest.approx(
        -max(float(x @ covariance @ x) for x in rows[:, 0])
    )


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
