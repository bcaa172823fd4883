"""Bounds of parameters: draws are those of exact rejection from the closed form."""

import dataclasses
import functools

import numpy as np
import pytest

from kernel import a3_plans
from oed import posterior
from oed.estimation import Estimate, identify
from oed.measurement import Measurement, Series, draw_parameters, draw_readings
from oed.posterior import OutOfBoundsError

#: one that readings determine, and one that lost directions move
SEEN, LOST = "dq1", "da2x"


def head(bounds: dict[str, tuple[float, float]]) -> Measurement:
    """The A3 head with errors of a hundredth, so that its readings are linear."""
    free, every = (-np.inf, np.inf), a3_plans.machine.parameters
    limits = [
        {"tolerance": 0.01 * p.tolerance, "bounds": bounds.get(p.name, free)}
        for p in every
    ]
    parameters = [
        dataclasses.replace(p, **d) for p, d in zip(every, limits, strict=True)
    ]
    return a3_plans.measurement(of=a3_plans.machine.with_parameters(parameters))


def readings() -> tuple[Series, np.ndarray]:
    m = head({})
    series = a3_plans.circles(m, 12)
    rng = np.random.default_rng(6)
    truth = draw_parameters(m, rng)
    return series, draw_readings(m, [series], truth, rng)


SERIES, Y = readings()


def normal_draws(m: Measurement, estimate: Estimate, count: int) -> np.ndarray:
    """Draws (count, n) of the linear Gaussian model without bounds, written out."""
    prior = np.diag(m.tolerance**2)
    h = m.jacobian([SERIES], estimate.theta)
    marginal = h @ prior @ h.T + np.diag(m.sigma([SERIES]) ** 2)
    gain = np.linalg.solve(marginal, h @ prior).T
    change = Y - m.readings([SERIES], estimate.theta) + h @ estimate.theta
    rng = np.random.default_rng(7)
    # Matheron's rule: a draw of the prior, corrected by what it reads
    drawn = rng.standard_normal((count, len(prior))) * m.tolerance
    noise = rng.standard_normal((count, len(Y))) * m.sigma([SERIES])
    return drawn + (change - drawn @ h.T - noise) @ gain.T


@functools.cache
def bounded() -> tuple[Measurement, Estimate, np.ndarray]:
    """Bounds that cut through what is known, and the exact draws within."""
    free = head({})
    first = identify(free, [SERIES], Y)
    seen, lost = (free.names.index(name) for name in (SEEN, LOST))
    ends = {
        SEEN: (-np.inf, max(float(first.theta[seen] + 0.2 * first.sd[seen]), 0.0)),
        LOST: (-0.5 * free.tolerance[lost], np.inf),
    }
    m = head(ends)
    estimate = identify(m, [SERIES], Y)
    exact = normal_draws(m, estimate, 60_000)
    within = (exact[:, seen] <= ends[SEEN][1]) & (exact[:, lost] >= ends[LOST][0])
    assert 0.1 < within.mean() < 0.7
    return m, estimate, exact[within]


@pytest.mark.parametrize("sampler", ["laplace", "auto", "emcee"])
def test_draws_are_those_of_exact_rejection(sampler):
    m, estimate, exact = bounded()
    rng = np.random.default_rng(8)
    if sampler == "laplace":
        drawn = posterior.draw_approximation(m, [SERIES], Y, estimate, rng, 4000).theta
        assert len(drawn) == 4000
    else:
        result = posterior.sample(
            m, [SERIES], Y, estimate, rng, sampler=sampler, ess=1000.0
        )
        drawn = result.pooled
        assert result.sampler == ("emcee" if sampler == "emcee" else "importance")
        most = 0.9 if sampler == "emcee" else 1.0
        assert np.nanmin(result.ess) <= most * drawn.shape[0]
    assert m.in_bounds(drawn).all()
    free = m.free
    sd = exact.std(axis=0)[free]
    off = (drawn.mean(axis=0) - exact.mean(axis=0))[free] / sd
    assert np.abs(off).max() < 0.12
    assert drawn.std(axis=0)[free] == pytest.approx(sd, rel=0.1)
    # without the bounds, the mean of the one that is cut is elsewhere
    cut = m.names.index(SEEN)
    shift = (estimate.theta[cut] - exact[:, cut].mean()) / exact[:, cut].std()
    assert shift > 0.5


def test_an_estimate_near_a_bound_says_so():
    _, estimate, _ = bounded()
    (sentence,) = [w for w in estimate.warnings if "near a bound" in w]
    assert SEEN in sentence
    assert not [w for w in identify(head({}), [SERIES], Y).warnings if "bound" in w]


def test_virtual_machines_keep_to_bounds():
    m = head({SEEN: (0.0, np.inf), LOST: (-1e-6, 2e-6)})
    drawn = draw_parameters(m, np.random.default_rng(9), 2000)
    assert m.in_bounds(drawn).all()
    half_normal = m.tolerance[m.names.index(SEEN)] * np.sqrt(2.0 / np.pi)
    assert drawn[:, m.names.index(SEEN)].mean() == pytest.approx(half_normal, rel=0.06)


def test_readings_that_contradict_bounds_are_refused():
    """The cup is 25 standard deviations on the other side."""
    m = head({})
    (setup,) = m.setups.values()
    nuisances = [dataclasses.replace(n, bounds=(0.0, np.inf)) for n in setup.nuisances]
    m = m.with_setups([dataclasses.replace(setup, nuisances=tuple(nuisances))])
    estimate = identify(m, [SERIES], Y)
    rng = np.random.default_rng(1)
    for sampler in (posterior.sample, posterior.draw_approximation):
        with pytest.raises(OutOfBoundsError, match=r"bounds of cup\.cup_"):
            sampler(m, [SERIES], Y, estimate, rng)
