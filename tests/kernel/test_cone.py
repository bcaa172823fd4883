"""The conic relaxation: against all subsets, against the Newton relaxation, with
limits, for every criterion.
"""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from oed.design import cone, relaxation
from oed.design.blocks import information
from oed.design.criterion import (
    Compound,
    Criterion,
    Determinant,
    Power,
    Spectrum,
    Variance,
    Worst,
)
from oed.design.polytope import Polytope


def criteria(n: int, rng: np.random.Generator) -> list[Criterion]:
    """All that have a conic form, for n columns."""
    interest, factors = rng.standard_normal((n, 2)), rng.standard_normal((4, 2, n))
    return [
        Determinant(n),
        Determinant(n, interest, "Ds"),
        Variance(np.eye(n), "A"),
        Variance(factors[0, :1], "c"),
        Variance(factors[0], "I"),
        Worst(factors),
        Spectrum(),
        Spectrum(0.5, name="O3"),
        Spectrum(0.5, 0.5, name="kappa"),
        Power(0.5, n, "O5"),
        Power(1.0, n),
        Power(2.0, n),
        Power(8.0, n),
        Compound((Determinant(n), Variance(np.eye(n)), Spectrum()), (0.2, 0.3, 0.5)),
        Compound((Power(0.5, n), Worst(factors)), (0.6, 0.4)),
    ]


@pytest.mark.parametrize("seed", range(40))
def test_no_plan_exceeds_the_bound(seed: int) -> None:
    """Random sizes, ranks, blocks and priors, with limits in every third: all plans lie
    below a bound that is tight.
    """
    rng = np.random.default_rng(seed)
    k, count, n = (
        int(rng.integers(1, 4)),
        int(rng.integers(7, 10)),
        int(rng.integers(2, 5)),
    )
    size = int(rng.integers(-(-n // k), 6))
    rows = rng.standard_normal((count, k, n)) @ np.diag(10.0 ** rng.uniform(-1, 1, n))
    base = np.diag(10.0 ** rng.uniform(-2, 1, n)) if seed % 2 else np.zeros((n, n))
    costs = rng.uniform(0.5, 2.0, (1, count))
    limits = (costs, np.array([1.1 * size * costs.mean()])) if seed % 3 == 0 else None
    subsets = [list(c) for c in itertools.combinations(range(count), size)]
    if limits is not None:
        subsets = [c for c in subsets if costs[0, c].sum() <= limits[1][0]]
    every = criteria(n, rng)
    for criterion in (every[seed % len(every)], every[(seed + 7) % len(every)]):
        found = cone.relax(rows, size, criterion, base, 1.0, limits)
        assert (
            max(criterion.value(base + information(rows[c])) for c in subsets)
            <= found.bound
        )
        assert found.value == pytest.approx(
            criterion.value(base + information(rows, found.weights))
        )
        assert found.weights.sum() == pytest.approx(size, rel=1e-7)
        assert found.weights.min() >= 0.0
        assert found.weights.max() <= 1.0
        assert limits is None or costs[0] @ found.weights <= limits[1][0] + 1e-6
        assert found.gap < 1e-4


@pytest.mark.parametrize("which", [0, 2, 4, 5, 10, 11])
@pytest.mark.parametrize("cap", [0.4, np.inf])
def test_agrees_with_newton_steps(which: int, cap: float) -> None:
    """D, A, I, G, phi_1 and phi_2: the relaxation of this package that knows no conic
    solver finds the same.
    """
    rng = np.random.default_rng(3)
    rows, prior = (
        rng.standard_normal((40, 2, 4)) * np.array([0.2, 1.0, 2.0, 9.0]),
        np.diag(rng.uniform(0.1, 1.0, 4)),
    )
    criterion = criteria(4, rng)[which]
    found = cone.relax(rows, 8.0, criterion, prior, cap)
    newton = relaxation.relax(rows, 8.0, prior, cap, 1e-8, criterion)
    if criterion.smooth:
        assert found.value == pytest.approx(newton.value, abs=2e-5)
    assert found.value <= newton.bound + 1e-9
    assert newton.value <= found.bound + 1e-9


@pytest.mark.parametrize("which", range(15))
def test_two_solvers_agree(which: int) -> None:
    rng = np.random.default_rng(5)
    rows, group = (
        rng.standard_normal((20, 1, 3)),
        (np.arange(20) < 10).astype(float)[None],
    )
    criterion = criteria(3, rng)[which]
    limits = (group, np.array([1.5]))
    found = [
        cone.relax(rows, 5.0, criterion, limits=limits, solver=s)
        for s in ("CLARABEL", "SCS")
    ]
    assert found[0].value == pytest.approx(found[1].value, abs=1e-3)
    assert found[0].bound >= found[1].value - 1e-9
    assert found[1].bound >= found[0].value - 1e-9
    assert max(float(group[0] @ f.weights) for f in found) <= 1.5 + 1e-6


def test_the_bound_under_limits_holds_at_random_weights() -> None:
    """What slopes can carry: no feasible weights carry more, and the weights told carry
    as much.
    """
    rng = np.random.default_rng(6)
    rows, most = rng.uniform(0.0, 1.0, (3, 30)), np.array([2.0, 2.5, 3.0])
    plans, gains = (
        Polytope(6.0, np.full(30, 1.0), (rows, most)),
        rng.standard_normal(30),
    )
    bound, weights = plans.most(gains)
    assert gains @ weights == pytest.approx(bound, abs=1e-8)
    for _ in range(200):
        near = plans.nearest(rng.dirichlet(np.ones(30)) * 6.0)
        assert near.sum() == pytest.approx(6.0)
        assert (rows @ near <= most + 1e-6).all()
        assert gains @ near <= bound + 1e-6


def test_what_can_not_be_is_refused() -> None:
    rows = np.random.default_rng(0).standard_normal((8, 3))
    with pytest.raises(ValueError, match="no weights keep"):
        cone.relax(rows, 4.0, Determinant(3), limits=(np.ones((1, 8)), np.array([3.0])))
    with pytest.raises(ValueError, match="no conic form"):
        cone.relax(rows, 4.0, Power(3.0, 3))
    with pytest.raises(ValueError, match="no conic form"):
        cone.relax(rows, 4.0, Spectrum(1.0, 0.5, name="O4"))
    with pytest.raises(ValueError, match="unseen"):
        cone.relax(np.ones((5, 3)), 3.0, Determinant(3))
