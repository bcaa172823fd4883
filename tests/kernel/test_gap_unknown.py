"""An unknown beside an effect in a form of its own, an unknown alone, and steady waves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from kernel import gap_problem
from kernel.gap_lines import EFFECTS, LINES, readings
from oed.gap import diagnose
from oed.gap.cause import compare as comparing
from oed.gap.cause import pursuit
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data import noise
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers, library, waves
from oed.gap.forms.library import Library
from oed.gap.forms.processes.catalogue import PROCESSES
from oed.noise import estimate
from oed.noise.law import stated_law

SMOOTH = [
    p
    for p in PROCESSES
    if p.name in ("over time", "over the pose", "over the travel", "along the runs")
]
#: root of the energy that is planted
SIZE = 40.0


def _some(processes: Library, name: str, rng: np.random.Generator) -> np.ndarray:
    """A draw (N,) of a process."""
    chosen = processes.columns[:, processes.atoms[processes.atoms_of(name)[0]].columns]
    return np.asarray(chosen @ rng.standard_normal(chosen.shape[1]))


def _apart(
    problem: GapProblem, parts: list[np.ndarray], energies: list[float]
) -> np.ndarray:
    """The sum (N,) of parts, each without what those before it hold, at energies r^T M
    r (dense).
    """
    noise = problem.slopes @ problem.slopes.T
    for k, members in enumerate(problem.members):
        noise[np.ix_(members, members)] += stated_law(problem).block(problem, k)
    inverse, orthogonal = np.linalg.inv(noise), []
    for part, energy in zip(parts, energies, strict=True):
        for other in orthogonal:
            part = part - other * (other @ inverse @ part) / (other @ inverse @ other)
        orthogonal.append(part * np.sqrt(energy / (part @ inverse @ part)))
    return np.asarray(sum(orthogonal))


@pytest.mark.parametrize("seed", [20, 21, 24])
def test_an_effect_in_a_form_of_its_own_is_named_beside_the_unknown(seed: int) -> None:
    problem, rng = readings(seed), np.random.default_rng(seed)
    known, processes = library.build(problem, EFFECTS), library.build(problem, SMOOTH)
    whole = max((known.atoms[k].columns for k in known.atoms_of("bow")), key=len)
    book, departure = (
        known.columns[:, whole] @ np.array([1.0, -0.6]),
        _some(processes, "over the travel", rng),
    )
    change = _apart(problem, [book, departure], [0.75 * SIZE**2, 0.25 * SIZE**2])
    acting = problem.with_residual(problem.residual + change)
    best = compare([Search(acting, known, processes, stated_law(problem), 0.0)])[0]
    assert best.key == (frozenset({"bow"}), True)
    assert best.share == pytest.approx(0.75, abs=0.15)


@pytest.mark.parametrize("seed", [20, 21, 24])
def test_a_process_that_is_like_no_effect_is_unknown_alone(seed: int) -> None:
    problem, rng = readings(seed), np.random.default_rng(seed)
    known, processes = library.build(problem, EFFECTS), library.build(problem, SMOOTH)
    change = _apart(problem, [_some(processes, "over the pose", rng)], [SIZE**2])
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
        _apart(problem, parts, [SIZE**2, (small * SIZE) ** 2])
    )
    search = Search(whole, known, library.build(problem, SMOOTH), law, 0.0)
    pair = next(h for h in search.run() if h.key == (frozenset({"bow", "slip"}), False))
    assert pair.least_share == pytest.approx(wanted, rel=0.1)
    assert all(h.least_share == 1.0 for h in search.run() if len(h.effects) < 2)


# -- waves -----------------------------------------------------------------------------


def test_a_steady_wave_is_found_at_its_period() -> None:
    problem = readings(5)
    time = problem.rows["time"].to_numpy()
    dy = (problem.rows["channel"] == "dy").to_numpy()
    hum = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0 + 1.0), 0.0)
    none = library.build(problem, ())
    processes = waves.add(
        none, problem.with_residual(problem.residual + hum), stated_law(problem)
    )
    assert processes.atoms[0].constants["period_s"] == pytest.approx(173.0, rel=0.01)
    search = Search(
        problem.with_residual(problem.residual + hum),
        none,
        processes,
        stated_law(problem),
        0.0,
    )
    best = compare([search])[0]
    assert best.key == (frozenset(), True)
    quiet = Search(
        problem,
        none,
        waves.add(none, problem, stated_law(problem)),
        stated_law(problem),
        0.0,
    )
    assert compare([quiet])[0].key == (frozenset(), False)


@pytest.mark.parametrize(("unit", "period", "words"), [
    ("s", 41.0, "leg 2 in a wave of 41 s"), ("s", 733.0, "leg 2 in a wave of 12.2 min"),
    ("s", 10440.0, "leg 2 in a wave of 2.9 h"), ("readings", 5.04, "leg 2 in a wave of 5.04 readings"),
    ("m", 0.35, "leg 2 in a wave every 350 mm of path"), ("travel_m", 0.005, "leg 2 in a wave every 5 mm of travel"),
])  # fmt: skip
def test_a_wave_in_words(unit: str, period: float, words: str) -> None:
    assert waves._in_words(unit, period, "leg 2") == words


def test_what_is_unknown_is_told_by_its_likeliest_form() -> None:
    problem = readings(5)
    wave = 2.0 * np.sin(
        2.0 * np.pi * problem.rows["time"].to_numpy(dtype=float) / 173.0 + 1.0
    )
    acting = problem.with_residual(
        problem.residual + np.where(problem.rows["channel"] == "dy", wave, 0.0)
    )
    diagnosis, best = _concluded(acting)
    first, share = next(iter(diagnosis.likeness.items()))
    assert first == "the readings of dy in a wave of 2.88 min"
    assert share > 0.9
    assert best.key == (frozenset(), True)
    assert not _concluded(problem)[0].likeness


def _concluded(problem: GapProblem) -> tuple[Diagnosis, Hypothesis]:
    searches = searching.searches(problem, EFFECTS)
    return diagnose.conclude(problem, searches, compare(searches), EFFECTS)


def _waved(problem: GapProblem, wave: np.ndarray) -> tuple[Library, Hypothesis]:
    """The waves found, and what a search beside them says, of a wave on the readings
    dy.
    """
    acting = problem.with_residual(
        problem.residual + np.where(problem.rows["channel"] == "dy", wave, 0.0)
    )
    none = library.build(problem, ())
    processes = waves.add(none, acting, stated_law(problem))
    return processes, compare(
        [Search(acting, none, processes, stated_law(problem), 0.0)]
    )[0]


def _periods(processes: Library, unit: str) -> list[float]:
    return [
        a.constants[f"period_{unit}"]
        for a in processes.atoms
        if f"period_{unit}" in a.constants
    ]


def _on_the_way(problem: GapProblem) -> np.ndarray:
    """Way (N,) of the tool since the first reading of its line, m, on the lines of the
    usual feed; NaN on others.
    """
    state = problem.states[0]
    y = state.tool[problem.series[0].index[:, 0], 1]
    way = np.concatenate([np.abs(part - part[0]) for part in np.split(y, LINES)])
    return np.where(problem.rows["feed"] < 2 / 60.0, np.repeat(way, 2), np.nan)


@pytest.mark.parametrize(
    ("uneven", "period"), [(0.03, 0.061), (0.0, 0.061), (0.03, 0.4)]
)
def test_a_wave_along_the_path_is_found_at_its_period(
    uneven: float, period: float
) -> None:
    """A resonance at one feed, with readings every 93 mm. From even places any of its
    aliases is as good.
    """
    problem = readings(31, uneven)
    way = _on_the_way(problem)
    processes, best = _waved(
        problem, np.nan_to_num(2.5 * np.sin(2.0 * np.pi * way / period + 0.5))
    )
    estimate = _periods(processes, "m")[0]
    if uneven:
        assert estimate == pytest.approx(period, rel=0.01)
    else:
        turns = (2.8 / 30) / np.array([estimate, period])
        off = np.abs(turns - np.round(turns))
        assert off[0] == pytest.approx(off[1], abs=0.02)
    assert best.key == (frozenset(), True)
    assert "period_m" in processes.atoms[best.process].constants
    quiet, none = _waved(problem, np.zeros(len(problem)))
    assert none.key == (frozenset(), False)
    assert len(set(_periods(quiet, "m"))) == waves.PEAKS


@pytest.mark.parametrize(
    ("late", "wanted"), [(0.0, 1.0 / (1.0 / 27.0 - 1.0 / 40.0)), (15.0, 27.0)]
)
def test_irregular_times_tell_a_wave_faster_than_the_readings(
    late: float, wanted: float
) -> None:
    """From every 40 s on the dot, a wave of 27 s looks like one of 83 s; from times
    that are off, it does not.
    """
    problem = readings(32, late=late)
    clock = problem.rows["time"].to_numpy(dtype=float)
    processes, best = _waved(problem, 2.5 * np.sin(2.0 * np.pi * clock / 27.0 + 0.5))
    assert best.key == (frozenset(), True)
    assert processes.atoms[best.process].constants["period_s"] == pytest.approx(
        wanted, rel=0.01
    )


def test_a_wave_of_a_joint_along_its_travel_is_found_at_its_period() -> None:
    """Of one of the two joints; the line's first pose, which all others are read
    against, has its part of it.
    """
    problem = readings(33, uneven=0.03)
    place = carriers.at_poses(problem, [s.joints for s in problem.states])[:, :, 0]
    wave = 2.5 * np.sin(2.0 * np.pi * place / 0.037 + 0.4)[..., None]
    change = carriers.apply_carrier(carriers.joint_carriers(problem)[:, 0, None], wave)[
        :, 0, 0
    ]
    change *= 2.0 / np.sqrt(np.mean(change**2))
    none, acting = (
        library.build(problem, ()),
        problem.with_residual(problem.residual + change),
    )
    processes = waves.add(none, acting, stated_law(problem))
    assert _periods(processes, "travel_m")[0] == pytest.approx(0.037, rel=0.002)
    best = compare([Search(acting, none, processes, stated_law(problem), 0.0)])[0]
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].constants["period_travel_m"] == pytest.approx(
        0.037, rel=0.002
    )


@pytest.mark.parametrize("larger", ["wave", "overtone"])
def test_a_wave_with_an_overtone_is_one_form(larger: str) -> None:
    """Whichever of the two is found first, both are held together, at the weight of one
    wave among all.
    """
    problem, size = readings(5), {"wave": (2.0, 1.2), "overtone": (1.2, 2.0)}[larger]
    angle = 2.0 * np.pi * problem.rows["time"].to_numpy(dtype=float) / 391.0
    processes, best = _waved(
        problem, size[0] * np.sin(angle + 1.0) + size[1] * np.sin(2.0 * angle)
    )
    assert best.key == (frozenset(), True)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert len(chosen.columns) == 4
    assert chosen.constants["period_s"] == pytest.approx(
        {"wave": 391.0, "overtone": 195.5}[larger], rel=0.01
    )


def test_a_wave_of_all_joints_along_their_travels_is_one_form() -> None:
    """At one period, each joint with a phase of its own, too small to be seen in either
    alone.
    """
    problem = readings(33, uneven=0.03)
    place = carriers.at_poses(problem, [s.joints for s in problem.states])
    waves_of = np.sin(2.0 * np.pi * place / 0.037 + np.array([0.4, 2.1]))
    change = np.einsum("nqj,njq->n", carriers.joint_carriers(problem), waves_of)
    change *= 1.0 / np.sqrt(np.mean(change**2))
    processes, best = _waved(problem, change)
    assert best.key == (frozenset(), True)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert chosen.constants["period_travel_m"] == pytest.approx(0.037, rel=0.002)
    assert chosen.about.startswith("all legs, each")
    assert len(chosen.columns) == 2 * 2


# -- where no time is told -------------------------------------------------------------


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


def test_all_parameters_swing_by_the_order_of_the_readings_where_no_time_is_told() -> (
    None
):
    problem, rng = readings(9, timed=False), np.random.default_rng(9)
    slopes, gone = (
        carriers.parameter_carriers(problem)[:, :, 0],
        np.arange(len(problem)) / len(problem),
    )
    wave = np.sin(2.0 * np.pi * gone / 0.55 + 0.7)
    change = _apart(
        problem, [(slopes @ rng.standard_normal(slopes.shape[1])) * wave], [14.0**2]
    )
    processes, best = _waved(problem, change)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert len(chosen.columns) == 2 * slopes.shape[1]
    assert chosen.constants["period_readings"] == pytest.approx(
        0.55 * len(problem.series[0]), rel=0.25
    )


# -- what comes back -------------------------------------------------------------------


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


# -- several processes together --------------------------------------------------------


def test_noise_told_beside_a_wave_does_not_hold_it() -> None:
    """Carried noise takes the place of a wave where it is told first; beside the wave
    that was found it is gone.
    """
    problem = readings(5)
    angle = 2.0 * np.pi * problem.rows["time"].to_numpy(dtype=float) / 391.0
    wave = np.where(problem.rows["channel"] == "dy", 1.6 * np.sin(angle + 1.0), 0.0)
    acting = problem.with_residual(problem.residual + wave)
    alone, prior = noise.fit_law(acting, np.zeros((len(acting), 0)))
    none = waves.add(library.build(acting, ()), acting, alone)
    processes, (with_wave,) = pursuit.pursue(none, acting, [alone])
    assert alone.ar1_sd > 0.5
    assert with_wave[0].ar1_sd < 0.5 * alone.ar1_sd
    first = Search(acting, library.build(acting, ()), processes, alone, prior).run()
    anew = Search(acting, library.build(acting, ()), processes, *with_wave).run()

    def odds(hypotheses: list[Hypothesis]) -> float:
        by = {h.key: h.log_evidence for h in hypotheses}
        return by[frozenset(), True] - by[frozenset(), False]

    assert odds(anew) > odds(first) + 5.0


def test_what_shifts_whole_runs_is_looked_for_where_runs_repeat() -> None:
    """Under a law of runs that do not repeat, a drift from run to run is noise, and
    begun there it stays noise.
    """
    problem = readings(8)
    runs = np.concatenate(
        [np.full(len(members), k) for k, members in enumerate(problem.members)]
    )
    shift = 4.0 * np.cos(
        np.pi * runs[np.argsort(np.concatenate(problem.members))] / len(problem.members)
    )
    acting = problem.with_residual(problem.residual + shift)
    loose, _ = noise.fit_law(acting, np.zeros((len(acting), 0)))
    processes = library.build(acting, SMOOTH)
    _, (noisy, calm) = pursuit.pursue(processes, acting, [loose, stated_law(problem)])
    assert loose.run_sd > 1.0
    assert calm[0].run_sd < 0.5 * min(noisy[0].run_sd, loose.run_sd)


@pytest.mark.parametrize("suits", [True, False])
def test_no_gap_is_given_a_law_of_its_own(suits: bool) -> None:
    """Begun at the law of a gap, and taken where it suits no gap better than the laws
    that there are: white noise is no large carried error.
    """
    problem = readings(7)
    none, law = (
        library.build(problem, ()),
        dataclasses.replace(stated_law(problem), ar1_sd=3.0, ar1_length=8.0),
    )
    best = noise.fit_law(problem, np.zeros((len(problem), 0)))
    searches = [Search(problem, none, none, *(best if suits else (law, 0.0)))]
    searching._add_without_gap(searches, law)

    def worth(search: Search) -> float:
        return next(
            h.log_evidence for h in search.run() if not h.effects and not h.unknown
        )

    assert len(searches) == (1 if suits else 2)
    assert suits or worth(searches[1]) > worth(searches[0]) + 20.0
    assert searches[-1].law.ar1_sd < 0.3


def test_two_waves_are_told_together() -> None:
    problem = readings(6)
    time = problem.rows["time"].to_numpy(dtype=float)
    dy, dz = ((problem.rows["channel"] == name).to_numpy() for name in ("dy", "dz"))
    both = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0), 0.0)
    both += np.where(dz, 2.0 * np.sin(2.0 * np.pi * time / 611.0), 0.0)
    acting = problem.with_residual(problem.residual + both)
    none = library.build(acting, ())
    processes, _ = pursuit.pursue(
        waves.add(none, acting, stated_law(acting)), acting, [stated_law(acting)]
    )
    best = compare([Search(acting, none, processes, stated_law(acting), 0.0)])[0]
    assert best.process is not None
    assert processes.atoms[best.process].effect == pursuit.NAME
    assert processes.atoms[best.process].constants["processes"] >= 2.0
    in_noise = waves.add(none, problem, stated_law(problem))
    quiet = Search(
        problem,
        none,
        pursuit.pursue(in_noise, problem, [stated_law(problem)])[0],
        stated_law(problem),
        0.0,
    )
    assert compare([quiet])[0].key == (frozenset(), False)


def test_all_parameters_swing_together() -> None:
    """Every parameter with a weight of its own, none of which could be seen alone; told
    by the evidence of all.
    """
    problem, rng = readings(9), np.random.default_rng(9)
    time = problem.rows["time"].to_numpy(dtype=float)
    slopes = carriers.parameter_carriers(problem)[:, :, 0]
    wave = np.sin(2.0 * np.pi * time / (0.55 * np.ptp(time)) + 0.7)
    change = _apart(
        problem, [(slopes @ rng.standard_normal(slopes.shape[1])) * wave], [14.0**2]
    )
    acting = problem.with_residual(problem.residual + change)
    none = library.build(problem, ())
    processes = waves.add(none, acting, stated_law(problem))
    best = compare([Search(acting, none, processes, stated_law(problem), 0.0)])[0]
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert len(chosen.columns) == 2 * slopes.shape[1]
    assert chosen.constants["period_s"] == pytest.approx(0.55 * np.ptp(time), rel=0.2)


def test_a_wave_is_found_in_runs_without_a_clock() -> None:
    """Where no time is told its phase is new in each run, its period along the way the
    same in all.
    """
    problem = readings(31, uneven=0.03)
    way = _on_the_way(problem)
    timeless = dataclasses.replace(problem, rows=problem.rows.drop(columns="time"))
    rng = np.random.default_rng(31)
    phase = np.zeros(len(problem))
    for members in problem.members:
        phase[members] = rng.uniform(0.0, 2.0 * np.pi)
    processes, best = _waved(
        timeless, np.nan_to_num(2.5 * np.sin(2.0 * np.pi * way / 0.61 + phase))
    )
    assert best.key == (frozenset(), True)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert len(chosen.columns) == 2 * len(problem.members)
    assert chosen.constants["period_m"] == pytest.approx(0.61, rel=0.1)
