"""Whole checks of an A3 head's readings, and what they compute on their way."""

import dataclasses
import functools
import itertools
from types import SimpleNamespace
from typing import Any

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest

from oed.checks import check, copies, explain, judgement, outlier_odds, times
from oed.checks.blind import _is_whole, unseen_mistakes
from oed.checks.check import CheckedSession, _exchanged, check_session
from oed.checks.explain import Explanation, _log_of_poses_read
from oed.checks.findings import Severity
from oed.checks.fit import fit, fit_of_any_misfit
from oed.checks.judgement import Judgement, probability_of_strain
from oed.checks.mistakes import Suspect, sorting, trials
from oed.checks.mistakes.noise import _trend_p_value
from oed.checks.outlier_odds import FarReading, LeaveOneOut, alike_readings
from oed.checks.outliers import far_readings, find_outliers
from oed.checks.screening import linear_readings, log_evidence
from oed.checks.session import SessionReadings
from oed.estimation import identify
from oed.fit_limits import ALARM_PROBABILITY
from oed.noise import Noise

SIGMA = 0.5e-6


@functools.cache
def clean() -> SessionReadings:
    return machines.session("a3", machines.readings("a3", 3))


def of_one_bar() -> SessionReadings:
    """The readings of the first set-up: half of them."""
    (first, *_), m = clean().series, clean().measurement
    alone = m.with_setups([m.setups[first.setup]])
    part = clean().take(np.arange(len(first)))
    return dataclasses.replace(part, measurement=alone)


def checked(session: SessionReadings) -> CheckedSession:
    rng = np.random.default_rng(0)
    return check_session(session, session.measurement, rng)


def test_readings_of_the_stated_noise_have_no_fault():
    result = checked(clean())
    assert not result.bad_fit
    assert not result.mistaken
    assert result.set_aside == ()
    assert result.goodness.ratio == pytest.approx(1.0, abs=0.4)


def test_a_gross_error_is_set_aside_with_its_row():
    y = clean().y.copy()
    y[11] += 80.0 * SIGMA
    result = checked(clean().with_y(y))
    assert result.set_aside == (11,)
    assert result.doubtful_values.tolist() == [False] * (len(y) - 1)
    found = [f for f in result.findings if f.severity == Severity.OUTLIER]
    assert [f.rows for f in found] == [clean().rows([11])]
    assert not result.bad_fit


def exchanged(y: np.ndarray) -> tuple[int, int] | None:
    session = clean().with_y(y)
    outliers = find_outliers(session, np.empty(0, dtype=np.intp))
    assert {one.reading for one in outliers.far} == {4, 9}
    return _exchanged(session, outliers)


def test_two_readings_that_were_exchanged_are_named():
    y = clean().y.copy()
    y[[4, 9]] = y[[9, 4]]
    pair = exchanged(y)
    assert pair is not None
    assert set(pair) == {4, 9}


def test_two_gross_errors_are_not_said_to_be_exchanged():
    y = clean().y.copy()
    y[[4, 9]] += 80.0 * SIGMA, 130.0 * SIGMA
    assert exchanged(y) is None


def test_a_mirrored_head_passes_unnoticed():
    """Reversed psi, or legs 2 and 3 exchanged: a mirror image within the tolerances."""
    session = of_one_bar()
    measurement = session.measurement
    sentences = unseen_mistakes(session, measurement, np.random.default_rng(0))
    backward, psi, legs = sentences
    assert backward.endswith("are in reversed order after the first")
    assert psi == "the sign of psi_deg is reversed"
    assert legs.endswith("1 to 3 are 1, 3, 2")


def test_whole_mistakes_without_an_amount_are_all_there_alone():
    session = of_one_bar()
    suspects = [Suspect(session, whole=whole) for whole in (False, True)]
    found = [[t for t in trials(s) if _is_whole(t)] for s in suspects]
    every, fewer = ([t.text(t.amounts, t.amounts) for t in f] for f in found)
    # a length that the instrument keeps, for which another command is solved
    solved = [text for text in every if "is not what was driven" in text]
    assert [text for text in every if text not in solved] == fewer
    assert len(fewer) > 50


SCALE = Explanation("factor", "the bar is 1 % too long", 1.6, 1.0, 0.98)
SHIFT = Explanation("moved", "z_mm is 2 mm too low", 1.6, 1.6, 0.003)


def test_readings_are_mistaken_where_no_effect_is_likelier():
    """An unlikely mistake beside one that an effect mimics stops no diagnosis."""
    for explanations, mistaken in (
        ((SCALE, SHIFT), False),
        ((SCALE,), False),
        ((dataclasses.replace(SHIFT, probability=0.9), SCALE), False),
        ((SHIFT,), True),
        ((), False),
    ):
        session = CheckedSession(clean(), (), None, None, explanations)
        assert session.mistaken == mistaken


def test_a_mistake_that_the_law_holds_brings_no_unlikelier_one(monkeypatch):
    by_law = Judgement(None, None, sound=True, stated=False)
    measurement = clean().measurement
    for likely, expected in (([SCALE, SHIFT], []), ([SHIFT, SCALE], [SHIFT])):
        monkeypatch.setattr(check, "explain", lambda *_, some=likely, **__: some)
        assert check._explanations(clean(), measurement, by_law) == expected


def test_check_and_fit_judge_by_one_noise_law():
    """Of readings with run offsets: scale of single readings, error of a run."""
    one = machines.session("delta", machines.readings("delta", 3, "run offsets"))
    search = judgement.find_outliers(one, np.zeros(0, dtype=np.intp))
    law, _ = judgement.estimated_law(search.solution)
    estimate = identify(one.measurement, one.series, one.y, estimate_noise=True)
    posterior = estimate.noise_posterior
    fitted = posterior.prior.laws(posterior.mode[None])
    scales = [law.scale[name] for name in posterior.structure.names]
    assert scales == pytest.approx(fitted.scale[0].tolist(), rel=0.1)
    assert law.law.level[0] == pytest.approx(fitted.level[0], rel=0.2)
    assert fitted.level[0] > 0.9


def test_a_law_that_takes_a_misfit_keeps_the_ratio_to_the_stated_noise():
    """Three waves of five times the noise along each run: no finding, and no silence."""
    rows = machines.readings("a3", 3)
    phase = rows.groupby("run").cumcount() / rows.groupby("run").cumcount().max()
    rows["length_mm"] += 1e3 * 5.0 * SIGMA * np.sin(6.0 * np.pi * phase)
    checked = machines.check("a3", rows)
    assert checked.as_stated is not None
    assert checked.as_stated.p_high < ALARM_PROBABILITY
    assert checked.as_stated.ratio > 1.5
    assert not checked.goodness.too_large
    assert machines.check("a3", machines.readings("a3", 3)).as_stated is None


def test_no_sign_is_lost_where_none_is_known():
    """Heights of a nominal machine are zero: its noise does not tell their sign."""
    rows = machines.readings("delta", 0)
    probe = rows["setup"] == "probe"
    rows.loc[probe, "height_mm"] = rows.loc[probe, "height_mm"].abs().round(0)
    checked = machines.check("delta", rows)
    assert all("is lost" not in one.what for one in checked.explanations)


HALF, OTHER = np.arange(20), np.arange(20, 30)  #: readings of two parts of a set-up


def test_residuals_that_follow_the_pose_are_no_noise(rng):
    """By second-order polynomials; the level of the test is kept by noise alone."""
    commands = rng.uniform(-1.0, 1.0, (60, 3))
    bent = commands[:, 0] * commands[:, 1]
    assert _trend_p_value(commands, bent + 0.1 * rng.standard_normal(60)) < 1e-9
    levels = [_trend_p_value(commands, rng.standard_normal(60)) for _ in range(400)]
    assert 0.02 < np.mean(np.array(levels) < 0.05) < 0.09
    assert _trend_p_value(commands[:12], bent[:12]) == 1.0


def test_poses_in_a_smaller_unit_are_as_much_denser_where_they_were_read():
    """A printer reads the same everywhere, and its noise is in z."""
    rows = machines.readings("delta", 0)
    session = machines.session("delta", rows)
    assert _log_of_poses_read(session, [session]) == 0.0
    same = session.with_y(np.zeros(len(session)))
    moved = tuple(
        dataclasses.replace(s, command=s.command * [1.0, 1.0, 1e-3])
        for s in same.series
    )
    squeezed = dataclasses.replace(same, series=moved)
    varied = sum(len(s) for s in same.series if np.ptp(s.command[:, 2]) > 0.0)
    assert varied > 20
    expected = varied * np.log(1e-3)
    assert _log_of_poses_read(same, [squeezed]) == pytest.approx(expected)
    # of one set-up among others, its own readings alone
    first, *rest = same.series
    two = dataclasses.replace(same, series=(first.take(HALF), first.take(OTHER), *rest))
    part = dataclasses.replace(two, series=(moved[0].take(HALF), *two.series[1:]))
    expected = len(HALF) * np.log(1e-3)
    assert _log_of_poses_read(two, [part]) == pytest.approx(expected)


NOBODY = np.empty(0, dtype=np.intp)


@pytest.fixture(scope="module")
def session() -> SessionReadings:
    return machines.session("a3", machines.readings("a3", 3))


def spoiled(session: SessionReadings, errors: dict[int, float]) -> SessionReadings:
    """With errors, in sigma, of some readings."""
    y = session.y.copy()
    for reading, size in errors.items():
        y[reading] += size * SIGMA
    return session.with_y(y)


# -- ranges and readings that no instrument took ---------------------------------------
def test_ranges_are_those_of_drawn_machines(session, rng):
    ranges = session.predict_ranges(rng)
    m = session.measurement
    draws = m.nominal + m.tolerance * rng.standard_normal((400, len(m.nominal)))
    read = m.readings(session.series, draws)
    read = read + SIGMA * rng.standard_normal(read.shape)
    assert ranges.sd == pytest.approx(read.std(axis=0), rel=0.2)
    assert not ranges.outside(session.y).size
    far = session.y + np.where(np.arange(len(session)) == 5, 7.0 * ranges.sd, 0.0)
    assert ranges.outside(far).tolist() == [5]


def test_a_rounding_step_is_found(session):
    members = np.arange(len(session))
    rounded = session.with_y(np.round(session.y, 5))
    assert copies.resolution(rounded, members) == pytest.approx(1e-5)
    assert copies.resolution(session, members) == pytest.approx(1e-7)
    (coarse,) = copies.coarse_columns(rounded)
    assert (coarse.channel, len(coarse.readings)) == ("length", len(session))
    assert not copies.coarse_columns(session)


def test_equal_readings_at_other_poses_are_copies(session):
    y = session.y.copy()
    y[20:23] = y[20]
    (group,) = copies.equal_readings(session.with_y(y))
    assert group.readings == (20, 21, 22)
    assert not group.same_pose
    assert not copies.equal_readings(session)


def test_computed_readings_are_those_of_the_nominal_machine(session, rng):
    ranges = session.predict_ranges(rng)
    nominal = session.with_y(ranges.nominal)
    computed = copies.computed_readings(nominal, ranges.nominal, ranges.sd)
    assert len(computed) == len(session)
    assert not copies.computed_readings(session, ranges.nominal, ranges.sd).size


# -- outliers --------------------------------------------------------------------------
def test_the_best_set_is_the_best_of_all(rng):
    """By brute force over all sets of up to three of nine readings."""
    slopes = 3.0 * rng.standard_normal((9, 2))
    covariance = np.eye(9) + slopes @ slopes.T
    p = np.linalg.inv(covariance)
    residual = rng.standard_normal(9)
    residual[[2, 3]] += 9.0
    values, vectors = np.linalg.eigh(np.eye(9) - p)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    prediction = LeaveOneOut(
        p @ residual, np.diag(p).copy(), factor, Noise(np.ones(9)), np.arange(9)
    )
    gradient = p @ residual

    def gain(members: tuple[int, ...]) -> float:
        k = list(members)
        solved = np.linalg.solve(p[np.ix_(k, k)], gradient[k])
        return float(gradient[k] @ solved) - 9.0 * len(k)

    sets = [s for n in (1, 2, 3) for s in itertools.combinations(range(9), n)]
    found = outlier_odds.best_set(prediction, [4], limit=3.0)
    assert tuple(found) == max(sets, key=gain)


def test_gross_errors_are_found_and_measured(session):
    wrong = spoiled(session, {7: 60.0, 30: -45.0})
    found = find_outliers(wrong, NOBODY)
    assert found.readings == (7, 30)
    errors = [one.error for one in found.gross]
    assert errors == pytest.approx([60.0 * SIGMA, -45.0 * SIGMA], abs=5 * SIGMA)
    search = far_readings(wrong, NOBODY, 3, robust=False)
    assert sorted(search.readings) == [7, 30]


def far(reading: int, error: float, pull: float = 20.0) -> FarReading:
    return FarReading(reading, np.copysign(pull, error), error, reading)


def test_neighbours_off_alike_are_no_single_errors(session):
    three = [far(k, 1e-5) for k in (13, 14, 15)]
    assert alike_readings(session, three) == (13, 14, 15)
    assert alike_readings(session, three[:2]) == ()
    mixed = [far(13, 1e-5), far(14, -1e-5), far(15, 1e-5)]
    assert alike_readings(session, mixed) == ()
    beyond = [*three, far(40, 1e-5, pull=90.0)]
    assert alike_readings(session, beyond) == (13, 14, 15)


def test_a_large_misfit_is_fitted_at_its_own_scale(session):
    wrong = session.with_y(
        session.y + 1e-4 * np.sin(7.0 * np.arange(len(session)) ** 2)
    )
    fitted = fit_of_any_misfit(wrong, 100.0)
    assert fitted.scale / 2.0 <= fitted.remaining() <= 2.0 * fitted.scale
    assert fitted.scale > 20.0
    clean = fit_of_any_misfit(session, 100.0)
    assert clean.scale == 1.0


# -- judgement, priors, senses ---------------------------------------------------------
def test_strained_parameters_are_told_from_noise(rng):
    """Of residuals from the prior the probability is even; of ten times that it is 0."""
    slopes = 5.0 * rng.standard_normal((40, 6))
    strains = [
        slopes @ rng.standard_normal(6) + rng.standard_normal(40) for _ in range(60)
    ]
    usual = [probability_of_strain(slopes, strain) for strain in strains]
    assert 0.3 < np.mean(usual) < 0.7
    strained = slopes @ (10.0 * rng.standard_normal(6)) + rng.standard_normal(40)
    assert probability_of_strain(slopes, strained) < 1e-6


def test_one_channel_of_several_may_have_more_noise():
    """With thirty times the noise in one of six channels, by the exact law of its size."""
    rows = machines.readings("hexapod", 0)
    clean = fit(machines.session("hexapod", rows))
    rng = np.random.default_rng(3)
    rows["read_x_mm"] += 0.3 * rng.standard_normal(len(rows))
    spoiled = fit(machines.session("hexapod", rows))
    assert clean is not None
    assert spoiled is not None
    gain = []
    for solution in (clean, spoiled):
        linear = linear_readings(solution)
        gain.append(
            log_evidence(linear, solution.session, with_rivals=True)
            - log_evidence(linear, solution.session, with_rivals=False)
        )
    assert gain[0] < 1.0
    assert gain[1] > 100.0


def test_kinds_share_the_prior_evenly():
    def trial(kind: str, level: str, family: str = "") -> Any:
        scope = SimpleNamespace(level=level)
        return SimpleNamespace(kind=kind, scope=scope, family=family, log_prior=0.0)

    every = [
        trial("unit", "file"),
        trial("unit", "file"),
        trial("unit", "run"),
        trial("sign", "file"),
    ]
    shares = np.exp(explain.log_priors(every)) / explain.MISTAKE_PROBABILITY
    assert shares == pytest.approx([1 / 8, 1 / 8, 1 / 4, 1 / 2])


# -- clocks ----------------------------------------------------------------------------
def run(name: str, seconds: list[float]) -> times.TimedRun:
    count = len(seconds)
    joints = np.linspace(0.0, 1.0, count)[:, None]
    return times.TimedRun("s", name, np.arange(count) + 2, np.array(seconds), joints)


#: five values are in order by chance once in 60, up or down; of 401 an assignment is slow
LEAST, MOST = 5, 400


@pytest.fixture(scope="module")
def long_run() -> SessionReadings:
    """One run of more readings than are looked at: a circle again and again."""
    circle = machines.readings("a3", 0).iloc[: machines.POINTS]
    times = 1 + MOST // len(circle)
    rows = pd.concat([circle] * times, ignore_index=True)
    rows["order"] = np.arange(1, 1 + len(rows))
    return machines.session("a3", rows)


@pytest.mark.parametrize(("count", "is_looked_at"), [
    (LEAST - 1, False), (LEAST, True), (MOST, True), (MOST + 1, False),
])  # fmt: skip
def test_from_five_to_four_hundred_sorted_readings_are_looked_at(
    long_run, count, is_looked_at
):
    part = long_run.take(np.arange(count))
    rising = part.with_y(np.sort(part.y) + 1e-6 * np.arange(count))
    trials = list(sorting.trials(Suspect(rising)))
    assert bool(trials) == is_looked_at
    assert {t.kind for t in trials} == ({"sorting"} if is_looked_at else set())
