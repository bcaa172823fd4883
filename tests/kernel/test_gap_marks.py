"""Fine waves along joints, as of a scale's marks: found among thousands of periods, and
not where there are none.
"""

from __future__ import annotations

import numpy as np
import pytest

from kernel import gap_problem
from oed.gap import diagnose
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import bands, carriers, library, marks, waves
from oed.gap.forms.library import Library
from oed.noise.law import stated_law

HEIGHTS = (1.10, 1.14, 1.18, 1.22)


def _noisy(seed: int) -> GapProblem:
    problem = gap_problem.circles(points=36, heights=HEIGHTS)
    rng = np.random.default_rng(seed)
    return problem.with_residual(
        np.linalg.cholesky(gap_problem.dense(problem, stated_law(problem)))
        @ rng.normal(size=len(problem))
    )


def _marked(problem: GapProblem, periods: dict[int, float], size: float) -> GapProblem:
    """With a wave of each joint along its travel, m of either way; in all `size` large
    against the noise.
    """
    (state,) = problem.states
    change = sum(
        gap_problem.in_joint(
            problem,
            leg,
            1e-6 * np.cos(2.0 * np.pi * state.joints[:, leg] / period + 0.7 * leg),
        )
        for leg, period in periods.items()
    )
    return problem.with_residual(
        problem.residual
        + gap_problem.sized(
            np.asarray(change), gap_problem.dense(problem, stated_law(problem)), size
        )
    )


def _scan_marks(problem: GapProblem) -> tuple[Library, Hypothesis]:
    none = library.build(problem, ())
    processes = marks.add(none, problem, stated_law(problem))
    return processes, compare(
        [Search(problem, none, processes, stated_law(problem), 0.0)]
    )[0]


@pytest.mark.parametrize(
    ("periods", "about"),
    [
        ({1: 20e-6}, "leg 2 in a wave every 0.02 mm of travel"),
        ({2: 173e-6}, "leg 3 in a wave every 0.173 mm of travel"),
        (
            {0: 40e-6, 1: 40e-6, 2: 40e-6},
            "all legs, each in a wave every 0.04 mm of travel",
        ),
    ],
)
def test_marks_are_found_at_their_period(periods: dict[int, float], about: str) -> None:
    processes, best = _scan_marks(_marked(_noisy(1), periods, 10.0))
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].about == about


def test_marks_are_told_and_placed() -> None:
    """In the whole diagnosis, noise told and all: the leg is that of the marks, whose
    looks know no fine wave.
    """
    diagnosis = diagnose.diagnose(
        _marked(_noisy(1), {1: 20e-6}, 10.0), (), np.random.default_rng(0)
    )
    assert diagnosis.verdict == "unknown"
    assert next(iter(diagnosis.likeness)) == "leg 2 in a wave every 0.02 mm of travel"
    assert gap_problem.first(diagnosis.where, "leg") == "leg 2"
    assert diagnosis.where[0].p_value < 0.01


@pytest.mark.parametrize("seed", [2, 3, 4])
def test_there_are_none_in_noise(seed: int) -> None:
    processes, best = _scan_marks(_noisy(seed))
    assert best.key == (frozenset(), False)
    assert len({a.about for a in processes.atoms}) == waves.PEAKS


def test_what_a_fine_wave_explains_is_what_the_metric_says() -> None:
    """One transform for all frequencies, against dense matrices for some, where
    readings are that many.
    """
    problem = _marked(_noisy(5), {0: 31e-6}, 12.0)
    legs, (long, place, _) = carriers.joint_carriers(problem), bands.travels(problem)
    size, bin_size = marks._division(float(place[:, :, long].max()))
    energy = marks._energies(
        problem,
        Metric(problem, stated_law(problem)),
        legs[:, long],
        place[:, :, long] / bin_size,
        size,
    )
    inverse, quick, exact = (
        np.linalg.inv(gap_problem.dense(problem, stated_law(problem))),
        [],
        [],
    )
    at = round(size * bin_size / 31e-6)
    for k in (
        at - 1,
        at,
        at + 1,
        *range(int(1e3 * size * bin_size), int(9e4 * size * bin_size), 997),
    ):
        angle = 2.0 * np.pi * k / (size * bin_size) * place[:, 0, 0]
        both = legs[:, 0, :1] * np.column_stack([np.cos(angle), np.sin(angle)])
        projected = both.T @ inverse @ problem.residual
        exact.append(projected @ np.linalg.solve(both.T @ inverse @ both, projected))
        quick.append(energy[0, k])
    assert len(exact) > 15
    assert max(exact) > 50.0
    assert np.corrcoef(quick, exact)[0, 1] > 0.97
    assert quick[int(np.argmax(exact))] == pytest.approx(max(exact), rel=0.15)


def test_long_travels_are_divided_less_finely() -> None:
    assert marks._division(0.5)[1] == marks.BIN
    size, bin_size = marks._division(10.0)
    assert bin_size == pytest.approx(10.0 / marks.MOST)
    assert size * bin_size >= 20.0
