"""Criteria: slopes by finite differences, values after adding, supporting lines."""

import numpy as np
import pytest

from oed.design import CRITERIA, Criterion
from oed.design.forms import PowerMean
from oed.design.forms.compound import Compound
from oed.design.forms.determinant import Determinant
from oed.design.forms.protocol import weight_gradient
from oed.design.forms.variance import LargestVariance, Variance

N = 5
_rng = np.random.default_rng(11)
FACTOR, FACTORS = _rng.standard_normal((3, N)), _rng.standard_normal((4, 2, N))
INTEREST = np.linalg.qr(_rng.standard_normal((N, 2)))[0]
INGREDIENTS = {"interest": INTEREST, "combination": FACTOR[:1], "accuracy": FACTORS}
#: every criterion of the catalogue by itself, so that a new file is held to all of this
LISTED = {
    name: CRITERIA.build(name, N, INGREDIENTS.get(CRITERIA[name].needs))
    for name in CRITERIA.plan_names
}
FORMS: dict[str, Criterion] = {
    "G smoothed": LargestVariance(FACTORS, 6.0), "phi_3": PowerMean(3.0, N),
    "compound": Compound((Determinant(N), Variance(FACTOR)), (0.3, 0.7)),
}  # fmt: skip
ALL = LISTED | FORMS
#: information functions; O3 is the root of one, E, which bounds its plans
CONCAVE = [name for name, c in ALL.items() if c.concave and name != "O3"]
SMOOTH = {name: criterion for name, criterion in ALL.items() if criterion.smooth}


def matrix(rng: np.random.Generator) -> np.ndarray:
    a = rng.standard_normal((2 * N, N)) * np.logspace(0, -0.7, N)
    return a.T @ a


@pytest.mark.parametrize("name", SMOOTH)
def test_slopes_and_curvatures_by_differences(name, rng):
    """Along the weights of random blocks, by central differences of the value."""
    criterion, m = SMOOTH[name], matrix(rng)
    blocks = 0.1 * rng.standard_normal((6, 2, N))
    a = np.einsum("ckn,ckm->cnm", blocks, blocks)
    step = 1e-3

    def value(w: np.ndarray) -> float:
        return criterion.value(m + np.einsum("c,cnm->nm", w, a))

    eye = step * np.eye(6)
    first = np.array([(value(e) - value(-e)) / (2 * step) for e in eye])
    assert weight_gradient(blocks, criterion.support(m).root) == pytest.approx(
        first, rel=1e-5, abs=1e-6
    )
    corners = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    second = np.array(
        [
            [sum(s * t * value(s * e + t * f) for s, t in corners) for f in eye]
            for e in eye
        ]
    ) / (4 * step**2)
    scale = np.abs(second).max()
    assert criterion.curvature(m, blocks) == pytest.approx(
        -second, rel=2e-3, abs=2e-3 * scale
    )
    assert np.linalg.eigvalsh(criterion.curvature(m, blocks))[0] >= -1e-9 * scale


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("k", [1, 3])
def test_values_after_adding_are_exact(name, k, rng):
    """Against the value of the sum; a shortlist never leaves the best one out by far."""
    criterion, m = ALL[name], matrix(rng)
    blocks = rng.standard_normal((40, k, N))
    values = criterion.values_after_adding(m, blocks)
    exact = np.array([criterion.value(m + x.T @ x) for x in blocks])
    known = np.isfinite(values)
    assert values[known] == pytest.approx(exact[known], abs=1e-8)
    assert known.sum() >= 10
    assert values.max() >= np.quantile(exact, 0.9)


@pytest.mark.parametrize("name", CONCAVE)
def test_no_matrix_crosses_a_supporting_line(name, rng):
    criterion = ALL[name]
    for _ in range(30):
        m = matrix(rng)
        value, root = criterion.support(m)
        touch = value + np.log(np.sum((m @ root) * root))
        assert touch >= criterion.value(m) - 1e-10
        if criterion.smooth and "G" not in name:
            assert touch == pytest.approx(criterion.value(m), abs=1e-8)
        for _ in range(10):
            other = matrix(rng)
            assert (
                criterion.value(other)
                <= value + np.log(np.sum((other @ root) * root)) + 1e-9
            )


@pytest.mark.parametrize("name", CONCAVE)
def test_twice_the_readings_are_twice_the_information(name, rng):
    criterion, m = ALL[name], matrix(rng)
    assert criterion.value(2.0 * m) == pytest.approx(
        criterion.value(m) + np.log(2.0), abs=1e-9
    )


@pytest.mark.parametrize("name", CONCAVE)
def test_one_more_reading_never_makes_it_worse(name, rng):
    criterion, m = ALL[name], matrix(rng)
    for row in rng.standard_normal((20, N)):
        assert criterion.value(m + np.outer(row, row)) >= criterion.value(m) - 1e-9


def test_profiling_out_is_the_schur_complement(rng):
    """Ds of the first three columns is log det of M_aa - M_ab M_bb^-1 M_ba."""
    m = matrix(rng)
    schur = m[:3, :3] - m[:3, 3:] @ np.linalg.solve(m[3:, 3:], m[3:, :3])
    ds = CRITERIA.build("Ds", N, np.eye(N)[:, :3])
    assert 3 * ds.value(m) == pytest.approx(np.linalg.slogdet(schur)[1])


def test_what_no_reading_determines_is_refused():
    basis = np.eye(N)[:, :3]
    assert CRITERIA.build("Ds", N, np.eye(N)[:, 2:4]).restrict(
        basis
    ).interest.shape == (3, 1)
    with pytest.raises(
        ValueError, match="no reading determines the directions of interest"
    ):
        CRITERIA.build("Ds", N, np.eye(N)[:, 4:]).restrict(basis)
    with pytest.raises(ValueError, match="no reading determines the combination"):
        CRITERIA.build("c", N, np.ones((1, N))).restrict(basis)
    with pytest.raises(ValueError, match="needs a workspace"):
        CRITERIA.build("I", N)
    with pytest.raises(ValueError, match="is none of"):
        CRITERIA.build("Z", N)
    for shares in ((0.5,), (0.5, 0.6), (1.5, -0.5), (1.0, 0.0)):
        parts = (Determinant(N), Variance(FACTOR))[: len(shares)]
        with pytest.raises(ValueError, match="summing to 1"):
            Compound(parts, shares)


@pytest.mark.parametrize("name", LISTED)
def test_no_reading_at_all_is_worth_nothing(name):
    assert ALL[name].value(np.zeros((N, N))) == -np.inf
