"""Steady waves and slow swings as unknown effects: found at their periods, placed."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from kernel.gap_lines import EFFECTS, LINES, readings
from kernel.gap_unknown import orthogonal_sum
from oed.gap import diagnose
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers, library, waves
from oed.gap.forms.library import Library
from oed.noise.law import stated_law


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


@pytest.mark.slow
def test_what_is_unknown_is_told_by_its_likeliest_form() -> None:
    problem = readings(6)
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


def test_all_parameters_swing_by_the_order_of_the_readings_where_no_time_is_told() -> (
    None
):
    problem, rng = readings(9, timed=False), np.random.default_rng(9)
    slopes, gone = (
        carriers.parameter_carriers(problem)[:, :, 0],
        np.arange(len(problem)) / len(problem),
    )
    wave = np.sin(2.0 * np.pi * gone / 0.55 + 0.7)
    change = orthogonal_sum(
        problem, [(slopes @ rng.standard_normal(slopes.shape[1])) * wave], [14.0**2]
    )
    processes, best = _waved(problem, change)
    assert best.process is not None
    chosen = processes.atoms[best.process]
    assert len(chosen.columns) == 2 * slopes.shape[1]
    assert chosen.constants["period_readings"] == pytest.approx(
        0.55 * len(problem.series[0]), rel=0.25
    )


def test_all_parameters_swing_together() -> None:
    """Every parameter with a weight of its own, none of which could be seen alone; told
    by the evidence of all.
    """
    problem, rng = readings(9), np.random.default_rng(9)
    time = problem.rows["time"].to_numpy(dtype=float)
    slopes = carriers.parameter_carriers(problem)[:, :, 0]
    wave = np.sin(2.0 * np.pi * time / (0.55 * np.ptp(time)) + 0.7)
    change = orthogonal_sum(
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


def test_many_even_waves_are_those_of_each_frequency(
    rng: np.random.Generator,
) -> None:
    clock, frequencies = rng.uniform(0.0, 3e4, (30, 2)), np.linspace(1e-4, 0.05, 517)
    angle = 2.0 * np.pi * clock[..., None, None] * frequencies
    wanted = np.concatenate([np.cos(angle), np.sin(angle)], axis=-2)
    np.testing.assert_allclose(
        waves._cosine_and_sine(clock, frequencies), wanted, rtol=0.0, atol=1e-10
    )
