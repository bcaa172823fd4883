"""Whole checks of an A3 head's readings: outliers, mistakes, and what stays unseen."""

import dataclasses
import functools

import blunder_machines as machines
import numpy as np
import pytest

from oed.checks import check, judgement
from oed.checks.blind import _is_whole, unseen_mistakes
from oed.checks.check import CheckedSession, _exchanged, check_session
from oed.checks.explain import Explanation, _log_of_poses_read
from oed.checks.findings import Severity
from oed.checks.judgement import Judgement
from oed.checks.mistakes import Suspect, trials
from oed.checks.mistakes.noise import _trend_p_value
from oed.checks.outliers import find_outliers
from oed.checks.session import SessionReadings
from oed.estimation import identify

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
