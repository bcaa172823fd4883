"""Steady waves as unknown effects: found at their periods."""

import numpy as np
import pytest

from kernel.gap_lines import readings, search_of
from kernel.laws import STATED_LAW
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Hypothesis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy, library, waves
from oed.gap.forms.library import Library


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
