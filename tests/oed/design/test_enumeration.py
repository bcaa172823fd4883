"""All plans of small problems against loops over subsets, one matrix at a time."""

from itertools import combinations

import numpy as np
import pytest

from oed.design import Rules, choose
from oed.design.exchange import best_of_all, pose


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
