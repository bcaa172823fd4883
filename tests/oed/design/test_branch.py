"""Branch and bound and all plans of small problems, against loops over subsets."""

import itertools
from itertools import combinations

import numpy as np
import pytest

from oed.design import CRITERIA, Rules, branch, choose
from oed.design.exchange import best_of_all, pose


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


def values(blocks, size, prior, criterion):
    """Least eigenvalue, or minus the condition number of H, of each plan."""
    plan_names = []
    for chosen in combinations(range(len(blocks)), size):
        rows = np.vstack([blocks[k] for k in chosen])
        if criterion == "E":
            least = np.linalg.eigvalsh(rows.T @ rows + prior)[0]
            plan_names.append(float(least))
        else:
            root = np.linalg.cholesky(prior + 1e-300 * np.eye(len(prior))).T
            plan_names.append(-float(np.linalg.cond(np.vstack([rows, root]))))
    return plan_names


@pytest.mark.parametrize("criterion", ["E", "kappa"])
@pytest.mark.parametrize(("k", "add_prior"), [(1, False), (2, True)])
def test_the_best_of_all_plans_is_chosen_and_proven(criterion, k, add_prior):
    for seed in range(20):
        rng = np.random.default_rng(seed)
        blocks = rng.standard_normal((10, k, 3))
        prior = 0.3 * np.eye(3) if add_prior else np.zeros((3, 3))
        given = prior if add_prior else None
        choice = choose(blocks, 4, rng, criterion, prior=given)
        best = max(values(blocks, 4, prior, criterion))
        assert choice.value == pytest.approx(abs(best), rel=1e-9)
        assert choice.proven
        assert choice.bound == choice.value
        assert choice.efficiency == 1.0


def test_other_criteria_rules_and_many_plans_are_left_to_the_search():
    rows = np.random.default_rng(1).standard_normal((40, 4))
    for count, criterion, taken in (
        (12, "E", True),
        (12, "D", False),
        (40, "E", False),
    ):
        rules = Rules(size=6)
        problem = pose(rows[:count], rules, criterion, None, 1e-6)
        plan = best_of_all(problem.objective, rules)
        assert (plan is not None) == taken
