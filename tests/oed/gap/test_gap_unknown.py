"""Unknown effects: beside known ones, alone, as waves, and with a temperature."""

import dataclasses

import numpy as np
import pytest

from kernel import gap_problem
from kernel.gap_lines import (
    EFFECTS,
    orthogonal_sum,
    readings,
    search_of,
    smooth,
    some,
    terms,
)
from kernel.laws import STATED_LAW
from oed.effect_model import State
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy, library, waves
from oed.gap.forms.library import Library

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


def _with(problem: GapProblem, **changes: object) -> GapProblem:
    """The problem with its states changed."""
    return dataclasses.replace(
        problem, states=tuple(dataclasses.replace(s, **changes) for s in problem.states)
    )  # type: ignore[arg-type]


def _best(problem, change):
    acting = problem.with_residual(problem.residual + change)
    processes = discrepancy.build(problem)
    return processes, compare([search_of(acting, (), processes)])[0]


def _read(problem: GapProblem, channel: str, wave: np.ndarray) -> np.ndarray:
    """A wave (m,) over the poses, added to a channel's readings (N,), in noise units."""
    at = wave[problem.series[0].index[:, 0]]
    kinds = len(np.unique(problem.channel))
    return np.where(problem.rows["channel"] == channel, np.repeat(at, kinds), 0.0)


@pytest.mark.parametrize("recorded", [True, False])
def test_what_goes_with_a_temperature_is_told_by_it(recorded):
    """A temperature that jumps about, in kelvin that are not from zero."""
    problem = readings(14)
    poses = len(problem.states[0])
    warm = 293.15 + np.random.default_rng(3).normal(size=poses).repeat(8)[:poses]
    if recorded:
        start, shop = {"arm": 293.15, "shop": 293.15}, np.full(poses, 293.15)
        problem = _with(
            problem, temperature={"arm": warm, "shop": shop}, start_temperature=start
        )
    processes, best = _best(problem, _read(problem, "dz", 1.5 * (warm - 293.15)))
    named = None if best.process is None else processes.atoms[best.process].effect
    assert (named == "with the temperature of arm") is recorded


def test_no_temperature_recorded_is_no_process():
    processes = discrepancy.build(readings(14))
    assert not {e for e in processes.effects if "temperature" in e}


@pytest.mark.parametrize("within", [0.03, 0.1])
def test_what_fades_after_a_set_ups_start_is_found_in_the_middle_of_a_session(within):
    problem = _later(readings(12))
    gone = problem.states[0].session_progress - 0.5
    processes, best = _best(problem, _read(problem, "dz", 6.0 * np.exp(-gone / within)))
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].effect == "over time"


def _later(problem: GapProblem) -> GapProblem:
    """The set-up as the second half of a session."""

    def half(state: State) -> np.ndarray:
        return np.asarray(0.5 + 0.5 * state.session_progress)

    return dataclasses.replace(
        problem,
        states=tuple(
            dataclasses.replace(s, session_progress=half(s)) for s in problem.states
        ),
    )


def test_a_steady_wave_is_found_at_its_period():
    problem = readings(5)
    time = problem.rows["time"].to_numpy()
    dy = (problem.rows["channel"] == "dy").to_numpy()
    hum = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0 + 1.0), 0.0)
    none = library.build(problem, ())
    processes = waves.add(
        none, problem.with_residual(problem.residual + hum), STATED_LAW
    )
    assert processes.atoms[0].constants["period_s"] == pytest.approx(173.0, rel=0.01)
    humming = problem.with_residual(problem.residual + hum)
    best = compare([search_of(humming, (), processes)])[0]
    assert best.key == (frozenset(), True)
    quiet = search_of(problem, (), waves.add(none, problem, STATED_LAW))
    assert compare([quiet])[0].key == (frozenset(), False)


@pytest.mark.parametrize(("unit", "period", "words"), [
    ("s", 41.0, "leg 2 in a wave of 41 s"), ("s", 733.0, "leg 2 in a wave of 12.2 min"),
    ("s", 10440.0, "leg 2 in a wave of 2.9 h"), ("readings", 5.04, "leg 2 in a wave of 5.04 readings"),
    ("travel_m", 0.005, "leg 2 in a wave every 5 mm of travel"),
    ("travel_rad", np.pi / 25.0, "leg 2 in a wave every 7.2 deg of travel"),
])  # fmt: skip
def test_a_wave_in_words(unit, period, words):
    assert waves._wave_words("leg 2", unit, period) == words


@pytest.mark.parametrize("count", [1, 2, 9, 517])
def test_even_waves_are_those_of_each_frequency(count, rng):
    clock, frequencies = rng.uniform(0.0, 3e4, (30, 2)), np.linspace(1e-4, 0.05, count)
    angle = 2.0 * np.pi * clock[:, :, None] * frequencies
    wanted = np.concatenate([np.cos(angle), np.sin(angle)], axis=2)
    turns = waves._turns(clock, frequencies)
    np.testing.assert_allclose(turns, wanted, rtol=0.0, atol=1e-10)


def _waved(problem: GapProblem, wave: np.ndarray) -> tuple[Library, Hypothesis]:
    """The waves found, and what a search beside them says, of a wave on the readings dy."""
    acting = problem.with_residual(
        problem.residual + np.where(problem.rows["channel"] == "dy", wave, 0.0)
    )
    none = library.build(problem, ())
    processes = waves.add(none, acting, STATED_LAW)
    return processes, compare([search_of(acting, (), processes)])[0]


def _periods(processes: Library, unit: str) -> list[float]:
    return [
        a.constants[f"period_{unit}"]
        for a in processes.atoms
        if f"period_{unit}" in a.constants
    ]


@pytest.mark.parametrize(
    ("late", "wanted"), [(0.0, 1.0 / (1.0 / 27.0 - 1.0 / 40.0)), (15.0, 27.0)]
)
def test_irregular_times_tell_a_wave_faster_than_the_readings(late, wanted):
    """From every 40 s a wave of 27 s looks like one of 83 s; from other times not."""
    problem = readings(32, late=late)
    clock = problem.rows["time"].to_numpy(dtype=float)
    processes, best = _waved(problem, 2.5 * np.sin(2.0 * np.pi * clock / 27.0 + 0.5))
    assert best.key == (frozenset(), True)
    assert processes.atoms[best.process].constants["period_s"] == pytest.approx(
        wanted, rel=0.01
    )


def test_a_wave_of_a_joint_along_its_travel_is_found_at_its_period():
    """Of one joint; the line's first pose, the reference of all, has its part of it."""
    problem = readings(33, uneven=0.03)
    place = discrepancy.values_of_poses(problem, [s.joints for s in problem.states])[
        :, :, 0
    ]
    wave = 2.5 * np.sin(2.0 * np.pi * place / 0.037 + 0.4)[..., None]
    _, joints, *_ = discrepancy.carriers_of(problem)
    leg = joints.columns[:, 0, None]
    change = discrepancy.apply_carrier(leg, wave)[:, 0, 0]
    change *= 2.0 / np.sqrt(np.mean(change**2))
    none = library.build(problem, ())
    acting = problem.with_residual(problem.residual + change)
    processes = waves.add(none, acting, STATED_LAW)
    assert _periods(processes, "travel_m")[0] == pytest.approx(0.037, rel=0.002)
    best = compare([search_of(acting, (), processes)])[0]
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].constants["period_travel_m"] == pytest.approx(
        0.037, rel=0.002
    )
