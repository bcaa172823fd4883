"""Equivalence classes of an A3, and second visits that tell them apart."""

import dataclasses
import functools

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from shipped_models import (
    a3_head,
    ball_bar,
    encoder_scale,
    gravity,
    planar_2dof,
    pose_tracker,
)

from kernel import a3_plans, gap_a3
from kernel.gap_lines import search_of, with_readings
from kernel.laws import STATED_LAW
from oed.gap import procedure
from oed.gap.before import second_visit
from oed.gap.before.second_visit import (
    AnswerForm,
    expected_probability,
    probability_now,
)
from oed.gap.cause import compare
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem, assemble
from oed.instrument import Setup, mount
from oed.measurement import Measurement, commands_at_fixed_reading

POINTS = 12
STROKES = np.linspace(0.0, 0.2, 9)


Bar = tuple[str, float, float]  #: name, length and tool (m) of a bar's set-up
ONE: tuple[Bar, ...] = (("a", 0.3, 0.0),)
TOOLS: tuple[Bar, ...] = (*ONE, ("b", 0.3, 0.1))


def mounted(name: str, length: float, tool: float) -> Setup:
    teach, offset = (1.286 + tool, 0.0, 0.0), (0.0, 0.0, tool)
    return mount(ball_bar.instrument, name, teach=teach, length=length, tool=offset)


@functools.cache
def readings(bars: tuple[Bar, ...]) -> GapProblem:
    """Circles at all heights that each bar reaches; residuals of zero."""
    m = Measurement(a3_head.machine, [mounted(*b) for b in bars])
    series, rows = [], []
    for name, setup in m.setups.items():
        commands, runs = [], []
        for stroke in STROKES:
            z = a3_plans.HOME_Z + setup.tool[2] + stroke
            psi = 2 * np.pi * np.arange(POINTS) / POINTS
            command, possible = commands_at_fixed_reading(
                m, name, np.column_stack([0 * psi + z, psi, 0 * psi]), "theta"
            )
            if possible.all():
                commands.append(command)
                runs += [f"{name} {stroke:.3f} m"] * POINTS
        series.append(m.series(name, np.vstack(commands), run=runs))
        rows += [
            {"setup": name, "run": r, "order": 1 + k % POINTS, "direction": 1}
            for k, r in enumerate(runs)
        ]
    return assemble(m, series, pd.DataFrame(rows))


def metric(p: GapProblem) -> np.ndarray:
    """M (N, N) of independent noise of the stated size."""
    return np.linalg.inv(np.eye(len(p)) + p.slopes @ p.slopes.T)


EFFECTS = (gap_a3.encoder_scale, gap_a3.bar_length, gap_a3.gravity)


def searched(p, effect, size, seed=4):
    """The search where a bar or a common scale acts; the right hypothesis."""
    acting_effect = next(e for e in EFFECTS if e.name == effect)
    change = gap_a3.noise_columns(p, acting_effect)[0].sum(axis=1)
    change = change * size / np.sqrt(change @ metric(p) @ change)
    noise = np.random.default_rng(seed).standard_normal(len(p))
    acting = p.with_residual(change + noise)
    search = search_of(acting, EFFECTS)
    hypothesis = search.fit((effect,), (search.library.atoms_of(effect)[0],), (1.0,))
    return search, hypothesis


def dense(p, search, h, rival):
    """lambda_k|j and lambda_k of the posterior mean, for the form that absorbs most."""
    m = metric(p)
    mine = search.library.columns.take(search.library.atoms[h.atoms[0]].columns)
    inner = mine.T @ m @ mine + np.eye(mine.shape[1]) / h.sizes[0] ** 2
    y = mine @ np.linalg.solve(inner, mine.T @ m @ search.problem.residual)
    energies = [y @ m @ y]
    for atom in search.library.atoms_of(rival):
        g = search.library.columns.take(search.library.atoms[atom].columns)
        cross = g.T @ m @ y
        ridge = g.T @ m @ g + np.eye(g.shape[1]) / compare.MAX_RIVAL_SIZE**2
        energies.append(y @ m @ y - cross @ np.linalg.solve(ridge, cross))
    return min(energies), energies[0]


@pytest.mark.parametrize("size", [4.0, 12.0, 25.0, 60.0])
@pytest.mark.parametrize("effect", ["encoder_scale", "bar_length"])
@pytest.mark.parametrize("tools", [1, 2])
def test_a_class_is_what_the_dense_formula_says(tools, effect, size):
    """With every rival's evidence near, and with none near."""
    p = readings(TOOLS if tools == 2 else ONE)
    search, h = searched(p, effect, size)
    rivals = [e.name for e in EFFECTS if e.name != effect]
    energies = {r: dense(p, search, h, r) for r in rivals}
    for near in (True, False):
        scores = {
            (frozenset({r}), False): h.score - (1.0 if near else 100.0) for r in rivals
        }
        ((first, *others),) = compare.equivalent_effects(search, h, scores, 3.0)
        assert first == effect
        for r in rivals:
            lam, whole = energies[r]
            same = lam < compare.EXACT_SHARE * whole or (
                near and lam < compare.MIN_DISTINCT**2
            )
            assert (r in others) == same, (r, lam, whole)


@pytest.mark.parametrize("behind", [2.0, 10.0, 20.0, 1e4])
@pytest.mark.parametrize("size", [8.0, 60.0])
def test_a_rival_of_its_family_is_in_a_class_as_far_as_forms_depart(size, behind):
    """Half of sqrt(lambda): a quarter of lambda, and an eighth of it in nats."""
    p = readings(TOOLS)
    search, h = searched(p, "encoder_scale", size)
    rivals = [e.name for e in EFFECTS if e.name != "encoder_scale"]
    scores = {(frozenset({r}), False): h.score - behind for r in rivals}
    alone = compare.equivalent_effects(search, h, scores, 3.0)[0]
    families = {e.name: "alike" for e in EFFECTS}
    search.library = dataclasses.replace(search.library, families=families)
    members = compare.equivalent_effects(search, h, scores, 3.0)[0]
    for r in rivals:
        lam, whole = dense(p, search, h, r)
        odds = (
            search.fit((r,), (search.library.atoms_of(r)[0],), (1.0,)).score - h.score
        )
        near = min(behind, -odds) < max(compare.PRIOR_LOG_ODDS, whole / 8.0)
        by_form = near and lam < max(compare.MIN_DISTINCT**2, 0.25 * whole)
        assert (r in members) == (r in alone or by_form), (r, lam, whole)


@pytest.mark.parametrize("truth", ["encoder_scale", "bar_length"])
@pytest.mark.parametrize("size", [8.0, 60.0])
def test_one_tool_keeps_both_whichever_is_likelier(truth, size):
    """With one tool only the odds beforehand speak for one of the two."""
    search, _ = searched(readings(ONE), truth, size)
    hypotheses = {
        n: search.fit((n,), (search.library.atoms_of(n)[0],), (1.0,))
        for n in (e.name for e in EFFECTS)
    }
    best = max(
        (hypotheses[n] for n in ("encoder_scale", "bar_length")), key=lambda h: h.score
    )
    (members,) = compare.equivalent_effects(
        search, best, {h.key: h.score for h in hypotheses.values()}, 3.0
    )
    assert {"encoder_scale", "bar_length"} <= set(members)


RIVALS = (gravity.effect, encoder_scale.effect)
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
    return procedure.explain_residuals(problem, RIVALS, law=STATED_LAW)


def test_what_was_not_read_under_load_is_to_be_read_under_load():
    diagnosis = unloaded()
    values = {"payload": [0.0, 1500.0]}
    candidates = second_visit.candidate_runs(diagnosis.problem, values)
    rng = np.random.default_rng(2)
    visit = second_visit.propose(diagnosis, RIVALS, candidates, rng)
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
