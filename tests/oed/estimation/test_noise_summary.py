"""Numbers of an estimated noise law against weighted means by hand."""

from collections import Counter
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy import optimize
from shipped_models import laser_ball_bar, planar_2dof, pose_tracker, prs_spindle

from kernel import a3_plans
from oed import Measurement, mount
from oed.estimation import identify, noise_numbers
from oed.estimation.noise_summary import MIN_RATIO
from oed.measurement import draw_parameters, reading_structure
from oed.noise import Laws
from oed.noise_law import NoisePrior

position = pose_tracker.position

M = a3_plans.measurement()
SERIES = a3_plans.circles(M, 12)
STRUCTURE = reading_structure(M, [SERIES], M.nominal)
LONGEST = max(Counter(SERIES.run).values())
WEIGHTS = np.array([0.1, 0.2, 0.3, 0.4])


WHITE = -7.0  #: coordinate of the share carried along at which there is next to none


def scatter_within_run(laws: Laws, k: int) -> float:
    """Expected standard deviation about the mean of the longest run, of unit scale."""
    lag = np.abs(np.subtract.outer(np.arange(LONGEST), np.arange(LONGEST)))
    share = laws.correlated[k]
    whole = (1.0 - share) * np.eye(LONGEST) + share * np.exp(-lag / laws.reach[k])
    return float(np.sqrt(np.trace(whole - whole.mean(axis=0)) / (LONGEST - 1)))


def posterior(draws: np.ndarray) -> Any:
    law = {"prior": NoisePrior.of(STRUCTURE), "structure": STRUCTURE}
    return SimpleNamespace(**law, draws=draws, weights=WEIGHTS)


def test_means_and_deviations_are_the_draws(rng):
    prior = NoisePrior.of(STRUCTURE)
    draws = rng.standard_normal((4, prior.dimensions))
    laws = prior.laws(draws)
    numbers = {n.kind: n for n in noise_numbers(posterior(draws), M.setups)}
    (setup,) = M.setups.values()
    sigma = 1e6 * setup.sigma[0]
    size = sigma * laws.scale[:, 0] * [scatter_within_run(laws, k) for k in range(4)]
    mean = WEIGHTS @ size
    reading = numbers["reading"]
    assert (reading.value, reading.stated) == pytest.approx((mean, sigma))
    assert reading.sd == pytest.approx(np.sqrt(WEIGHTS @ (size - mean) ** 2))
    assert reading.unit == "um"
    run = numbers["run"]
    assert run.value == pytest.approx(sigma * WEIGHTS @ (laws.scale[:, 0] * laws.level))
    carried = numbers["carried"]
    assert carried.value == pytest.approx(WEIGHTS @ laws.correlated)
    reach = np.minimum(laws.reach, LONGEST)
    assert numbers["reach"].value == pytest.approx(WEIGHTS @ reach)


@pytest.mark.parametrize("factor", [1.0, 1.1, 1.4, 0.7])
def test_scatter_departs_where_all_draws_do(factor):
    prior = NoisePrior.of(STRUCTURE)

    def scale(u: float) -> float:
        point = np.zeros((1, prior.dimensions))
        point[0, :2] = u, WHITE
        return float(prior.laws(point).scale[0, 0])

    draws = np.zeros((4, prior.dimensions))
    draws[:, 1] = WHITE
    draws[:, 0] = optimize.brentq(lambda u: scale(u) - factor, -2.0, 2.0)
    (reading, *_) = noise_numbers(posterior(draws), M.setups)
    assert reading.departs == (factor > MIN_RATIO or factor < 1.0 / MIN_RATIO)


def test_each_channel_has_its_own_noise_however_far_another_is_overstated():
    """Two white channels of twice the stated noise, one of a seventeenth."""
    stated = np.array([10e-6, 10e-6, 10e-6])
    m = Measurement(planar_2dof.machine, [mount(position, "tracker", sigma=stated)])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 8), np.linspace(0.2, 1.3, 5))
    series = m.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(7)
    truth = stated * [1.0 / 17.0, 2.0, 2.0]
    readings = m.readings([series], draw_parameters(m, rng)).reshape(-1, 3)
    readings += truth * rng.standard_normal(readings.shape)
    estimate = identify(m, [series], readings.ravel(), estimate_noise=True)
    assert estimate.noise_posterior is not None
    numbers = noise_numbers(estimate.noise_posterior, m.setups)
    scatter = [n for n in numbers if n.kind == "reading"]
    sizes = np.array([n.value for n in scatter]) * 1e-6
    # of 40 readings each: some 12 % of a standard deviation, and a few directions
    assert sizes == pytest.approx(truth, rel=0.35)
    assert all(n.departs for n in scatter)
    assert not any(n.departs for n in numbers if n.kind == "carried")


def test_the_scatter_of_a_channel_is_that_of_all_its_sources():
    """A laser's x, y, z share range and angles; a scale is that of one source."""
    m = Measurement(
        prs_spindle.machine,
        [mount(laser_ball_bar.instrument, "laser", at_x=0.0, at_y=-0.7, at_z=0.2)],
    )
    command = np.random.default_rng(4).uniform(
        [0.1, -0.3, -0.3], [0.3, 0.3, 0.3], (6, 3)
    )
    series = m.series("laser", command)
    structure = reading_structure(m, [series], m.nominal)
    prior = NoisePrior.of(structure)
    draws = np.zeros((1, prior.dimensions))
    draws[0] = WHITE
    scale = np.array([1.0, 0.4, -0.8, 1.5, -2.0])
    draws[0, :5] = scale
    laws = prior.laws(draws)
    law = {
        "prior": prior,
        "structure": structure,
        "draws": draws,
        "weights": np.ones(1),
    }
    numbers = noise_numbers(SimpleNamespace(**law), m.setups)
    root = structure.restore(np.diag(laws.scale[0, structure.group])).T
    variance = (root**2).sum(axis=1)
    for g, one in enumerate(n for n in numbers if n.kind == "reading"):
        expected = np.sqrt(variance[structure.group == g].mean())
        unit = 1e-6 if one.unit == "um" else np.deg2rad(1.0 / 3600.0)
        assert one.value * unit == pytest.approx(expected, rel=1e-5)
