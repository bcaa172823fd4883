"""Hypotheses by withheld runs and evidence together, against dense covariances."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from msgspec.structs import replace
from scipy import stats

from kernel.gap_lines import BOW, EFFECTS, planted, readings, search_of, smooth
from kernel.laws import STATED_LAW, noise_covariance
from oed.gap import diagnose
from oed.gap.cause import closure, withheld
from oed.gap.cause.compare import probabilities, without_implausible
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data.evidence import LEVEL_RATE, LEVEL_SHAPE
from oed.result import ClosureRecord


def _bowed(strength: float) -> Search:
    problem = planted(readings(5), BOW, {"leg 1": strength}, turns=2.0)
    return search_of(problem, processes=smooth(problem))


def _preferred(search: Search, name: str, lead: float) -> list[Hypothesis]:
    """An effect at an absurd size, ahead of all that the search takes for likely."""
    ranked = [h for h in search.run() if name not in h.effects or h.unknown]
    first = next(h for h in search.run() if h.effects == (name,) and not h.unknown)
    score = ranked[0].score + lead
    absurd = dataclasses.replace(
        first, sizes=(1e5,), log_evidence=score - first.log_prior
    )
    return [absurd, *ranked]


def _log_odds_of_a_gap(hypotheses: list[Hypothesis]) -> float:
    none = next(h for h in hypotheses if not h.is_gap)
    return np.logaddexp.reduce([h.score for h in hypotheses if h.is_gap]) - none.score


def test_an_effect_that_predicts_nonsense_does_not_lead():
    search = _bowed(2.0)
    hypotheses = _preferred(search, "slip", 5.0)
    assert probabilities(hypotheses)[0] > 0.99
    pooled = withheld.pooled([search], hypotheses)
    assert pooled[0].effects == ("bow",)
    assert _log_odds_of_a_gap(pooled) == pytest.approx(_log_odds_of_a_gap(hypotheses))
    assert {h.key for h in pooled} == {h.key for h in hypotheses}


@pytest.mark.parametrize("limit", [1e4, 10.0])
def test_a_name_at_a_size_that_no_machine_has_gives_its_probability_to_an_unknown(
    limit,
):
    search = _bowed(20.0)
    library = search.library
    search.library = dataclasses.replace(library, limits=[limit] * len(library.names))
    hypotheses = search.run()
    assert hypotheses[0].effects == ("bow",)
    ranked, left_out = without_implausible([search], hypotheses)
    before, after = ({h.key: h.score for h in hs} for hs in (hypotheses, ranked))
    assert np.logaddexp.reduce(list(after.values())) == pytest.approx(
        np.logaddexp.reduce(list(before.values()))
    )
    if limit == 1e4:
        assert (ranked, left_out) == (hypotheses, ())
        return
    assert left_out == ("bow",)
    assert (ranked[0].effects, ranked[0].unknown) == ((), True)
    assert probabilities(ranked)[0] > 0.9
    assert after[frozenset({"bow"}), False] == -np.inf


@pytest.mark.parametrize("is_confirmed", [True, False])
def test_a_name_far_beyond_its_expected_size_needs_withheld_runs(is_confirmed):
    search = _bowed(50.0)
    with_bow = 1.0 if is_confirmed else -1.0
    hypotheses = [
        dataclasses.replace(h, log_prediction=with_bow if "bow" in h.effects else 0.0)
        for h in search.run()
    ]
    assert hypotheses[0].effects == ("bow",)
    ranked, left_out = without_implausible([search], hypotheses)
    assert left_out == (() if is_confirmed else ("bow",))
    assert (ranked[0].effects == ("bow",)) == is_confirmed


@pytest.mark.parametrize(("value", "is_named"), [(-0.9, True), (-1.1, False)])
def test_names_whose_correction_doubles_the_withheld_error_are_refuted(
    value, is_named, monkeypatch
):
    score = closure.closure

    def scored(*given: Any, split: str) -> ClosureRecord:
        record = score(*given, split=split)
        return replace(record, value=value if split == "within" else record.value)

    monkeypatch.setattr(closure, "closure", scored)
    search = _bowed(2.0)
    rng = np.random.default_rng(0)
    diagnosis = diagnose(search.problem, EFFECTS, rng, law=STATED_LAW)
    first = diagnosis.answers[0].effects
    assert (first, diagnosis.left_out) == (
        (("bow",), ()) if is_named else (("unknown",), ("bow",))
    )


def test_what_is_alone_among_gaps_is_as_it_was():
    search = _bowed(2.0)
    both = [h for h in search.run() if h.effects in ((), ("bow",)) and not h.unknown]
    assert withheld.pooled([search], both) == both


def test_withheld_runs_are_predicted_as_by_conditioning():
    """Student's density of a fold given all others, from dense covariances."""
    search = _bowed(1.0)
    problem, h = search.problem, search.run()[0]
    columns = np.hstack([problem.slopes, h.columns(search.library, search.processes)])
    covariance = noise_covariance(problem, STATED_LAW) + columns @ columns.T
    folds = [members for members in problem.members[:3]]
    expected = []
    for fold in folds:
        rest = np.setdiff1d(np.arange(len(problem)), fold)
        gain = np.linalg.solve(
            covariance[np.ix_(rest, rest)], covariance[np.ix_(rest, fold)]
        )
        mean = problem.residual[rest] @ gain
        spread = covariance[np.ix_(fold, fold)] - covariance[np.ix_(fold, rest)] @ gain
        energy = problem.residual[rest] @ np.linalg.solve(
            covariance[np.ix_(rest, rest)], problem.residual[rest]
        )
        freedom = 2.0 * LEVEL_SHAPE + len(rest)
        level = (2.0 * LEVEL_RATE + energy) / freedom
        density = stats.multivariate_t(mean, level * spread, freedom)
        expected.append(density.logpdf(problem.residual[fold]))
    others = [np.setdiff1d(np.arange(len(problem)), fold) for fold in folds]
    assert withheld.log_withheld(search, h, others) == pytest.approx(expected)


def test_powers_are_those_of_a_sum_over_hypotheses():
    """Three hypotheses and two folds, by the definition."""
    prior = np.array([0.5, 0.3, 0.2])
    by_fold = np.log([[4.0, 1.0], [1.0, 3.0], [2.0, 2.0]])
    evidence = np.array([6.0, 1.0, 5.0])
    expected = np.ones(len(withheld.POWERS))
    for fold in range(2):
        others = evidence / np.exp(by_fold[:, fold])
        for k, power in enumerate(withheld.POWERS):
            share = prior * others**power
            expected[k] *= share @ np.exp(by_fold[:, fold]) / share.sum()
    expected /= expected.sum()
    powers = withheld.log_powers(np.log(prior), np.log(evidence), by_fold)
    assert np.exp(powers) == pytest.approx(expected)
    mixture = np.zeros(3)
    for weight, power in zip(expected, withheld.POWERS, strict=True):
        share = prior * evidence**power
        mixture += weight * share / share.sum()
    posterior = withheld.log_posterior(np.log(prior), np.log(evidence), powers)
    assert np.exp(posterior) == pytest.approx(mixture)
