"""Standard errors of drawn figures, against closed forms and against other samples."""

import numpy as np
import pytest
from scipy import stats

from oed.accuracy import Spread, prediction

MACHINES, POSES, SAMPLES = 2000, 5, 200


@pytest.mark.parametrize("share", [0.025, 0.5, 0.95])
def test_a_quantile_of_normal_numbers(share, rng):
    """sqrt(p (1 - p) / m) over the density, of David and Nagaraja 2003."""
    exact = np.sqrt(share * (1.0 - share) / MACHINES)
    exact /= stats.norm.pdf(stats.norm.ppf(share))
    drawn = [
        prediction.quantile(rng.standard_normal(MACHINES), share)
        for _ in range(SAMPLES)
    ]
    values, errors = np.array(drawn).T
    assert np.mean(errors) == pytest.approx(exact, rel=0.05)
    assert np.std(values) == pytest.approx(exact, rel=0.2)


def test_poses_of_one_machine_are_no_independent_draws(rng):
    """Errors of a machine that all its poses share: five poses count as one."""
    pooled, squares = [], []
    for _ in range(SAMPLES):
        errors = np.tile(rng.standard_normal((400, 1)), POSES)
        pooled.append(prediction.pooled_quantile(np.abs(errors), 0.95))
        squares.append(prediction.root_mean_square(errors))
    for drawn in (pooled, squares):
        values, errors = np.array(drawn).T
        assert np.mean(errors) == pytest.approx(np.std(values), rel=0.2)
    # rms of 400 normal numbers: sd 1 / sqrt(2 m)
    assert np.mean(np.array(squares)[:, 1]) == pytest.approx(800**-0.5, rel=0.05)


def test_draws_of_a_chain_are_worth_less(rng):
    values = rng.standard_normal(MACHINES)
    alone = prediction.quantile(values, 0.5)
    related = prediction.quantile(values, 0.5, worth=MACHINES / 4)
    assert related.value == alone.value
    assert related.error == pytest.approx(2.0 * alone.error, rel=0.2)


def test_every_drawn_figure_of_a_spread_has_its_error(rng):
    size = np.abs(rng.standard_normal((MACHINES, 1)))
    spreads = [
        Spread.of_errors(size * rng.standard_normal((MACHINES, POSES)))
        for _ in range(2)
    ]
    for name, errors in spreads[0].monte_carlo.items():
        first, second = (np.atleast_1d(getattr(s, name)) for s in spreads)
        assert len(errors) == len(first)
        assert (np.array(errors) > 0.0).all()
        assert (np.abs(first - second) < 5.0 * np.sqrt(2.0) * np.array(errors)).all()
    whole = Spread.of_errors(np.zeros((10, 3)))
    assert set(whole.monte_carlo.values()) == {(0.0,), (0.0, 0.0)}
