"""Formulas for all pairs of an exchange, against a fresh factorisation of each plan."""

import itertools

import numpy as np
import pytest

from oed.design import Criterion
from oed.design.catalogue import CRITERIA
from oed.design.forms import Compound, LargestVariance, PowerMean
from oed.design.pairs import Pairs

SIZE, COUNT, N = 6, 11, 5


def _pairs(k: int, seed: int = 0) -> tuple[Pairs, np.ndarray]:
    """Pairs of six chosen and five other blocks, and M (6, 5, n, n) after each exchange."""
    blocks = np.random.default_rng(seed).standard_normal((COUNT, k, N))
    base = np.diag([0.5, 0.0, 0.2, 0.0, 0.0])
    products = np.swapaxes(blocks, 1, 2) @ blocks
    chosen, others = blocks[:SIZE], blocks[SIZE:]
    m = base + products[:SIZE].sum(axis=0)
    after = m - products[:SIZE, None] + products[None, SIZE:]
    return Pairs(m, chosen, others), after


@pytest.mark.parametrize("k", [1, 2, 6])
def test_factors_and_reductions_of_all_pairs(k):
    pairs, after = _pairs(k)
    inverse = np.linalg.inv(pairs.m)
    weight = np.diag([1.0, 2.0, 0.0, 0.3, 1.0])
    exact = np.linalg.det(after) / np.linalg.det(pairs.m)
    assert pairs.factors(inverse) == pytest.approx(exact, rel=1e-10)
    lowered = np.trace(weight @ inverse) - np.trace(
        weight @ np.linalg.inv(after), axis1=2, axis2=3
    )
    found = pairs.reductions(inverse, inverse @ weight @ inverse)
    assert found == pytest.approx(lowered, rel=1e-9, abs=1e-11)
    for pair, (i, j) in enumerate(itertools.product(range(SIZE), range(COUNT - SIZE))):
        assert pairs.information_after(pair) == pytest.approx(after[i, j], abs=1e-12)


def _criteria() -> dict[str, Criterion]:
    rng = np.random.default_rng(3)
    ingredients = {
        "c": rng.standard_normal((1, N)),
        "Ds": np.eye(N)[:, :2],
        "I": rng.standard_normal((4, 2, N)),
        "G": rng.standard_normal((4, 2, N)),
    }
    listed = {
        name: CRITERIA.build(name, N, ingredients.get(name))
        for name in CRITERIA.plan_names
    }
    listed |= {f"phi_{p}": PowerMean(float(p), N) for p in (1, 2, 4)}
    listed["smooth G"] = LargestVariance(ingredients["G"], 4.0)
    return listed | {"mean": Compound((listed["D"], listed["A"]), (0.5, 0.5))}


@pytest.mark.parametrize("k", [1, 2])
@pytest.mark.parametrize("name", _criteria())
def test_exchanges_are_ordered_as_by_the_criterion(name, k):
    """Of all pairs, or of those on a shortlist, the first one is the best."""
    criterion = _criteria()[name]
    for seed in range(3):
        pairs, after = _pairs(k, seed)
        values = criterion.exchange_values(pairs).ravel()
        exact = np.array([criterion.value(m) for m in after.reshape(-1, N, N)])
        listed = np.flatnonzero(np.isfinite(values))
        assert listed.size >= 8
        by_formula = listed[np.argsort(-values[listed])]
        assert (np.diff(exact[by_formula]) <= 1e-9 * np.abs(exact).max()).all()
