"""Branch and bound against every subset, and against the exchange."""

import itertools

import numpy as np
import pytest

from oed.design import CRITERIA, branch, choose


def best_subset(rows, size, criterion, prior):
    goal = CRITERIA.build(criterion, rows.shape[1])
    base = np.zeros((rows.shape[1],) * 2) if prior is None else prior
    return max(
        goal.value(rows[list(s)].T @ rows[list(s)] + base)
        for s in itertools.combinations(range(len(rows)), size)
    )


@pytest.mark.parametrize("criterion", ["D", "A", "O5"])
@pytest.mark.parametrize("seed", range(2))
def test_the_best_of_all_subsets_is_proven(seed, criterion):
    rng = np.random.default_rng(seed)
    rows = rng.standard_normal((13, 3))
    prior = np.diag(rng.uniform(0.1, 1.0, 3)) if seed % 2 else None
    poor = np.arange(5)  # a start far from the best one
    result = branch.solve(rows, 5, rng, criterion, prior, start=poor)
    assert result.value == pytest.approx(
        best_subset(rows, 5, criterion, prior), abs=1e-9
    )
    assert result.bound == pytest.approx(result.value, abs=1e-8)


def test_a_bound_holds_when_the_nodes_run_out():
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((20, 4))
    short = branch.solve(rows, 7, rng, start=np.arange(7), nodes=3)
    full = branch.solve(rows, 7, rng, start=np.arange(7))
    assert short.bound > short.value + 1e-8
    assert short.nodes == 3
    assert full.bound == pytest.approx(full.value, abs=1e-8)
    assert short.value <= full.value + 1e-12 <= short.bound + 1e-9


def test_criteria_that_are_not_smooth_are_refused():
    with pytest.raises(ValueError, match="smooth, concave"):
        branch.solve(np.eye(3), 3, np.random.default_rng(0), "E")


@pytest.mark.parametrize("rank", [3, 4])
def test_a_choice_takes_over_the_bound_of_the_tree(rank):
    """Conventional values, over the directions that the candidates determine."""
    rng = np.random.default_rng(7)
    rows = rng.standard_normal((14, rank)) @ rng.standard_normal((rank, 4))
    choice = choose(rows, 5, rng)
    bounded = branch.tighten(choice, rows, rng, CRITERIA.build("D", 4), None, 2000)
    assert bounded.proven
    assert bounded.efficiency == pytest.approx(1.0, abs=1e-7)
    assert bounded.value >= choice.value - 1e-9
    assert bounded.value <= bounded.bound + 1e-9
    assert bounded.bound < choice.bound
    s = np.linalg.svd(rows[bounded.indices], compute_uv=False)[:rank]
    assert bounded.value == pytest.approx(2 * np.log(s).sum())
    one_node = branch.tighten(choice, rows, rng, CRITERIA.build("D", 4), None, 1)
    assert bounded.bound <= one_node.bound <= choice.bound + 1e-6
