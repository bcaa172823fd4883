"""Small readings for tests of the diagnosis: an A3 head with a ball bar, circles at
several heights, both ways.
"""

import functools

import numpy as np
import pandas as pd

from kernel.laws import noise_law
from oed.gap.data.problem import GapProblem, assemble
from oed.measurement.measurement import Measurement
from oed.model.instrument import mount
from oed.noise.law import NoiseLaw
from oed.noise.structure import RENEWED
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head

TEACH = (1.40, 0.0, 0.0)
HEIGHTS = (1.10, 1.16, 1.22)


@functools.cache
def circles(
    points: int = 24, heights: tuple[float, ...] = HEIGHTS, passes: int = 1
) -> GapProblem:
    """Circles, each forward and backward, `passes` times; a reading every 6 s."""
    measurement = Measurement(
        a3_head.machine, [mount(ball_bar.instrument, "bar", teach=TEACH)]
    )
    psi = np.linspace(-np.pi, np.pi, points, endpoint=False)
    commands, rows = [], []
    for number in range(passes):
        for height in heights:
            for direction in (1, -1):
                run = f"z {height:g} way {direction} pass {number + 1}"
                commands.append(
                    np.column_stack(
                        [
                            np.full(points, height),
                            psi[::direction],
                            np.full(points, 0.5),
                        ]
                    )
                )
                rows += [
                    {"setup": "bar", "run": run, "order": k + 1, "direction": direction}
                    for k in range(points)
                ]
    covariates = pd.DataFrame(rows)
    covariates["time"] = 6.0 * np.arange(len(covariates))
    series = measurement.series("bar", np.vstack(commands), run=list(covariates["run"]))
    return assemble(measurement, [series], covariates)


def law(problem: GapProblem) -> NoiseLaw:
    """A law with everything: a run's level and seating, an error carried along,
    a scatter and a level.
    """
    return noise_law(
        0.7,
        0.9,
        5.0,
        1.2,
        level=1.3,
        seat_sd=0.6,
    )


def dense(problem: GapProblem, law: NoiseLaw) -> np.ndarray:
    """Covariance (N, N) of readings without a gap, reading by reading from the law's
    formula.
    """
    of, structure = law.law, problem.structure
    seat = structure.columns[:, structure.kinds == RENEWED]
    carried, place = of.carried[0], structure.position
    total = (1.0 - carried) * np.eye(len(problem))
    for members in problem.members:
        for i in members:
            for j in members:
                lag = abs(place[i] - place[j])
                total[i, j] += of.level[0] ** 2 + carried * np.exp(-lag / of.reach[0])
                total[i, j] += of.seat[0] ** 2 * seat[i] @ seat[j]
    level = law.level * of.scale[0, 0]
    return level**2 * total + problem.slopes @ problem.slopes.T


def in_joint(problem: GapProblem, limb: int, change: np.ndarray) -> np.ndarray:
    """Change (N,) of the readings, in units of the noise, where a joint is off by
    `change` (m,) at each pose, m.
    """
    (series,), (response,) = problem.series, problem.responses
    total = np.zeros(len(problem))
    for slope, place in zip(response.joints, series.index.T, strict=True):
        total += slope[:, 0, limb] * change[place]
    return problem.in_noise_units(total)


def sized(change: np.ndarray, covariance: np.ndarray, size: float) -> np.ndarray:
    """The change (N,) as large as makes the oracle's sqrt(lambda) = size."""
    return change * size / np.sqrt(change @ np.linalg.solve(covariance, change))
