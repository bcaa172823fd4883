"""Numbers of an estimated noise law against weighted means by hand."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import optimize

from kernel import a3_plans
from oed.estimation.noise_summary import SCATTER, noise_numbers
from oed.measurement.reading_structure import reading_structure
from oed.noise.prior import noise_prior

M = a3_plans.measurement()
SERIES = a3_plans.circles(M, 12)
STRUCTURE = reading_structure(M, [SERIES], M.nominal)
WEIGHTS = np.array([0.1, 0.2, 0.3, 0.4])


def posterior(draws: np.ndarray) -> Any:
    return SimpleNamespace(
        prior=noise_prior(STRUCTURE), structure=STRUCTURE, draws=draws, weights=WEIGHTS
    )


def test_means_and_deviations_are_the_draws(rng: np.random.Generator) -> None:
    prior = noise_prior(STRUCTURE)
    draws = rng.standard_normal((4, prior.dimensions))
    laws = prior.laws(draws)
    numbers = {n.kind: n for n in noise_numbers(posterior(draws), M.setups)}
    (setup,) = M.setups.values()
    sigma = 1e6 * setup.sigma[0]
    size = sigma * laws.scale[:, 0]
    mean = WEIGHTS @ size
    reading = numbers["reading"]
    assert (reading.value, reading.stated) == pytest.approx((mean, sigma))
    assert reading.sd == pytest.approx(np.sqrt(WEIGHTS @ (size - mean) ** 2))
    assert reading.unit == "um"
    run = numbers["run"]
    assert run.value == pytest.approx(WEIGHTS @ (size * laws.level))
    carried = numbers["carried"]
    assert carried.value == pytest.approx(WEIGHTS @ laws.carried)
    longest = max(Counter(SERIES.run).values())
    reach = np.minimum(laws.reach, longest)
    assert numbers["reach"].value == pytest.approx(WEIGHTS @ reach)


@pytest.mark.parametrize("factor", [1.0, 1.1, 1.4, 0.7])
def test_scatter_departs_where_all_draws_do(factor: float) -> None:
    prior = noise_prior(STRUCTURE)

    def scale(u: float) -> float:
        point = np.zeros((1, prior.dimensions))
        point[0, 0] = u
        return float(prior.laws(point).scale[0, 0])

    draws = np.zeros((4, prior.dimensions))
    draws[:, 0] = optimize.brentq(lambda u: scale(u) - factor, -2.0, 2.0)
    (reading, *_) = noise_numbers(posterior(draws), M.setups)
    assert reading.departs == (factor > SCATTER or factor < 1.0 / SCATTER)
