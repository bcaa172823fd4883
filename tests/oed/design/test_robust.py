"""Robust designs against every subset of small problems, and against the nominal plan."""

import itertools

import numpy as np
import pytest

from oed.design import Rules, robust
from oed.design.forms import Determinant, ExtremeEigenvalues, Variance
from oed.design.rules import TimeBudget


def scenarios(seed, count, size, n, spread=0.7):
    rng = np.random.default_rng(seed)
    middle = rng.standard_normal((1, count, 1, n))
    return middle + spread * rng.standard_normal((size, count, 1, n)), rng


def values(table: np.ndarray, chosen: tuple[int, ...]) -> np.ndarray:
    rows = table[:, list(chosen), 0]
    return np.linalg.slogdet(np.swapaxes(rows, 1, 2) @ rows)[1] / table.shape[3]


def risk_of(v: np.ndarray, risk: str) -> float:
    if risk == "mean":
        return float(v.mean())
    return float(
        v.min() if risk == "worst" else np.sort(v)[:2].mean()
    )  # cvar at level 2 of 5


@pytest.mark.parametrize("risk", ["mean", "cvar", "worst"])
def test_no_subset_exceeds_the_bound(risk):
    """All subsets of 5 of 12 in five scenarios: value below bound, design among the best."""
    table, rng = scenarios(0, 12, 5, 3)
    choice = robust.choose(
        table, Determinant(3), Rules(size=5), rng, risk=risk, tail_share=0.4
    )
    every = np.array(
        [risk_of(values(table, s), risk) for s in itertools.combinations(range(12), 5)]
    )
    assert choice.summary.value == pytest.approx(
        risk_of(values(table, tuple(choice.indices)), risk), abs=1e-9
    )
    assert every.max() <= choice.summary.bound + 1e-9
    assert choice.summary.value >= np.quantile(every, 0.99)
    assert choice.summary.value >= choice.summary.nominal


def test_one_scenario_is_the_plain_problem(rng):
    table, _ = scenarios(3, 40, 1, 4)
    prior = np.eye(4)
    choices = [
        robust.choose(
            table, Variance(np.eye(4)), Rules(size=8), rng, risk=r, prior=prior
        )
        for r in ("mean", "cvar", "worst")
    ]
    assert [k.summary.value for k in choices] == pytest.approx(
        [choices[0].summary.value] * 3, abs=1e-3
    )
    assert [k.summary.bound for k in choices] == pytest.approx(
        [choices[0].summary.bound] * 3, abs=1e-3
    )


def test_budget_and_refusals(rng):
    table, _ = scenarios(1, 30, 4, 3)
    cost = rng.uniform(1.0, 3.0, 30)
    choice = robust.choose(
        table, Determinant(3), Rules(time=TimeBudget(cost, 15.0)), rng
    )
    assert cost[choice.indices].sum() <= 15.0
    assert choice.summary.value <= choice.summary.bound
    with pytest.raises(ValueError, match="needs a smooth criterion"):
        robust.choose(table, ExtremeEigenvalues(), Rules(size=5), rng)
    with pytest.raises(ValueError, match="share of worst"):
        robust.choose(
            table, Determinant(3), Rules(size=5), rng, risk="cvar", tail_share=0.0
        )
