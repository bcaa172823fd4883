"""Equal candidates: the weights that they share, the bound, and the choice among them."""

import numpy as np
import pytest

from oed.design import Rules, choose
from oed.design.blocks import find_copies
from oed.design.bounds import bound
from oed.design.forms import Determinant
from oed.design.objective import CriterionObjective


def test_copies_share_the_weight_and_keep_the_bound():
    rng = np.random.default_rng(9)
    rows = rng.standard_normal((60, 1, 5))
    several = rows[rng.permutation(np.repeat(np.arange(60), 3))]
    copies = find_copies(several)
    assert copies.exist
    assert np.array_equal(several[copies.first][copies.label], several)
    assert copies.number.sum() == 180
    nothing = np.zeros((5, 5))
    goal = Determinant(5)
    merged = bound(CriterionObjective(goal, several, nothing), Rules(size=12))
    # the same weights, without the copies: three of each as one of three times the weight
    alone = CriterionObjective(goal, rows * np.sqrt(3.0), nothing)
    apart = bound(alone, Rules(size=4))
    assert merged.bound == pytest.approx(apart.bound, abs=1e-8)
    assert merged.weights.sum() == pytest.approx(12.0)
    assert merged.weights.max() <= 1.0 + 1e-9
    choice = choose(several, 12, rng)
    assert len(set(choice.indices.tolist())) == 12


def test_kinds_and_different_candidates():
    rows = np.array([[1.0], [2.0], [1.0], [3.0], [2.0], [1.0]])
    copies = find_copies(rows)
    assert copies.first.tolist() == [0, 1, 3]
    assert copies.label.tolist() == [0, 1, 0, 2, 1, 0]
    kinds = np.array([0, 2, 0, 1, 0])
    chosen = copies.different(kinds)
    assert sorted(chosen.tolist()) == [0, 2, 3, 4, 5]
    assert copies.label[chosen].tolist() == kinds.tolist()


def test_copies_take_turns():
    """Of eight kinds read to and fro, half are in each direction; none stands twice."""
    rows = np.tile(np.eye(8), (2, 1))
    copies = find_copies(rows)
    chosen = copies.different(np.arange(8))
    assert sorted(copies.label[chosen]) == [*range(8)]
    assert np.count_nonzero(chosen < 8) == 4
    both = copies.different(np.repeat(np.arange(4), 2))
    assert len(set(both)) == 8
