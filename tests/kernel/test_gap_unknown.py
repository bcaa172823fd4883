"""An unknown with an effect in an adapted form, an unknown alone, errors that come back."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from kernel import gap_problem
from kernel.gap_lines import EFFECTS, readings
from kernel.gap_unknown import SMOOTH, orthogonal_sum
from oed.gap.cause import compare as comparing
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data import noise
from oed.gap.forms import library
from oed.gap.forms.library import Library
from oed.gap.forms.processes.catalogue import PROCESSES
from oed.noise import estimate
from oed.noise.law import stated_law

#: root of the energy that is planted
SIZE = 40.0


def _some(processes: Library, name: str, rng: np.random.Generator) -> np.ndarray:
    """A draw (N,) of a process."""
    chosen = processes.columns[:, processes.atoms[processes.atoms_of(name)[0]].columns]
    return np.asarray(chosen @ rng.standard_normal(chosen.shape[1]))


@pytest.mark.parametrize("seed", [20, 21, 24])
def test_an_effect_in_a_form_of_its_own_is_named_beside_the_unknown(seed: int) -> None:
    problem, rng = readings(seed), np.random.default_rng(seed)
    known, processes = library.build(problem, EFFECTS), library.build(problem, SMOOTH)
    whole = max((known.atoms[k].columns for k in known.atoms_of("bow")), key=len)
    book, departure = (
        known.columns[:, whole] @ np.array([1.0, -0.6]),
        _some(processes, "over the travel", rng),
    )
    change = orthogonal_sum(
        problem, [book, departure], [0.75 * SIZE**2, 0.25 * SIZE**2]
    )
    acting = problem.with_residual(problem.residual + change)
    best = compare([Search(acting, known, processes, stated_law(problem), 0.0)])[0]
    assert best.key == (frozenset({"bow"}), True)
    assert best.share == pytest.approx(0.75, abs=0.15)


@pytest.mark.parametrize("seed", [20, 21, 24])
def test_a_process_that_is_like_no_effect_is_unknown_alone(seed: int) -> None:
    problem, rng = readings(seed), np.random.default_rng(seed)
    known, processes = library.build(problem, EFFECTS), library.build(problem, SMOOTH)
    change = orthogonal_sum(
        problem, [_some(processes, "over the pose", rng)], [SIZE**2]
    )
    acting = problem.with_residual(problem.residual + change)
    best, *others = compare(
        [Search(acting, known, processes, stated_law(problem), 0.0)]
    )
    assert best.key == (frozenset(), True)
    shares = [h.share for h in others if h.unknown]
    assert shares
    assert max(shares) < 0.35


def test_odds_of_an_effect_rise_with_its_share() -> None:
    log_odds = [comparing._log_odds(float(s)) for s in np.linspace(-3.0, 4.0, 141)]
    assert (np.diff(log_odds) >= 0.0).all()
    assert (min(log_odds), max(log_odds)) == (-comparing.STEEPEST, comparing.STEEPEST)
    assert comparing._log_odds(comparing.EVEN) == 0.0
    assert comparing._log_odds(comparing.EVEN + 0.1) == pytest.approx(
        0.1 * comparing.SLOPE
    )


class _FixedSearch:
    """A search with given hypotheses."""

    def __init__(self, *hypotheses: Hypothesis) -> None:
        self._hypotheses = hypotheses

    def run(self) -> list[Hypothesis]:
        return list(self._hypotheses)


def _says(
    effects: tuple[str, ...], unknown: bool, score: float, share: float = 1.0
) -> Hypothesis:
    return Hypothesis(effects, unknown, (), (), None, 0.0, score, 0.0, share=share)


@pytest.mark.parametrize("share", [0.1, 0.4, 0.7, 0.99])
def test_an_unknown_alone_is_held_against_the_best_effect_by_its_share(
    share: float,
) -> None:
    """Odds in the effect's favour cost the unknown alone, odds against it the effect;
    nothing else moves.
    """
    odds, first = (
        8.0 * (share - 0.4),
        [_says((), False, -9.0), _says((), True, 0.0), _says(("a",), False, -1.0)],
    )
    first += [_says(("a",), True, 0.0, share), _says(("b",), True, -30.0, 0.9)]
    second = [_says(("a",), False, -0.5), _says((), True, -2.0)]
    by_key = {h.key: h for h in compare([_FixedSearch(*first), _FixedSearch(*second)])}  # type: ignore[list-item]
    assert by_key[frozenset(), True].score == pytest.approx(-max(odds, 0.0))
    assert by_key[frozenset({"a"}), True].score == pytest.approx(min(odds, 0.0))
    assert by_key[frozenset({"b"}), True].score == -30.0
    assert (
        by_key[frozenset({"a"}), False].score,
        by_key[frozenset({"a"}), False].law,
    ) == (
        -0.5,
        1,
    )
    assert by_key[frozenset(), False].score == -9.0
    assert len(by_key) == 5


@pytest.mark.parametrize(
    ("least", "worth"), [(1.0, 0.0), (0.1, 0.0), (0.05, -1.0), (0.0, -2.0)]
)
def test_an_effect_that_explains_next_to_nothing_is_less_likely(
    least: float, worth: float
) -> None:
    pair = dataclasses.replace(_says(("a", "b"), False, 0.0), least_share=least)
    by_key = {
        h.key: h
        for h in compare(
            [_FixedSearch(_says((), False, -9.0), _says(("a",), False, -1.0), pair)]
        )
    }  # type: ignore[list-item]
    assert by_key[frozenset({"a", "b"}), False].score == pytest.approx(worth)
    assert by_key[frozenset({"a"}), False].score == -1.0


@pytest.mark.parametrize(("small", "wanted"), [(0.2, 0.04 / 1.04), (1.0, 0.5)])
def test_the_least_share_is_what_is_lost_without_it(
    small: float, wanted: float
) -> None:
    """Of two effects whose parts of the residual do not overlap, by their energies."""
    problem, law = readings(5), stated_law(readings(5))
    known = library.build(problem, EFFECTS)
    one, two = (
        max((known.atoms[k].columns for k in known.atoms_of(n)), key=len)
        for n in ("bow", "slip")
    )
    parts = [known.columns[:, c] @ np.array([1.0, -0.6]) for c in (one, two)]
    whole = problem.with_residual(
        orthogonal_sum(problem, parts, [SIZE**2, (small * SIZE) ** 2])
    )
    search = Search(whole, known, library.build(problem, SMOOTH), law, 0.0)
    pair = next(h for h in search.run() if h.key == (frozenset({"bow", "slip"}), False))
    assert pair.least_share == pytest.approx(wanted, rel=0.1)
    assert all(h.least_share == 1.0 for h in search.run() if len(h.effects) < 2)


@pytest.mark.parametrize("timed", [True, False])
def test_what_settles_is_found_by_the_order_of_the_readings_where_no_time_is_told(
    timed: bool,
) -> None:
    problem = readings(12, timed=timed)
    gone = np.arange(len(problem)) / len(problem)
    fade = np.where(problem.rows["channel"] == "dz", 5.0 * np.exp(-gone / 0.15), 0.0)
    acting, none = (
        problem.with_residual(problem.residual + fade),
        library.build(problem, ()),
    )
    processes = library.build(problem, PROCESSES)
    best = compare([Search(acting, none, processes, stated_law(problem), 0.0)])[0]
    assert best.key == (frozenset(), True)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert (chosen.effect, dict(chosen.constants)) == ("settling", {"within": 0.15})
    still = compare([Search(problem, none, processes, stated_law(problem), 0.0)])[0]
    assert still.key == (frozenset(), False)


@pytest.mark.parametrize("back", [True, False])
def test_what_is_the_same_whenever_the_machine_is_there_is_a_gap_and_what_is_not_is_noise(
    back: bool,
) -> None:
    """An error of each circle, read both ways, twice; or as large a one that is another
    in each run. Beside both a law with an error that is carried along is held.
    """
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
    processes = library.build(acting, [p for p in PROCESSES if p.name == "coming back"])
    carried, prior = noise.fit_law(acting, np.zeros((len(acting), 0)))
    ranked = compare(
        [
            Search(acting, none, processes, *pair)
            for pair in ((carried, prior), estimate.without_run_noise(carried))
        ]
    )
    assert carried.ar1_sd + carried.run_harmonic_sd > 0.5
    assert ranked[0].unknown == back


def test_what_comes_back_with_nothing_that_is_known_is_no_process() -> None:
    problem = readings(9)
    state = dataclasses.replace(
        problem.states[0],
        payload=np.full(len(problem.states[0]), np.nan),
        max_payload=0.0,
    )
    (process,) = (p for p in PROCESSES if p.name == "coming back with")
    assert not list(process.columns(state, reach=0.3, what=1))
    for what, sign in ((0, state.direction), (2, state.feed - 1 / 60.0)):
        columns = list(process.columns(state, reach=0.3, what=what))
        assert columns
        still = np.isclose(np.nan_to_num(sign), 0.0)
        assert all(
            np.abs(v[still]).max(initial=0.0) < 1e-12
            for c in columns
            for v in c.reading.values()
        )
