"""Candidates of a plan: their information, rules, equal ones, and combinations of set-ups."""

import itertools
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kernel import a3_plans
from oed.design import Candidates, Rules, choose
from oed.design.blocks import find_copies
from oed.design.bounds import bound
from oed.design.forms import Determinant
from oed.design.objective import CriterionObjective
from oed.design.rules import SetupLimit, TimeBudget

M = a3_plans.measurement()
SERIES = a3_plans.circles(M, 6)
(NAME,) = M.setups


def exact_information(rows: np.ndarray) -> np.ndarray:
    """Over the free parameters in tolerances, of white readings."""
    jacobian = M.jacobian([SERIES], M.nominal)[rows] * M.tolerance
    white = jacobian[:, M.free] / M.sigma([SERIES])[rows, None]
    return white.T @ white


def test_single_readings_add_up_to_the_information_of_all():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    assert len(candidates) == len(SERIES)
    assert candidates.shared_errors == 0
    assert candidates.prior is None
    some = np.array([0, 3, 7])
    total = np.einsum("ckn,ckm->nm", *[candidates.blocks[some]] * 2)
    assert total == pytest.approx(exact_information(some), rel=1e-9)
    (part,) = candidates.readings_of(some)
    assert part.q[part.index[:, 0]] == pytest.approx(SERIES.q[SERIES.index[some, 0]])
    commands = SERIES.command[SERIES.index[:, 0]]
    assert candidates.command == pytest.approx(commands)


def test_a_whole_run_has_the_information_of_its_readings():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance", whole_runs=True)
    runs = list(dict.fromkeys(SERIES.run))
    assert len(candidates) == len(runs)
    for block, run in zip(candidates.blocks, runs, strict=True):
        rows = np.flatnonzero(SERIES.run == run)
        assert block.T @ block == pytest.approx(exact_information(rows), rel=1e-9)
    seconds = M.reading_seconds(NAME)
    count = np.array([(SERIES.run == run).sum() for run in runs])
    assert candidates.cost == pytest.approx(seconds * count)


def test_prior_information_is_added_on_the_parameters():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    n = candidates.columns
    twice = candidates.add_prior(np.eye(n)).add_prior(2.0 * np.eye(n))
    assert twice.prior == pytest.approx(3.0 * np.eye(n))
    assert candidates.prior is None
    assert isinstance(candidates.criterion("D"), Determinant)


def test_readings_too_near_each_other_are_nearer_than_one():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    apart = np.array([0.0, 0.5, 0.0])
    distance = candidates.rules(size=4, apart=apart).distance
    assert distance.least == 1.0
    assert distance.position[:, 1] == pytest.approx(candidates.command[:, 1] / 0.5)
    assert (distance.position[:, [0, 2]] == 0.0).all()
    time = candidates.rules(budget=100.0).time
    assert time.cost == pytest.approx(candidates.cost)


def test_candidates_are_counted_through_their_series():
    series = [["a", "b", "c"], ["d", "e"], ["f"]]
    pool: Any = SimpleNamespace(members=np.arange(6)[:, None], series=series)
    found = (Candidates.reading(pool, k) for k in range(6))
    assert [rows[k] for rows, k in found] == list("abcdef")


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


SETUP = np.array([0, 0, 1, 2, 2, 2, 3])


def combinations(rules: Rules) -> list[set[int]]:
    """Set-ups of each first level."""
    parts = rules.relaxations(len(SETUP))
    return [set(SETUP[part.candidates].tolist()) for part in parts]


@pytest.mark.parametrize("most", [1, 2, 3, 4, 9])
def test_plans_of_a_number_of_set_ups_are_bounded_over_each_combination(most):
    """Of more set-ups than there are, over all of them."""
    rules = Rules(size=3, setups=SetupLimit(SETUP, most=most))
    by_hand = [set(c) for c in itertools.combinations(range(4), min(most, 4))]
    assert combinations(rules) == by_hand


def test_where_mounting_counts_fewer_set_ups_leave_more_of_the_budget():
    cost = np.array([1.0, 2.0, 4.0, 8.0])
    rules = Rules(
        time=TimeBudget(np.ones(len(SETUP)), 7.0),
        setups=SetupLimit(SETUP, cost, most=2),
    )
    every = [set(c) for k in (1, 2) for c in itertools.combinations(range(4), k)]
    times = [float(cost[list(c)].sum()) for c in every]
    by_hand = [(c, t) for c, t in zip(every, times, strict=True) if t < 7.0]
    assert combinations(rules) == [c for c, _ in by_hand]
    totals = [part.total for part in rules.relaxations(len(SETUP))]
    sizes = [int(np.isin(SETUP, list(c)).sum()) for c, _ in by_hand]
    rest = [7.0 - t for _, t in by_hand]
    assert totals == [min(r, n) for r, n in zip(rest, sizes, strict=True)]
