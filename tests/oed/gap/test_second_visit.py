"""Second visits: the expected probability against closed forms, and what is advised."""

import functools

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from shipped_models import encoder_scale, gravity, planar_2dof, pose_tracker

from kernel.gap_lines import with_readings
from kernel.laws import STATED_LAW
from oed.gap import procedure
from oed.gap.before import second_visit
from oed.gap.before.second_visit import (
    AnswerForm,
    expected_probability,
    probability_now,
)
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import assemble
from oed.instrument import mount
from oed.measurement import Measurement

EFFECTS = (gravity.effect, encoder_scale.effect)
PRECISE = 1e4  #: a reading so precise that it fixes a coefficient at 1


def answer(name: str, probability: float, right: float = 1.0) -> AnswerForm:
    return AnswerForm((name,), probability, np.zeros((0, 1)), right)


def expected(forms, to_come, seed=3):
    """Expected probability where each has one coefficient, known to be 1."""
    taken = [np.array([[PRECISE]]) for _ in forms]
    readings = np.array([PRECISE])
    columns = [np.array(column)[:, None] for column in to_come]
    rng = np.random.default_rng(seed)
    return expected_probability(forms, taken, readings, columns, rng)


def test_unequal_answers_gain_as_bayes_theorem_says():
    """By integration over the readings to come of the larger of the two joint densities."""
    share, distance = 0.8, 2.5
    x = np.linspace(-10.0, 12.0, 20001)
    joint = [share * stats.norm.pdf(x), (1.0 - share) * stats.norm.pdf(x, loc=distance)]
    pair = [answer("a", share), answer("b", 1.0 - share)]
    found = expected(pair, [[0.0], [distance]])
    assert found == pytest.approx(np.trapezoid(np.maximum(*joint), x), abs=0.02)


def test_readings_that_do_not_separate_gain_nothing():
    pair = [answer("a", 0.6), answer("b", 0.4)]
    assert expected(pair, [[3.0], [3.0]]) == pytest.approx(0.6)


def test_forms_of_one_answer_count_together_and_what_is_unseen_stays_wrong():
    forms = [answer("a", 0.3), answer("a", 0.25), answer("b", 0.35)]
    assert probability_now(forms) == pytest.approx(0.55)
    nothing = [answer("a", 0.3), answer("", 0.7, right=0.5)]
    assert probability_now(nothing) == pytest.approx(0.35)


def test_an_unknown_coefficient_spreads_what_is_to_come():
    """By the ratio of two normals of standard deviations 1 and sqrt(1 + c^2)."""
    column = 6.0
    x = np.linspace(-60.0, 60.0, 40001)
    wide = 0.5 * stats.norm.pdf(x, scale=np.sqrt(1.0 + column**2))
    narrow = 0.5 * stats.norm.pdf(x)
    pair = [answer("a", 0.5), answer("b", 0.5)]
    none, slopes = np.zeros((1, 1)), [np.array([[column]]), np.array([[0.0]])]
    rng = np.random.default_rng(1)
    found = expected_probability(pair, [none, none], np.zeros(1), slopes, rng)
    assert found == pytest.approx(np.trapezoid(np.maximum(wide, narrow), x), abs=0.03)


# -- advice ----------------------------------------------------------------------------
@functools.cache
def unloaded(size: float = 10.0) -> Diagnosis:
    """Legs that yield under what moves, read without a payload: scale looks alike."""
    m = Measurement(planar_2dof.machine, [mount(pose_tracker.position, "tracker")])
    y = np.linspace(-1.2, 1.2, 12)
    lines = [np.column_stack([y, np.full(12, z)]) for z in (0.2, 0.7, 1.2)]
    labels = [f"line {k}" for k in range(3) for _ in y]
    series = m.series("tracker", np.vstack(lines), labels)
    order = np.tile(np.arange(12), 3)
    rows = pd.DataFrame(
        {"setup": "tracker", "run": labels, "order": order, "direction": 1.0}
    ).assign(payload=0.0, time=60.0 * np.arange(36.0))
    problem = assemble(m, [series], rows)
    form = problem.signature(gravity.effect, {"ratio": 0.3}, textbook=True)
    change = problem.noise_units(form.columns[:, 0])
    noise = np.random.default_rng(8).standard_normal(len(problem))
    problem = with_readings(problem, size * change + noise)
    return procedure.explain_residuals(problem, EFFECTS, law=STATED_LAW)


def test_what_was_not_read_under_load_is_to_be_read_under_load():
    diagnosis = unloaded()
    values = {"payload": [0.0, 1500.0]}
    candidates = second_visit.candidate_runs(diagnosis.problem, values)
    rng = np.random.default_rng(2)
    visit = second_visit.propose(diagnosis, EFFECTS, candidates, rng)
    poses = sum(len(run.command) for run in visit.runs)
    assert 0 < poses <= 0.25 * 36
    assert {run.condition["payload"] for run in visit.runs} == {1500.0}
    assert visit.probability_after > visit.probability_now
    assert len(visit.covariates) == poses


def test_candidates_are_the_paths_under_each_condition():
    """Three paths, at all or half of the poses, in two directions, with one payload."""
    candidates = second_visit.candidate_runs(unloaded().problem)
    assert len(candidates) == 3 * 2 * 2
    assert len({run.name for run in candidates}) == len(candidates)
    assert {run.condition["time"] for run in candidates} == {
        35 * 60.0 + second_visit.VISIT_DELAY
    }
    backwards = [run for run in candidates if run.condition["direction"] < 0]
    assert len(backwards) == 3 * 2


def test_a_doubt_calls_for_a_second_visit_and_a_clean_residual_does_not():
    assert second_visit.needs_second_visit(unloaded())
    assert not second_visit.needs_second_visit(unloaded(0.0))
