"""Courses that a planned session may take: times of readings, sense of travel, warmth.

Planned readings have no order before they are chosen, and what is not recorded of it
stays unknown. In a drawn course each joint arrives at each reading from a random side, and
readings of a set-up are spread over its time at random. Courses come in pairs of opposite
sides, and a reading's times are spread evenly over them, so that few courses have the
moments of many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed.base import Array, Index
from oed.gap.data import state as states_of
from oed.gap.data.problem import GapProblem
from oed.measurement import Series
from oed.model.effect import State

if TYPE_CHECKING:
    import pandas as pd

#: limits of the time constant with which a body warms, s
WARMS = (600.0, 3600.0)


@dataclasses.dataclass(frozen=True, eq=False)
class Course:
    """One course of a session.

    covariates  of the readings, one row each
    seed        of the sides from which joints arrive;  side  1 or -1, their sign
    """

    covariates: pd.DataFrame
    seed: int
    side: float

    def of(self, problem: GapProblem) -> GapProblem:
        """The readings of a problem in this course."""
        states = states_of.states(
            problem.measurement,
            problem.series,
            self.covariates,
            problem.theta,
            problem.gravity,
        )
        rng = np.random.default_rng(self.seed)
        arrived = tuple(
            self._arriving(state, series, rng)
            for state, series in zip(states, problem.series, strict=True)
        )
        return dataclasses.replace(problem, covariates=self.covariates, states=arrived)

    def _arriving(
        self, state: State, series: Series, rng: np.random.Generator
    ) -> State:
        """The state with joints that arrive at what is read from a random side."""
        sign, travel = state.motion_sign.copy(), state.travel_since_reversal.copy()
        read = series.index[:, 0]
        sides = rng.choice([-1.0, 1.0], (len(series.q), sign.shape[1]))
        sign[read] = self.side * sides[read]
        travel[read] = np.inf
        return dataclasses.replace(
            state, motion_sign=sign, travel_since_reversal=travel
        )


def draw_courses(
    rows: pd.DataFrame,
    seconds: float,
    count: int,
    rng: np.random.Generator,
    bodies: Sequence[str] = (),
    last: int = 0,
) -> list[Course]:
    """`count` courses of a session, an even number.

    rows     set-up, run and order of each planned reading
    seconds  that the session lasts
    bodies   whose temperatures are recorded: they warm by one kelvin
    last     readings at the end of `rows` that repeat the first ones: these open the
             session, and they close it
    """
    places = _places(rows, rng, last)
    sides = rng.choice([-1.0, 1.0], (count // 2, len(rows)))
    seeds = rng.integers(2**32, size=count // 2)
    shifts = rng.permutation(count)
    courses = []
    for number, shift in enumerate(shifts):
        pair, side = number // 2, 1.0 - 2.0 * (number % 2)
        rank = _ranks(places, shift / count)
        time = seconds * rank / max(len(rows) - 1, 1)
        course = rows.assign(time=time, direction=side * sides[pair])
        for body in bodies:
            course[f"temp_{body}"] = _warm_up(time, seconds, rng)
        courses.append(Course(course, int(seeds[pair]), side))
    return courses


def _places(rows: pd.DataFrame, rng: np.random.Generator, last: int) -> list[Index]:
    """Readings of each block of the session, in a random order each."""
    names = rows["setup"].to_numpy()
    free = np.arange(len(rows))
    opening, closing = free[:last], free[len(rows) - last :]
    inner = free[last : len(rows) - last]
    blocks = [inner[names[inner] == name] for name in dict.fromkeys(names[inner])]
    shuffled = [rng.permutation(block) for block in blocks]
    return [opening, *shuffled, closing]


def _ranks(places: list[Index], share: float) -> Array:
    """Rank (n,) of each reading, with the inner blocks turned by a share of them."""
    rank = np.empty(sum(map(len, places)))
    start = 0
    for number, block in enumerate(places):
        turned = np.roll(block, round(share * len(block)))
        if number in (0, len(places) - 1):
            turned = block
        rank[turned] = start + np.arange(len(block))
        start += len(block)
    return rank


def _warm_up(time: Array, seconds: float, rng: np.random.Generator) -> Array:
    """Temperature (n,) of a body above the start, K: 1 at the session's end."""
    tau = float(np.exp(rng.uniform(*np.log(WARMS))))
    return np.asarray(np.expm1(-time / tau) / np.expm1(-seconds / tau))
