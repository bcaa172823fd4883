"""The gate: the scan over places has a say where the evidence would have no gap, and
nowhere else.
"""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from kernel import gap_problem as case
from kernel.gap_lines import EFFECTS, readings
from kernel.gap_problem import Machines
from oed.gap import diagnose as diagnosing
from oed.gap.cause import gate
from oed.gap.cause import searches as searching
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import UNKNOWN
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.gap.forms.processes.catalogue import PROCESSES
from oed.gap.place import locate
from oed.noise.law import stated_law

BLANK = {
    "atoms": (),
    "sizes": (),
    "process": None,
    "process_size": 0.0,
    "log_prior": 0.0,
}


@pytest.fixture(scope="module")
def machines() -> Machines:
    problem = case.circles()
    return Machines(problem, case.law(problem))


def test_a_p_value_says_no_more_than_its_bound() -> None:
    """The bound is the largest of all Bayes factors of densities a p^(a - 1) against
    the uniform.
    """
    a = np.linspace(1e-4, 1.0, 200_001)
    for p in (1e-4, 1e-3, 0.01, 0.04):
        assert gate.bayes_factor(p) == pytest.approx(
            float((a * p ** (a - 1.0)).max()), rel=1e-6
        )
    assert gate.bayes_factor(gate.SIGNIFICANT) == gate.bayes_factor(1.0) == 1.0
    for p in (0.0, -0.1, 1.1, float("nan")):
        with pytest.raises(ValueError, match="p-value"):
            gate.bayes_factor(p)


def test_the_least_p_value_is_uniform_without_a_gap_and_small_where_one_leg_is_off(
    machines: Machines,
) -> None:
    problem, law, rng = machines.problem, machines.law, np.random.default_rng(8)
    one = case.in_joint(problem, 1, _along(problem))

    def p(size: float) -> float:
        noise = machines.root @ rng.standard_normal(len(problem))
        gap = case.sized(one, machines.covariance, size) if size else 0.0
        return locate.least_p_value(
            problem.with_residual(noise + gap), law, rng, draws=200
        )

    healthy = [p(0.0) for _ in range(40)]
    assert stats.kstest(healthy, "uniform").pvalue > 0.01
    assert max(p(9.0) for _ in range(5)) < 0.01


def test_the_least_p_value_is_that_of_the_places_told(machines: Machines) -> None:
    problem, rng = machines.problem, np.random.default_rng(4)
    shifted = case.sized(
        case.in_joint(problem, 1, _along(problem)), machines.covariance, 5.5
    )
    problem = problem.with_residual(
        machines.root @ rng.standard_normal(len(problem)) + shifted
    )
    blocks = locate.locate(problem, machines.law, np.random.default_rng(1), draws=100)
    least = locate.least_p_value(
        problem, machines.law, np.random.default_rng(1), draws=100
    )
    assert blocks[0].block == "leg 2"
    assert 0.0 < least < 0.05
    assert least == pytest.approx(blocks[0].p_value)


def _along(problem: GapProblem) -> np.ndarray:
    """A half wave of leg 2 over its travel, at each pose."""
    (state,) = problem.states
    q = state.joints[:, 1]
    return np.cos(np.pi * (q - q.min()) / np.ptp(q))


@pytest.mark.parametrize(
    ("none", "p", "asked", "gap_first"),
    [
        (0.8, 0.01, True, True),
        (0.8, 0.2, True, False),
        (0.8, 0.049, True, False),
        (0.3, 0.001, False, True),
    ],
)
def test_only_where_none_would_be_told_its_odds_are_divided(
    monkeypatch: pytest.MonkeyPatch, none: float, p: float, asked: bool, gap_first: bool
) -> None:
    problem, calls = readings(1), []

    def least(*given: object) -> float:
        calls.append(given)
        return p

    monkeypatch.setattr(locate, "least_p_value", least)
    monkeypatch.setattr(Search, "noise_level", lambda search, h: 1.7)
    before = np.array([none, 0.75 * (1.0 - none), 0.25 * (1.0 - none)])
    hypotheses = [
        Hypothesis(effects=(), unknown=k > 0, log_evidence=float(np.log(s)), **BLANK)
        for k, s in enumerate(before)
    ]
    hypotheses[2] = dataclasses.replace(
        hypotheses[2], effects=("slip",), atoms=(0,), sizes=(1.0,)
    )
    search = Search(
        problem,
        library.build(problem, EFFECTS),
        library.build(problem, PROCESSES[:1]),
        stated_law(problem),
        0.0,
    )
    after = gate.reweigh([search], hypotheses, before, np.random.default_rng(1))
    factor = gate.bayes_factor(p) if asked else 1.0
    assert len(calls) == asked
    assert all(call[1].level == 1.7 for call in calls)
    assert after.sum() == pytest.approx(1.0)
    assert after[0] / (1.0 - after[0]) == pytest.approx(none / (1.0 - none) / factor)
    assert after[1] / after[2] == pytest.approx(before[1] / before[2])
    first = diagnosing.conclude(problem, [search], hypotheses, EFFECTS, shares=after)[
        0
    ].answers[0]
    assert (first.effects == (UNKNOWN,)) == gap_first


def test_the_gate_leaves_the_draws_of_what_comes_after_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(3)
    problem = readings(8)
    problem = problem.with_residual(rng.standard_normal(len(problem)))
    monkeypatch.setattr(searching, "PROCESSES", PROCESSES[:2])
    monkeypatch.setattr(
        searching, "_add_located", lambda processes, problem, law: processes
    )
    diagnoses = {}
    for p in (0.9, 1e-12):
        monkeypatch.setattr(locate, "least_p_value", lambda *given, p=p: p)
        diagnoses[p] = diagnosing.diagnose(
            problem, EFFECTS, np.random.default_rng(0), law=stated_law(problem)
        )
    assert diagnoses[0.9].verdict == "none"
    assert diagnoses[0.9].where == ()
    assert diagnoses[1e-12].verdict != "none"
    assert diagnoses[1e-12].marginal.keys() == diagnoses[0.9].marginal.keys()
    assert sum(a.probability for a in diagnoses[1e-12].answers) == pytest.approx(
        1.0, abs=0.02
    )
