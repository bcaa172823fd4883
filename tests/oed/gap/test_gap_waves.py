"""Steady waves as unknown effects: found at their periods."""

import numpy as np
import pytest

from kernel.gap_lines import EFFECTS, readings
from kernel.laws import STATED_LAW
from oed.gap import procedure as diagnose
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy, library, waves
from oed.gap.forms.library import Library


def test_a_steady_wave_is_found_at_its_period() -> None:
    problem = readings(5)
    time = problem.rows["time"].to_numpy()
    dy = (problem.rows["channel"] == "dy").to_numpy()
    hum = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0 + 1.0), 0.0)
    none = library.build(problem, ())
    processes = waves.add(
        none, problem.with_residual(problem.residual + hum), STATED_LAW
    )
    assert processes.atoms[0].constants["period_s"] == pytest.approx(173.0, rel=0.01)
    search = Search(
        problem.with_residual(problem.residual + hum), none, processes, STATED_LAW, 0.0
    )
    best = compare([search])[0]
    assert best.key == (frozenset(), True)
    quiet = Search(problem, none, waves.add(none, problem, STATED_LAW), STATED_LAW, 0.0)
    assert compare([quiet])[0].key == (frozenset(), False)


@pytest.mark.parametrize(("unit", "period", "words"), [
    ("s", 41.0, "leg 2 in a wave of 41 s"), ("s", 733.0, "leg 2 in a wave of 12.2 min"),
    ("s", 10440.0, "leg 2 in a wave of 2.9 h"), ("readings", 5.04, "leg 2 in a wave of 5.04 readings"),
    ("travel_m", 0.005, "leg 2 in a wave every 5 mm of travel"),
    ("travel_rad", np.pi / 25.0, "leg 2 in a wave every 7.2 deg of travel"),
])  # fmt: skip
def test_a_wave_in_words(unit: str, period: float, words: str) -> None:
    assert waves._wave_words("leg 2", unit, period) == words


@pytest.mark.parametrize("count", [1, 2, 9, 517])
def test_even_waves_are_those_of_each_frequency(
    count: int, rng: np.random.Generator
) -> None:
    clock, frequencies = rng.uniform(0.0, 3e4, (30, 2)), np.linspace(1e-4, 0.05, count)
    angle = 2.0 * np.pi * clock[:, :, None] * frequencies
    wanted = np.concatenate([np.cos(angle), np.sin(angle)], axis=2)
    turns = waves._turns(clock, frequencies)
    np.testing.assert_allclose(turns, wanted, rtol=0.0, atol=1e-10)


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
    processes = waves.add(none, acting, STATED_LAW)
    return processes, compare([Search(acting, none, processes, STATED_LAW, 0.0)])[0]


def _periods(processes: Library, unit: str) -> list[float]:
    return [
        a.constants[f"period_{unit}"]
        for a in processes.atoms
        if f"period_{unit}" in a.constants
    ]


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
    best = compare([Search(acting, none, processes, STATED_LAW, 0.0)])[0]
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].constants["period_travel_m"] == pytest.approx(
        0.037, rel=0.002
    )
