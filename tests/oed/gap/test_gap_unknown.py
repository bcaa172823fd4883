"""An unknown with an effect in an adapted form, an unknown alone, errors that come back."""

import numpy as np
import pytest

from kernel import gap_problem
from kernel.gap_lines import EFFECTS, readings, search_of
from kernel.gap_unknown import orthogonal_sum, smooth, some, terms
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data import evidence
from oed.gap.forms import discrepancy, library

SIZE = 40.0  #: root of the energy that is planted


def test_an_effect_in_a_form_of_its_own_is_named_beside_the_unknown():
    problem, rng = readings(20), np.random.default_rng(20)
    known, processes = library.build(problem, EFFECTS), smooth(problem)
    whole = max((known.atoms[k].columns for k in known.atoms_of("bow")), key=len)
    book = known.columns.take(whole) @ np.array([1.0, -0.6])
    departure = some(processes, "an error of the joints", rng)
    change = orthogonal_sum(
        problem, [book, departure], [0.75 * SIZE**2, 0.25 * SIZE**2]
    )
    acting = problem.with_residual(problem.residual + change)
    best = compare([search_of(acting, processes=processes)])[0]
    assert best.key == (frozenset({"bow"}), True)


def test_a_process_that_is_like_no_effect_is_unknown_alone():
    problem, rng = readings(21), np.random.default_rng(21)
    processes = smooth(problem)
    part = some(processes, "an error of the readings over the workspace", rng)
    change = orthogonal_sum(problem, [part], [SIZE**2])
    acting = problem.with_residual(problem.residual + change)
    best, *_ = compare([search_of(acting, processes=processes)])
    assert best.key == (frozenset(), True)


class _FixedSearch:
    """A search with given hypotheses."""

    def __init__(self, *hypotheses: Hypothesis) -> None:
        self._hypotheses = hypotheses

    def run(self) -> list[Hypothesis]:
        return list(self._hypotheses)


def _says(effects: tuple[str, ...], unknown: bool, log_evidence: float) -> Hypothesis:
    return Hypothesis(effects, unknown, (), (), None, 0.0, log_evidence, -1.0)


def test_evidence_is_the_sum_over_laws_and_the_form_that_of_the_best():
    first = [_says((), False, -9.0), _says((), True, np.log(0.2))]
    second = [_says((), True, np.log(0.3)), _says(("a",), False, -2.0)]
    by_key = {h.key: h for h in compare([_FixedSearch(*first), _FixedSearch(*second)])}  # type: ignore[list-item]
    unknown = by_key[frozenset(), True]
    assert unknown.log_evidence == pytest.approx(np.log(0.5))
    assert unknown.score == pytest.approx(np.log(0.5) - 1.0)
    assert unknown.law == 1
    assert by_key[frozenset(), False].log_evidence == -9.0
    assert len(by_key) == 3


@pytest.mark.parametrize("timed", [True, False])
def test_what_settles_is_found_by_the_order_of_the_readings_where_no_time_is_told(
    timed,
):
    problem = readings(12, timed=timed)
    gone = np.arange(len(problem)) / len(problem)
    fade = np.where(problem.rows["channel"] == "dz", 5.0 * np.exp(-gone / 0.15), 0.0)
    acting = problem.with_residual(problem.residual + fade)
    processes = discrepancy.build(problem)
    best = compare([search_of(acting, (), processes)])[0]
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert "time" in processes.atoms[best.process].effect
    still = compare([search_of(problem, (), processes)])[0]
    assert still.key == (frozenset(), False)


@pytest.mark.parametrize("back", [True, False])
def test_what_is_the_same_whenever_the_machine_is_there_is_a_gap_and_what_is_not_is_noise(
    back,
):
    """An error of each circle, read both ways, twice; or another one in each run."""
    rng, one = np.random.default_rng(8), gap_problem.circles(passes=2)
    state, read = one.states[0], one.series[0].index[:, 0]
    place = np.column_stack([np.cos(3.0 * state.phase), np.sin(5.0 * state.phase)])[
        read
    ]
    sizes = rng.standard_normal((3 if back else len(one.members), 2))
    change = np.zeros(len(one))
    for number, members in enumerate(one.members):
        change[members] = place[members] @ sizes[(number % 6) // 2 if back else number]
    acting = one.with_residual(rng.standard_normal(len(one)) + 3.0 * change)
    none = library.build(acting, ())
    processes = terms(acting, "over the workspace")
    posteriors = [
        evidence.posterior(acting, evidence.compress(acting, columns))
        for columns in ((), processes.columns.some(processes.atoms[0].columns, 3.0))
    ]
    pairs = evidence.mixture(acting, posteriors)
    ranked = compare([Search(acting, none, processes, *pair) for pair in pairs])
    mode = posteriors[0].mode.law
    assert np.sqrt(mode.correlated[0]) + mode.seat[0] > 0.5
    assert ranked[0].unknown == back
