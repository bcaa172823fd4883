"""Robust designs against every subset of small problems, and against the nominal plan."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from oed.design import robust
from oed.design.criterion import Determinant, Spectrum, Variance
from oed.design.rules import Rules


def scenarios(
    seed: int, count: int, size: int, n: int, spread: float = 0.7
) -> tuple[np.ndarray, np.random.Generator]:
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
@pytest.mark.parametrize("seed", range(5))
def test_no_subset_exceeds_the_bound(seed: int, risk: robust.Risk) -> None:
    """All subsets of 5 of 12 in five scenarios: value below bound, design among the
    best.
    """
    table, rng = scenarios(seed, 12, 5, 3)
    found = robust.choose(
        table, Determinant(3), Rules(size=5), rng, risk=risk, level=0.4
    )
    every = np.array(
        [risk_of(values(table, s), risk) for s in itertools.combinations(range(12), 5)]
    )
    assert found.value == pytest.approx(
        risk_of(values(table, tuple(found.indices)), risk), abs=1e-9
    )
    assert every.max() <= found.bound + 1e-9
    assert found.value >= np.quantile(every, 0.99)
    assert found.value >= found.nominal


def test_one_scenario_is_the_plain_problem(rng: np.random.Generator) -> None:
    table, _ = scenarios(3, 40, 1, 4)
    prior = np.eye(4)
    kept = [
        robust.choose(
            table, Variance(np.eye(4)), Rules(size=8), rng, risk=r, prior=prior
        )
        for r in ("mean", "cvar", "worst")
    ]
    assert [k.value for k in kept] == pytest.approx([kept[0].value] * 3, abs=1e-3)
    assert [k.bound for k in kept] == pytest.approx([kept[0].bound] * 3, abs=1e-3)


def test_risks_are_ordered() -> None:
    """worst <= cvar <= mean, for designs and bounds alike; the worst-case design has
    the best worst case.
    """
    table, _ = scenarios(9, 60, 8, 4)
    found = {
        r: robust.choose(
            table,
            Determinant(4),
            Rules(size=8),
            np.random.default_rng(0),
            risk=r,
            level=0.25,
        )
        for r in ("mean", "cvar", "worst")
    }
    assert found["worst"].bound <= found["cvar"].bound + 1e-3
    assert found["cvar"].bound <= found["mean"].bound + 1e-3
    assert found["worst"].values.min() >= found["mean"].values.min() - 1e-9
    assert found["worst"].efficiency > 0.8


def test_budget_and_refusals(rng: np.random.Generator) -> None:
    table, _ = scenarios(1, 30, 4, 3)
    cost = rng.uniform(1.0, 3.0, 30)
    found = robust.choose(table, Determinant(3), Rules(budget=15.0, cost=cost), rng)
    assert cost[found.indices].sum() <= 15.0
    assert found.value <= found.bound
    with pytest.raises(ValueError, match="smooth criteria"):
        robust.choose(table, Spectrum(), Rules(size=5), rng)
    with pytest.raises(ValueError, match="share of worst"):
        robust.choose(table, Determinant(3), Rules(size=5), rng, risk="cvar", level=0.0)
