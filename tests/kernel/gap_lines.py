"""Small readings for tests of the search: lines of a planar machine, and three effects
that are in no library.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable

import numpy as np
import pandas as pd

from kernel.dense_noise import law_covariance
from kernel.laws import STATED_LAW
from oed.gap.data import problem as problems
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.measurement.measurement import Measurement
from oed.model.effect import Column, Effect, State
from oed.model.instrument import mount
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof

LINES, LENGTH = 8, 31


def with_readings(problem: GapProblem, residual: np.ndarray) -> GapProblem:
    """Readings that have these residuals (N,), in units of the stated noise."""
    y = problem.y + problem.sigma * (residual - problem.residual)
    return dataclasses.replace(problem, y=y, residual=residual)


def _height(way: int, pair: int) -> float:
    """z of a pair of lines."""
    return 0.4 * pair


def readings(
    seed: int,
    uneven: float = 0.0,
    late: float = 0.0,
    *,
    timed: bool = True,
    heights: Callable[[int, int], float] = _height,
) -> GapProblem:
    """Lines of a planar machine read by RM 5, each both ways, with times and feeds,
    noise alone.

    uneven, late   how far places (m) and times (s) of readings are off even ones,
                   either way;  timed: whether times are told
    heights        z of the lines by direction and number of the pair
    """
    problem = _without_noise(uneven, late, timed, heights)
    rng = np.random.default_rng(seed)
    noise = problem.slopes @ rng.standard_normal(problem.slopes.shape[1])
    for k, members in enumerate(problem.members):
        noise[members] += np.linalg.cholesky(
            law_covariance(STATED_LAW, problem, problem.members[k])
        ) @ rng.standard_normal(len(members))
    return with_readings(problem, noise)


@functools.cache
def _without_noise(
    uneven: float, late: float, timed: bool, heights: Callable[[int, int], float]
) -> GapProblem:
    """The same lines without noise, which many tests share."""
    measurement = Measurement(planar_2dof.machine, [mount(relative.rm5, "lines")])
    off = np.random.default_rng(99)
    y = np.linspace(-1.4, 1.4, LENGTH) + off.uniform(-uneven, uneven, LENGTH)
    ways = [1 if k % 2 == 0 else -1 for k in range(LINES)]
    command = np.vstack(
        [
            np.column_stack([y[::w], np.full(LENGTH, heights(w, k // 2))])
            for k, w in enumerate(ways)
        ]
    )
    labels = [f"line {k}" for k in range(LINES) for _ in range(LENGTH)]
    series = measurement.series("lines", command, labels)
    n = LENGTH - 1
    covariates = pd.DataFrame(
        {
            "setup": "lines",
            "run": series.run,
            "order": np.tile(np.arange(2, LENGTH + 1), LINES),
            "time": (
                40.0 * np.arange(len(series)) + off.uniform(-late, late, len(series))
            ),
            "direction": np.repeat(np.array(ways, dtype=float), n),
            "feed": np.repeat([1 / 60.0, 3 / 60.0], LINES * n // 2),
        }
    )
    return problems.assemble(
        measurement, (series,), covariates if timed else covariates.drop(columns="time")
    )


def white_lines(seed: int = 0, runs: int = 4, length: int = 15) -> GapProblem:
    """A planar machine read along lines by RM 5: two channels, whose reference reading
    is shared. White residuals.
    """
    measurement = Measurement(planar_2dof.machine, [mount(relative.rm5, "lines")])
    y = np.linspace(-1.4, 1.4, length)
    command = np.vstack(
        [
            np.column_stack([y if k % 2 == 0 else y[::-1], np.full(length, 0.4 * k)])
            for k in range(runs)
        ]
    )
    labels = [f"line {k}" for k in range(runs) for _ in range(length)]
    series = measurement.series("lines", command, labels)
    covariates = pd.DataFrame(
        {
            "setup": "lines",
            "run": series.run,
            "order": np.tile(np.arange(2, length + 1), runs),
            "time": 40.0 * np.arange(len(series)),
        }
    )
    problem = problems.assemble(measurement, (series,), covariates)
    residual = np.random.default_rng(seed).standard_normal(len(problem))
    return with_readings(problem, residual)


def _bow(state: State, turns: float) -> list[Column]:
    return [
        Column(
            f"leg {i + 1}",
            5e-6,
            f"leg {i + 1}",
            {i: np.cos(turns * np.pi * state.joints[:, i])},
        )
        for i in state.limbs
    ]


def _slip(state: State) -> list[Column]:
    return [
        Column(f"leg {i + 1}", 5e-6, f"leg {i + 1}", {i: state.motion_sign[:, i]})
        for i in state.limbs
    ]


def _drift(state: State) -> list[Column]:
    return [Column("drift", 5e-6, reading={"dy": np.nan_to_num(state.time) / 1e4})]


BOW = Effect(
    name="bow",
    source="test",
    about="bow",
    columns=_bow,
    constants={"turns": (2.0, 3.0)},
    remedy="straighten",
)
SLIP = Effect(
    name="slip",
    source="test",
    about="slip",
    columns=_slip,
    needs=("direction: both",),
    exposed_by="both ways",
)
DRIFT = Effect(
    name="drift", source="test", about="drift", columns=_drift, needs=("time",)
)
EFFECTS = (BOW, SLIP, DRIFT)


def planted(
    problem: GapProblem, effect: Effect, factors: dict[str, float], **constants: float
) -> GapProblem:
    """The readings with an effect at these constants, its coefficients at factors of
    their scales.
    """
    effect_library = library.build(
        problem,
        [
            dataclasses.replace(
                effect, constants={k: (v,) for k, v in constants.items()}
            )
        ],
    )
    change = sum(
        factors[n] * effect_library.columns[:, k]
        for k, n in enumerate(effect_library.names)
        if n in factors
    )
    return with_readings(problem, problem.residual + np.asarray(change))
