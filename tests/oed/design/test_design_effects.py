"""Designs that allow for effects, errors of a run or drawn machines, against all subsets."""

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
from oed.design import Candidates, Nuisances, Rules, SizeCurve, choose, robust
from oed.design.forms import Determinant, ExtremeEigenvalues, Variance
from oed.design.how_many import AccuracyGoal
from oed.design.rules import TimeBudget
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


def test_equal_readings_follow_the_square_root_law():
    """N readings leave 1 / sqrt(1 + N / 2) of each of two unit directions."""
    rows = np.tile(np.eye(2), (20, 1))[:, None, :]
    goal = AccuracyGoal(("a", "b"), np.eye(2)[:, None, :] / 0.43)
    problem = SizeCurve(rows, np.eye(2), goal, (0,))
    for point in problem.curve([2, 6, 12]):
        exact = 1.0 / np.sqrt(1.0 + point.size / 2) / 0.43
        assert point.accuracy == pytest.approx([exact, exact], rel=1e-9)
        # alone, a direction gets all readings
        assert point.bound == pytest.approx(
            np.full(2, 1.0 / np.sqrt(1.0 + point.size) / 0.43), rel=1e-3
        )
    fewest = problem.fewest(most=20)
    assert (
        fewest.size == 2 * int(np.ceil(1.0 / 0.43**2 - 1.0)) == 10
    )  # 1 + N / 2 >= 1 / 0.43^2
    assert fewest.at_least == 9  # half a reading of each more would do


def test_no_subset_beats_the_bounds_nor_the_fewest():
    rng = np.random.default_rng(0)
    rows, prior = rng.standard_normal((10, 1, 3)), np.eye(3)
    factors = rng.standard_normal((2, 2, 3))
    half = AccuracyGoal(("a", "b"), factors)
    scale = half.accuracy(
        prior + 0.4 * np.einsum("ckn,ckm->nm", rows, rows)
    )  # reachable with some of the ten
    goal = AccuracyGoal(("a", "b"), factors / scale[:, None, None])
    problem = SizeCurve(rows, prior, goal, (0,), rounds=6)

    def accuracies(size: int) -> np.ndarray:
        plans = [rows[list(s), 0] for s in itertools.combinations(range(10), size)]
        return np.array([goal.accuracy(prior + x.T @ x) for x in plans])

    for size in (3, 5):
        every, point = accuracies(size), problem.point(size)
        assert (every.min(axis=0) >= point.bound - 1e-9).all()
        assert point.accuracy.max() <= 1.02 * every.max(axis=1).min()
    fewest = problem.fewest(most=10)
    exact = next(n for n in range(1, 11) if (accuracies(n).max(axis=1) <= 1.0).any())
    assert fewest.at_least <= exact
    assert fewest.size in (exact, exact + 1)


def test_a_goal_out_of_reach_is_reported():
    rows = np.tile(np.eye(2), (3, 1))[:, None, :]
    fewest = SizeCurve(
        rows, np.eye(2), AccuracyGoal(("a", "b"), np.eye(2)[:, None, :] / 0.01), (0,)
    ).fewest(most=6)
    assert fewest.size is None
    assert not fewest.proven
    assert fewest.best.size == 6
    assert (fewest.best.bound > 1.0).all()
