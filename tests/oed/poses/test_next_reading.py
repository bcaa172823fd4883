"""Next readings of a session against inverses and all plans tried one by one."""

import itertools

import numpy as np
import pytest

from oed.poses import Belief, next_reading


@pytest.fixture
def belief(rng: np.random.Generator) -> Belief:
    root = rng.standard_normal((6, 4))
    return Belief.build(np.linalg.inv(root.T @ root), rng.standard_normal((2, 3, 4)))


def exact(belief: Belief, rows: np.ndarray) -> np.ndarray:
    """Variances (K,) after rows (m, n), by the sum of informations."""
    covariance = np.linalg.inv(np.linalg.inv(belief.covariance) + rows.T @ rows)
    return np.array([np.trace(w @ covariance) for w in belief.weights])


@pytest.mark.parametrize("channels", [1, 2])
def test_variances_are_those_of_the_summed_information(channels, belief, rng):
    blocks = rng.standard_normal((5, channels, 4))
    after = belief.variances_after(blocks)
    for block, variances in zip(blocks, after, strict=True):
        assert variances == pytest.approx(exact(belief, block))
        assert belief.after(block).variances == pytest.approx(variances)
    several = belief.update_all(blocks, [0, 3])
    assert several.variances == pytest.approx(exact(belief, np.vstack(blocks[[0, 3]])))
    scores = [np.log(exact(belief, block)).sum() for block in blocks]
    assert belief.best_candidate(blocks) == int(np.argmin(scores))


def test_limits_count_for_what_lacks_them(belief, rng):
    blocks = rng.standard_normal((8, 1, 4))
    first = np.sqrt(belief.variances[0])
    limits = np.array([0.1 * first, np.nan])
    variances = np.array([exact(belief, block) for block in blocks])
    assert belief.best_candidate(blocks, limits) == int(np.argmin(variances[:, 0]))
    assert belief.open_components(limits) == [0]
    assert belief.open_components(np.array([2.0 * first, np.nan])) == []
    assert belief.open_components(None) == [0, 1]


def test_no_single_exchange_betters_the_remaining_readings(belief, rng, monkeypatch):
    blocks = rng.standard_normal((9, 1, 4))
    monkeypatch.setattr(next_reading, "MAX_SWEEPS", 20)  # until nothing changes

    def value(plan: list[int]) -> float:
        return float(np.log(exact(belief, blocks[plan][:, 0])).sum())

    plan = belief.best_remaining(blocks, 3)
    for place, other in itertools.product(range(3), range(9)):
        changed = [*plan[:place], other, *plan[place + 1 :]]
        assert value(changed) >= value(plan) - 1e-9
    alone = [value([k]) for k in plan]
    assert alone[0] == min(alone)


def test_the_fewest_readings_are_those_of_all_plans(belief, rng):
    """Readings may be taken again."""
    blocks = rng.standard_normal((6, 1, 4))
    limits = 0.6 * np.sqrt(belief.variances)

    def reaches(plan: tuple[int, ...]) -> bool:
        return bool((exact(belief, blocks[list(plan), 0]) <= limits**2).all())

    plans = itertools.combinations_with_replacement
    sizes = (n for n in range(1, 7) if any(map(reaches, plans(range(6), n))))
    fewest = next(sizes)
    found = belief.fewest_remaining(blocks, 20, limits)
    assert found is not None
    plan, count = found
    assert fewest <= count <= fewest + 1
    assert len(plan) in (count - 1, count)
    assert belief.fewest_remaining(blocks, 1, 1e-3 * limits) is None
    assert fewest > 1
    assert belief.fewest_remaining(blocks, fewest - 1, limits) is None
    assert belief.fewest_remaining(blocks, 5, 1e3 * limits) == ([], 0)
