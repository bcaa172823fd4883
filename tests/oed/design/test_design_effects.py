"""Designs that allow for effects or errors of a run: dense covariances and all subsets."""

import dataclasses
import itertools

import msgspec
import numpy as np
import pytest
import report_fixture
import sample
from design_sample import EXTRA, KNOWN, chosen, rows, text
from oracles import a3_geometry as a3
from reference import tian_2016 as paper
from result_sample import whole

from kernel import a3_plans
from oed import checks, identifiability
from oed.accuracy import ErrorMaps
from oed.checks import copies
from oed.design import Candidates, Nuisances, choose
from oed.measurement import Measurement, Series
from oed.result import AllowedEffects
from oed.units import from_si
from pkm_studies.base import InputError
from pkm_studies.stages.headline import design_sentences

EFFECTS = 'effects = ["encoder_scale", "pitch_accumulation"]\n'


def dense(h, g, scatter, subset):
    """Information of rows, with effects and scatter as a covariance, in noise units."""
    covariance = np.diag(1.0 + scatter[subset] ** 2) + g[subset] @ g[subset].T
    return h[subset].T @ np.linalg.solve(covariance, h[subset]) + np.eye(h.shape[1])


@pytest.mark.parametrize("name", ["D", "A"])
def test_no_subset_is_better_nor_above_the_bound(name):
    """All 56 choices of 3 readings out of 8, with drawn effects."""
    rng = np.random.default_rng(3)
    resolved, _ = chosen(text('criterion = "D"\n' + KNOWN + EXTRA))
    measurement, series = resolved.measurement, resolved.candidates
    h, sigma = rows(resolved), 0.5e-6
    g, scatter = 20.0 * rng.standard_normal((8, 3)), 5.0 * rng.random(8)
    nuisances = Nuisances(sigma * g, sigma * scatter)
    m, prior = measurement, np.eye(h.shape[1])
    pool = Candidates.build(m, series, m.nominal, "tolerance", nuisances=nuisances)
    pool = pool.add_prior(prior)
    assert pool.nuisance_columns == 3
    choice = choose(
        pool.blocks, 3, np.random.default_rng(0), pool.criterion(name), prior=pool.prior
    )
    values = {}
    for subset in itertools.combinations(range(8), 3):
        inverse = np.linalg.inv(dense(h, g, scatter, list(subset)))
        if name == "D":
            values[subset] = -float(np.linalg.slogdet(inverse)[1])
        else:
            values[subset] = -float(np.log(np.trace(inverse)))
    best = max(values, key=lambda subset: values[subset])
    assert tuple(choice.indices) == best
    assert choice.efficiency is not None
    assert 0.0 < choice.efficiency <= 1.0 + 1e-9


def test_the_plan_is_stated_beside_that_without_effects():
    """By I, no plan of three readings leaves less on a machine with the effects."""
    _, design = chosen(text('criterion = "I"\n' + KNOWN + EXTRA + EFFECTS))
    allowed = design.effects
    assert allowed.groups > 3
    assert 0.0 < allowed.efficiency <= 1.0 + 1e-9
    assert 0.0 < allowed.efficiency_without <= 1.0 + 1e-9
    for key, value in allowed.accuracy.items():
        assert value < allowed.before[key]
    resolved, rigid = chosen(text('criterion = "I"\n' + KNOWN + EXTRA))
    assert rigid.effects is None
    predicted = rigid.criteria.predicted_accuracy(resolved.measurement, rigid.series)
    # effects leave more than the geometry alone
    assert all(allowed.accuracy_without[k] > v for k, v in predicted.items())


def test_reference_plans_are_compared_without_effects():
    """Values with and without effects are not set against each other."""
    section = report_fixture.result_of(whole()).design
    assert section is not None
    plans = [
        msgspec.structs.replace(section.plans[0], name=name, criterion="I", value=value)
        for name, value in (("chosen", -2e-8), ("paper", -3e-8))
    ]
    allowed = AllowedEffects(2, 3, 0.9, 1.0, {}, {}, {})
    found = {"criterion": "I", "value": -4e-7, "efficiency": 0.97, "proven": False}
    section = msgspec.structs.replace(section, plans=plans, effects=allowed, **found)
    (words,) = design_sentences(section)
    assert (
        "reach I = -4e-07 with effects (certified to 97.0 % of the best possible), and"
        " without any I = -2e-08, against -3e-08 for paper"
    ) in words
    (alone,) = design_sentences(msgspec.structs.replace(section, effects=None))
    assert "without" not in alone


@pytest.mark.parametrize(("lines", "words"), [
    ('criterion = "D"\nreadings = 3\n', 'need scaling = "tolerance"'),
    ('criterion = "E"\n' + KNOWN, "does not profile out effects"),
    ('criterion = "D"\nhow_many = {}\n' + KNOWN, "accuracy by number of readings"),
])  # fmt: skip
def test_what_cannot_allow_for_effects_is_refused(lines, words):
    with pytest.raises(InputError, match=words):
        chosen(text(lines + EXTRA + EFFECTS))


NOISE, RUN = 0.5e-6, 1.0e-6
#: circles of each plan: readings, strokes, how often
PLANS = {
    "six circles": (8, tuple(np.linspace(0.0, 0.2, 6)), 1),
    "two circles twice": (12, (0.08, 0.2), 2),
}
#: sd of theta, arcsec, as docs/howto/plan.md states it: without and with run errors
STATED = {"six circles": (1.27, 2.30), "two circles twice": (1.86, 1.86)}


def plan(m: Measurement, name: str) -> Series:
    points, strokes, times = PLANS[name]
    circles = a3_plans.circles(m, points, strokes=strokes).reading_commands()
    command = np.vstack([circles] * times)
    return m.series("cup", command, [f"c{k // points}" for k in range(len(command))])


def theta_sd(maps: ErrorMaps, covariance: np.ndarray) -> float:
    """Root mean square over the workspace, arcsec, after compensation."""
    row = maps.raw[:, maps.names.index("theta")]
    variance = np.einsum("np,pq,nq->n", row, covariance[:24, :24], row)
    return float(from_si(np.sqrt(variance.mean()), "arcsec"))


@pytest.mark.parametrize("name", list(PLANS))
def test_theta_of_both_plans(name):
    m = a3_plans.measurement()
    maps = ErrorMaps.of(m.kinematics, a3_plans.workspace(), "home")
    series = plan(m, name)
    z, psi, theta = series.reading_commands().T
    cup = np.array([0.0, 0.0, paper.TEACH_Z])
    slopes = a3.bar_rows(z, psi, theta, cup) * m.tolerance
    same_run = np.asarray(series.run)[:, None] == np.asarray(series.run)
    for run_error, stated in zip((0.0, RUN), STATED[name], strict=True):
        noise = NOISE**2 * np.eye(len(z)) + run_error**2 * same_run
        precision = np.eye(27) + slopes.T @ np.linalg.solve(noise, slopes)
        covariance = np.linalg.inv(precision) * np.outer(m.tolerance, m.tolerance)
        assert theta_sd(maps, covariance) == pytest.approx(stated, abs=0.005)
        assert theta_sd(maps, toolkit(m, series, run_error)) == pytest.approx(
            theta_sd(maps, covariance), rel=2e-3
        )


def toolkit(m: Measurement, series: Series, run_error: float) -> np.ndarray:
    """The covariance by a set-up that states an error of the run."""
    setup = m.setups["cup"]
    channel = dataclasses.replace(
        setup.instrument.channels[0], shared=run_error / NOISE
    )
    instrument = dataclasses.replace(setup.instrument, channels=(channel,))
    noisy = m.with_setups([dataclasses.replace(setup, instrument=instrument)])
    h = identifiability.scaled(noisy, [series], noisy.nominal, "tolerance")
    scale = np.outer(m.tolerance, m.tolerance)
    return identifiability.posterior_covariance(h) * scale


def test_a_study_states_the_error_of_a_run_and_the_step_of_a_display():
    text = sample.changed(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlength_run_um = 1.0")
    )
    (setup,) = sample.resolved(text).setups.values()
    (channel,) = setup.instrument.channels
    assert setup.sigma == (pytest.approx(0.5e-6),)
    assert channel.shared * setup.sigma[0] == pytest.approx(1.0e-6)
    text = sample.changed(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlength_resolution_um = 6.0")
    )
    (setup,) = sample.resolved(text).setups.values()
    uniform = 6e-6 * (np.arange(10001) / 10000 - 0.5)
    assert setup.sigma[0] ** 2 == pytest.approx(0.25e-12 + uniform.var(), rel=1e-3)
    error = sample.refused(
        sample.STUDY, ("length_um = 0.5", "length_um = 0.5\nlenght_run_um = 1.0")
    )
    assert "length_run" in error.remedy


def test_a_stated_step_is_no_coarse_column():
    m = a3_plans.measurement()
    series = [a3_plans.circles(m, 10)]
    y = np.round(m.readings(series, m.nominal) + 3e-6 * np.arange(20), 5)
    assert copies.coarse_columns(checks.session_readings(m, series, y))
    setup = m.setups["cup"]
    channel = dataclasses.replace(setup.instrument.channels[0], resolution=1e-5)
    instrument = dataclasses.replace(setup.instrument, channels=(channel,))
    stated = m.with_setups([dataclasses.replace(setup, instrument=instrument)])
    assert not copies.coarse_columns(checks.session_readings(stated, series, y))
