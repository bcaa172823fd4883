"""Next readings of a session against inverses and all plans tried one by one."""

import itertools

import numpy as np
import pytest

from oed.design import next_reading
from oed.design.next_reading import (
    Belief,
    after_all,
    best_candidate,
    best_remaining,
    fewest_remaining,
    open_components,
    weights_of,
)


@pytest.fixture
def belief(rng: np.random.Generator) -> Belief:
    root = rng.standard_normal((6, 4))
    return Belief(
        np.linalg.inv(root.T @ root), weights_of(rng.standard_normal((2, 3, 4)))
    )


def exact(belief: Belief, rows: np.ndarray) -> np.ndarray:
    """Variances (K,) after rows (m, n), by the sum of informations."""
    covariance = np.linalg.inv(np.linalg.inv(belief.covariance) + rows.T @ rows)
    return np.array([np.trace(w @ covariance) for w in belief.weights])


@pytest.mark.parametrize("channels", [1, 2])
def test_variances_are_those_of_the_summed_information(
    channels: int, belief: Belief, rng: np.random.Generator
) -> None:
    blocks = rng.standard_normal((5, channels, 4))
    after = belief.variances_after(blocks)
    for block, variances in zip(blocks, after, strict=True):
        assert variances == pytest.approx(exact(belief, block))
        assert belief.after(block).variances == pytest.approx(variances)
    several = after_all(belief, blocks, [0, 3])
    assert several.variances == pytest.approx(exact(belief, np.vstack(blocks[[0, 3]])))
    scores = [np.log(exact(belief, block)).sum() for block in blocks]
    assert best_candidate(belief, blocks) == int(np.argmin(scores))


def test_limits_count_for_what_lacks_them(
    belief: Belief, rng: np.random.Generator
) -> None:
    blocks = rng.standard_normal((8, 1, 4))
    first = np.sqrt(belief.variances[0])
    limits = np.array([0.1 * first, np.nan])
    variances = np.array([exact(belief, block) for block in blocks])
    assert best_candidate(belief, blocks, limits) == int(np.argmin(variances[:, 0]))
    assert open_components(belief, limits) == [0]
    assert open_components(belief, np.array([2.0 * first, np.nan])) == []
    assert open_components(belief, None) == [0, 1]


def test_no_single_exchange_betters_the_remaining_readings(
    belief: Belief, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocks = rng.standard_normal((9, 1, 4))
    monkeypatch.setattr(next_reading, "SWEEPS", 20)  # until nothing changes

    def value(plan: list[int]) -> float:
        return float(np.log(exact(belief, blocks[plan][:, 0])).sum())

    plan = best_remaining(belief, blocks, 3)
    for place, other in itertools.product(range(3), range(9)):
        changed = [*plan[:place], other, *plan[place + 1 :]]
        assert value(changed) >= value(plan) - 1e-9
    alone = [value([k]) for k in plan]
    assert alone[0] == min(alone)


def test_the_fewest_readings_are_those_of_all_plans(
    belief: Belief, rng: np.random.Generator
) -> None:
    """Readings may be taken again."""
    blocks = rng.standard_normal((6, 1, 4))
    limits = 0.6 * np.sqrt(belief.variances)

    def reaches(plan: tuple[int, ...]) -> bool:
        return bool((exact(belief, blocks[list(plan), 0]) <= limits**2).all())

    sizes = (
        size
        for size in range(1, 7)
        if any(map(reaches, itertools.combinations_with_replacement(range(6), size)))
    )
    fewest = next(sizes)
    found = fewest_remaining(belief, blocks, 20, limits)
    assert found is not None
    plan, count = found
    assert fewest <= count <= fewest + 1
    assert len(plan) in (count - 1, count)
    assert fewest_remaining(belief, blocks, 1, 1e-3 * limits) is None
    assert fewest_remaining(belief, blocks, 5, 1e3 * limits) == ([], 0)
