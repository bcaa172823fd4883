"""Exchange against every subset of tiny problems, and its own invariances."""

from itertools import combinations

import numpy as np
import pytest

from oed.design import blocks, exchange

CANDIDATES, SIZE, DIRECTIONS = 9, 4, 3


def value(rows, chosen, criterion, prior=0.0):
    eigenvalues = np.linalg.eigvalsh(rows[list(chosen)].T @ rows[list(chosen)] + prior)
    return float(np.log(eigenvalues).sum() if criterion == "D" else eigenvalues[0])


def best_subset(rows, size, criterion, prior=0.0):
    with np.errstate(all="ignore"):
        return np.nanmax(
            [
                value(rows, c, criterion, prior)
                for c in combinations(range(len(rows)), size)
            ]
        )


def problem(seed: int) -> tuple[np.ndarray, np.random.Generator]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((CANDIDATES, DIRECTIONS)), rng


@pytest.mark.parametrize(("criterion", "problems"), [("D", 25), ("E", 10)])
def test_tiny_problems_are_solved_almost_always(criterion, problems, monkeypatch):
    """The search alone: the best of all 126 subsets in 90 % of the problems, never far off."""
    monkeypatch.setattr(exchange, "best_of_all", lambda *_: None)
    shortfall = []
    for seed in range(problems):
        rows, rng = problem(seed)
        choice = exchange.choose(rows, SIZE, rng, criterion)
        assert len(set(choice.indices)) == SIZE
        assert choice.value == pytest.approx(
            value(rows, choice.indices, criterion), rel=1e-9
        )
        shortfall.append(best_subset(rows, SIZE, criterion) - choice.value)
    missed = np.array(shortfall) > 1e-9
    assert missed.mean() <= 0.10
    if criterion == "D":
        assert np.exp(-max(shortfall) / DIRECTIONS) > 0.97


def test_with_a_prior_fewer_readings_than_directions_will_do():
    for seed in range(20):
        rows, rng = problem(seed)
        prior = np.diag([0.5, 1.0, 2.0])
        choice = exchange.choose(rows, 2, rng, prior=prior)
        assert choice.directions == DIRECTIONS
        assert choice.value == pytest.approx(
            value(rows, choice.indices, "D", prior), rel=1e-12
        )
        assert choice.value == pytest.approx(best_subset(rows, 2, "D", prior), abs=1e-9)


@pytest.mark.parametrize("prior", [False, True])
@pytest.mark.parametrize("criterion", ["D", "E"])
@pytest.mark.parametrize(("size", "candidates"), [(3, 3), (10, 16)])
def test_any_size_gives_different_readings(size, candidates, criterion, prior):
    rng = np.random.default_rng(5)
    rows = rng.standard_normal((candidates, 3))
    base = np.eye(3) if prior else None
    choice = exchange.choose(rows, size, rng, criterion, prior=base)
    assert choice.indices.tolist() == sorted(set(choice.indices.tolist()))
    assert len(choice.indices) == size
    assert choice.value == pytest.approx(
        value(rows, choice.indices, criterion, 0.0 if base is None else base)
    )
    assert choice.criterion == criterion


def test_the_e_exchange_never_ends_below_the_d_design_it_starts_from():
    for seed in range(3):
        rows = np.random.default_rng(seed).standard_normal((60, 6)) * np.logspace(
            0, -2, 6
        )
        by_d = exchange.choose(rows, 12, np.random.default_rng(seed), "D", rounds=3)
        by_e = exchange.choose(rows, 12, np.random.default_rng(seed), "E", rounds=3)
        assert by_e.value >= value(rows, by_d.indices, "E") * (1 - 1e-9)
        assert by_d.value >= value(rows, by_e.indices, "D") - 1e-9


def test_turning_the_columns_changes_nothing(rng):
    rows = rng.standard_normal((80, 5)) * np.logspace(0, -2, 5)
    turn = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    plain = exchange.choose(rows, 9, np.random.default_rng(3))
    turned = exchange.choose(rows @ turn, 9, np.random.default_rng(3))
    assert turned.value == pytest.approx(plain.value, abs=1e-9)
    assert (turned.indices == plain.indices).all()


def test_units_of_the_columns_change_the_value_not_the_choice(rng):
    rows, scale = rng.standard_normal((80, 5)), np.array([1.0, 2.0, 0.5, 3.0, 0.1])
    plain = exchange.choose(rows, 9, np.random.default_rng(3), rounds=40)
    scaled = exchange.choose(rows * scale, 9, np.random.default_rng(3), rounds=40)
    assert scaled.value == pytest.approx(
        plain.value + 2 * np.log(scale).sum(), abs=1e-6
    )


def test_undetermined_directions_are_left_out(rng):
    """Seven columns of rank four: the product of the four non-zero eigenvalues."""
    rows = rng.standard_normal((50, 4)) @ rng.standard_normal((4, 7))
    choice = exchange.choose(rows, 8, rng)
    assert choice.directions == 4
    s = np.linalg.svd(rows[choice.indices], compute_uv=False)
    assert choice.value == pytest.approx(2 * np.log(s[:4]).sum(), abs=1e-9)
    projected = blocks.project_on_estimable(rows[:, None, :], None)[0][:, 0]
    assert projected.shape == (50, 4)
    assert projected @ projected.T == pytest.approx(rows @ rows.T, abs=1e-10)


def test_same_seed_same_design_and_more_starts_are_no_worse(rng):
    rows = rng.standard_normal((100, 8))
    few, again, many = (
        exchange.choose(rows, 12, np.random.default_rng(1), rounds=n)
        for n in (2, 2, 12)
    )
    assert (few.indices == again.indices).all()
    assert few.value == again.value
    assert many.value >= few.value


@pytest.mark.parametrize(("size", "options", "message"), [
    (0, {}, "cannot choose 0 different readings out of 9"),
    (10, {}, "cannot choose 10 different readings out of 9"),
    (2, {}, "2 readings cannot determine the 3 directions"),
    (4, {"criterion": "G"}, "criterion G needs a workspace"),
    (4, {"criterion": "X"}, "criterion 'X' is none of A, c, D"),
])  # fmt: skip
def test_impossible_requests_are_refused(size, options, message):
    rows, rng = problem(0)
    with pytest.raises(ValueError, match=message):
        exchange.choose(rows, size, rng, **options)


def test_a_condition_number_has_a_bound_only_where_it_says_something():
    """Weights of many normal rows reach 1, which bounds nothing; here they do not."""
    rng = np.random.default_rng(2)
    many = exchange.choose(rng.standard_normal((60, 3)), 8, rng, "kappa")
    assert many.bound is None
    assert many.efficiency is None
    stretched = rng.standard_normal((60, 3)) * [1.0, 1.0, 0.01]
    choice = exchange.choose(stretched, 8, rng, "kappa")
    assert choice.bound is not None
    assert 1.1 < choice.bound <= choice.value
