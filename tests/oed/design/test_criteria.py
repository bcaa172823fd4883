"""Criteria against closed forms, and against NumPy and SciPy on random matrices."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from oed.design import criteria


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
def test_alphabetic_criteria_are_sums_over_singular_values(h: np.ndarray) -> None:
    s, m = np.linalg.svd(h, compute_uv=False), h.T @ h
    assert criteria.d(m) == pytest.approx(2 * np.log(s).sum(), abs=1e-6)
    assert criteria.a(m) == pytest.approx(-np.sum(1 / s**2), rel=1e-6)
    assert criteria.e(m) == pytest.approx(s.min() ** 2, rel=1e-6)
    jacobian = h[:3]
    inverse = np.linalg.inv(m)
    assert criteria.i(m, jacobian.T @ jacobian) == pytest.approx(
        -np.trace(jacobian @ inverse @ jacobian.T), rel=1e-6
    )
    assert criteria.i(m, np.eye(len(m))) == criteria.a(m)
    assert criteria.kappa(s) == pytest.approx(np.linalg.cond(h), rel=1e-9)


@settings(max_examples=50, deadline=None)
@given(matrices(), st.floats(0.01, 100.0))
def test_scale_laws(h: np.ndarray, c: float) -> None:
    """All readings c times as sensitive."""
    n, (s, m) = h.shape[1], (np.linalg.svd(h, compute_uv=False), h.T @ h)
    assert criteria.d(c**2 * m) == pytest.approx(
        criteria.d(m) + 2 * n * np.log(c), abs=1e-6
    )
    assert criteria.a(c**2 * m) == pytest.approx(criteria.a(m) / c**2, rel=1e-6)
    assert criteria.e(c**2 * m) == pytest.approx(criteria.e(m) * c**2, rel=1e-6)
    once, scaled = (
        criteria.observability(s, len(h)),
        criteria.observability(c * s, len(h)),
    )
    for index, power in {"O1": 1, "O2": 0, "O3": 1, "O4": 1, "O5": 1}.items():
        assert scaled[index] == pytest.approx(once[index] * c**power, rel=1e-9)
    assert criteria.kappa(c * s) == pytest.approx(criteria.kappa(s), rel=1e-12)


@settings(max_examples=50, deadline=None)
@given(matrices(), st.integers(0, 10**6))
def test_one_more_reading_never_makes_it_worse(h: np.ndarray, seed: int) -> None:
    row = np.random.default_rng(seed).standard_normal((1, h.shape[1]))
    m = h.T @ h
    more = m + row.T @ row
    for criterion in (
        criteria.d,
        criteria.a,
        criteria.e,
        lambda m: criteria.i(m, row.T @ row),
    ):
        assert criterion(more) >= criterion(m) - 1e-6 * abs(criterion(m))


def test_observability_indices_of_a_diagonal() -> None:
    """Singular values 8, 4, 1 and 9 readings, worked by hand."""
    s = np.array([8.0, 4.0, 1.0])
    assert criteria.observability(s, 9) == pytest.approx(
        {
            "O1": 32 ** (1 / 3) / 3,
            "O2": 1 / 8,
            "O3": 1.0,
            "O4": 1 / 8,
            "O5": 1 / (1 / 8 + 1 / 4 + 1),
        }
    )
    assert criteria.kappa(s) == 8.0
    assert criteria.kappa(s) * criteria.o2(s) == 1.0


def test_index_bounds(rng: np.random.Generator) -> None:
    """O5 <= O3 / 1 and O3 <= O1 sqrt(m); all equal where the singular values are equal
    but for the count.
    """
    for s in 10.0 ** rng.uniform(-3, 3, (50, 6)):
        assert (
            criteria.o5(s)
            <= criteria.o3(s)
            <= criteria.o1(s, 1)
            <= s.max() * (1 + 1e-12)
        )
        assert criteria.o4(s) <= criteria.o3(s)
    same = np.full(6, 2.5)
    assert criteria.o5(same) == pytest.approx(criteria.o3(same) / 6)
    assert criteria.o1(same, 4) == pytest.approx(2.5 / 2)


def test_noise_amplification_is_a_geometric_mean(rng: np.random.Generator) -> None:
    """Chang, Li and Li (2011), Eq. (17): L-th root of the product of L singular values,
    over the root of the poses.
    """
    s = rng.uniform(0.1, 10, 7)
    assert criteria.noise_amplification(s, 25) == pytest.approx(stats.gmean(s) / 5)
    assert criteria.noise_amplification(np.array([2.0, 8.0]), 4) == pytest.approx(2.0)


def test_long_products_neither_overflow_nor_vanish() -> None:
    assert criteria.o1(np.full(400, 1e200), 1) == pytest.approx(1e200)
    assert criteria.o1(np.full(400, 1e-200), 1) == pytest.approx(1e-200)


@pytest.mark.parametrize(
    "m", [np.zeros((3, 3)), np.diag([1.0, 2.0, 0.0]), np.ones((4, 4))]
)
def test_a_singular_design_is_worth_nothing(m: np.ndarray) -> None:
    assert criteria.d(m) == -np.inf
    assert criteria.a(m) == -np.inf
    assert criteria.i(m, np.eye(len(m))) == -np.inf
    assert criteria.e(m) == pytest.approx(0.0, abs=1e-15)


def test_the_catalogue_lists_what_is_computed() -> None:
    alphabetic = {"D", "Ds", "A", "c", "I", "G", "E"}
    assert set(criteria.CATALOGUE) == alphabetic | {
        "kappa",
        "O1",
        "O2",
        "O3",
        "O4",
        "O5",
        "noise_amplification",
    }
    s = np.array([8.0, 4.0, 1.0])
    for name, value in criteria.observability(s, 9).items():
        given_to = (s, 9) if name == "O1" else (s,)
        assert criteria.CATALOGUE[name].function(*given_to) == value
    assert all(
        c.source and c.about and c.name == n for n, c in criteria.CATALOGUE.items()
    )


def test_profiled_combined_and_worst_variances(rng: np.random.Generator) -> None:
    """Ds, c and G against the covariance itself."""
    a = rng.standard_normal((9, 4))
    m, covariance = a.T @ a, np.linalg.inv(a.T @ a)
    assert criteria.ds(m, np.eye(4)[:, :2]) == pytest.approx(
        -np.linalg.slogdet(covariance[:2, :2])[1]
    )
    row = rng.standard_normal(4)
    assert criteria.c(m, row) == pytest.approx(-row @ covariance @ row)
    moments = np.array([np.outer(x, x) for x in rng.standard_normal((3, 4))])
    assert criteria.g(m, moments) == pytest.approx(
        -max(np.trace(w @ covariance) for w in moments)
    )
