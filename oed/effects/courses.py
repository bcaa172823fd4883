"""What effects do to planned readings over the courses that a session may take.

Let G(z) b be the change of the readings by effects in the course z (sense of travel,
times, temperatures), with b ~ N(0, I). Where z is recorded, G(z) are columns as any
others. Where it is not, readings of independent courses have the moments

    E[G b] = 0,    cov(G b) = M M^T + diag(S^2),    M = E[G(z)],    S^2 = E[(G(z) - M)^2] 1.

The best linear estimate sees the mean columns M, and S as scatter of single readings.
Likewise the tool, in states that the machine is used in: the mean of its changes can be
known with the coefficients, the rest stays.

In a drawn course each joint arrives at each reading from a random side, and readings of a
set-up are spread over its time at random. Courses come in pairs of opposite sides, and a
reading's times are spread evenly over them, so that few courses have the moments of many.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import gap
from oed.accuracy import Reference
from oed.base import Array, Index, Mask
from oed.design import Nuisances
from oed.effect_model import Effect, State
from oed.effects.columns import ExpectedColumns
from oed.effects.effect_maps import SessionStates
from oed.gap import GapProblem
from oed.measurement import Series

if TYPE_CHECKING:
    import pandas as pd


#: limits of the time constant with which a body warms, s
WARM_UP_TIMES = (600.0, 3600.0)


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
        states = gap.states(
            problem.measurement,
            problem.series,
            self.covariates,
            problem.theta,
            problem.gravity,
        )
        rng = np.random.default_rng(self.seed)
        arrived = tuple(
            self._arrive(state, series, rng)
            for state, series in zip(states, problem.series, strict=True)
        )
        return dataclasses.replace(problem, covariates=self.covariates, states=arrived)

    def _arrive(self, state: State, series: Series, rng: np.random.Generator) -> State:
        """The state with joints that arrive at what is read from a random side."""
        sign, travel = state.motion_sign.copy(), state.travel_since_reversal.copy()
        read = series.index[:, 0]
        sides = rng.choice([-1.0, 1.0], (len(series.q), sign.shape[1]))
        sign[read] = self.side * sides[read]
        travel[read] = np.inf
        return dataclasses.replace(
            state, motion_sign=sign, travel_since_reversal=travel
        )

    @staticmethod
    def draw(
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
        blocks = _places(rows, rng, last)
        sides = rng.choice([-1.0, 1.0], (count // 2, len(rows)))
        seeds = rng.integers(2**32, size=count // 2)
        shifts = rng.permutation(count)
        courses = []
        for number, shift in enumerate(shifts):
            pair, side = number // 2, 1.0 - 2.0 * (number % 2)
            rank = _ranks(blocks, shift / count)
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


def _ranks(blocks: list[Index], share: float) -> Array:
    """Rank (n,) of each reading, with the inner blocks turned by a share of them."""
    rank = np.empty(sum(map(len, blocks)))
    start = 0
    for number, block in enumerate(blocks):
        turned = np.roll(block, round(share * len(block)))
        if number in (0, len(blocks) - 1):
            turned = block
        rank[turned] = start + np.arange(len(block))
        start += len(block)
    return rank


def _warm_up(time: Array, seconds: float, rng: np.random.Generator) -> Array:
    """Temperature (n,) of a body above the start, K: 1 at the session's end."""
    tau = float(np.exp(rng.uniform(*np.log(WARM_UP_TIMES))))
    return np.asarray(np.expm1(-time / tau) / np.expm1(-seconds / tau))


#: beginnings of what an effect needs that depends on the course of a session
COURSE_NEEDS = ("direction", "time", "temp_")


@dataclasses.dataclass(frozen=True, eq=False)
class CourseColumns:
    """Changes of N planned readings and of n poses by k coefficients over d courses."""

    changes: Array  #: (d, N, k) of the readings in each course, SI
    tool: Array  #: (d, n, c, k) of c pose components in states drawn anew for each, SI
    of_course: Mask  #: (k,) which depend on the course

    @property
    def mean(self) -> Array:
        """Mean (N, k) over the courses."""
        return np.asarray(self.changes.mean(axis=0))

    def scatter(self, chosen: Mask) -> Array:
        """Standard deviation (N,) of what chosen (k,) coefficients change beside the mean."""
        apart = (self.changes - self.mean)[:, :, chosen]
        return np.asarray(np.sqrt((apart**2).sum(axis=2).mean(axis=0)))

    @property
    def mean_tool(self) -> Array:
        """Mean (n, c, k) over the courses."""
        return np.asarray(self.tool.mean(axis=0))

    def tool_rest(self, chosen: Mask) -> Array:
        """Mean square (c,) of what chosen (k,) coefficients do beside the mean, SI."""
        apart = (self.tool - self.mean_tool)[:, :, :, chosen]
        return np.asarray((apart**2).sum(axis=3).mean(axis=(0, 1)))

    @property
    def rms(self) -> float:
        """Root mean square change of the readings by all coefficients together, SI."""
        return float(np.sqrt((self.changes**2).sum(axis=2).mean()))

    def take(self, chosen: Mask) -> CourseColumns:
        """Some of the coefficients (k,)."""
        return CourseColumns(
            self.changes[:, :, chosen], self.tool[..., chosen], self.of_course[chosen]
        )

    def scaled(self, factor: float) -> CourseColumns:
        """The same of other sizes."""
        return dataclasses.replace(
            self, changes=factor * self.changes, tool=factor * self.tool
        )

    def joined(self, other: CourseColumns) -> CourseColumns:
        """These coefficients, then others of the same readings."""
        return CourseColumns(
            np.concatenate([self.changes, other.changes], axis=2),
            np.concatenate([self.tool, other.tool], axis=3),
            np.concatenate([self.of_course, other.of_course]),
        )

    @classmethod
    def of(
        cls,
        problem: GapProblem,
        courses: Sequence[Course],
        columns: ExpectedColumns,
        session: SessionStates,
        command: Array,
        reference: Reference,
        rng: np.random.Generator,
    ) -> CourseColumns:
        """What the columns change in the readings of a problem in each course.

        session  in which the columns were stated;  command (n, n_dof) of the workspace, SI
        """
        of_course = _depending(columns)
        part = columns.take(of_course) if of_course.any() else None
        changes, tool = [], []
        for number, course in enumerate(courses):
            used = dataclasses.replace(session, covariates=course.covariates)
            where = (used, problem.theta, command, reference, rng)
            if number == 0:
                changes.append(columns.changes(course.of(problem), session))
                tool.append(columns.workspace_maps(*where).raw)
                continue
            changes.append(changes[0].copy())
            tool.append(tool[0].copy())
            if part is not None:
                other = course.of(problem)
                changes[number][:, of_course] = part.changes(other, session)
                tool[number][:, :, of_course] = part.workspace_maps(*where).raw
        return cls(np.array(changes), np.array(tool), of_course)


def depends_on_course(effect: Effect) -> bool:
    """Whether an effect is a function of sense of travel, time or temperatures."""
    parts = [part.strip() for need in effect.needs for part in need.split(" or ")]
    return any(part.startswith(COURSE_NEEDS) for part in parts)


def _depending(columns: ExpectedColumns) -> Mask:
    """Which columns (k,) mix forms of effects that depend on the course."""
    ends = np.cumsum([len(form.names) for form in columns.forms])
    result = np.zeros(columns.mixing.shape[1], dtype=bool)
    blocks = np.split(columns.mixing, ends[:-1])
    for form, block in zip(columns.forms, blocks, strict=True):
        if depends_on_course(form.effect):
            result |= block.any(axis=0)
    return result


# The principal combinations of all effects' columns, in units of the noise, are unknowns of
# planned readings, of prior variance 1. What the others change, and what depends on the
# course, which is not recorded, counts as scatter of single readings, and as error of the
# tool that no reading can reduce.


#: change of all planned readings together, in units of the noise, below which a
#: combination is not seen
MIN_CHANGE = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedEffects:
    """u combinations of effects in planned readings."""

    #: change of the readings per unit, and by other combinations, SI
    readings: Nuisances
    #: (n, k, u) change of k pose components at n workspace poses per unit, SI
    tool: Array
    others: Array  #: (k,) mean square over the workspace by other combinations, SI
    columns: ExpectedColumns  #: all effects' columns
    session: SessionStates  #: in which the readings would be taken

    def of_size(self, factor: float) -> PlannedEffects:
        """The effects with all sizes times a factor; `columns` stay as they are."""
        changes = self.readings
        return dataclasses.replace(
            self,
            readings=Nuisances(factor * changes.columns, factor * changes.scatter),
            tool=factor * self.tool,
            others=factor**2 * self.others,
        )

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of effects."""
        return self.columns.discrepancy.names

    @classmethod
    def of(
        cls,
        courses: CourseColumns,
        columns: ExpectedColumns,
        session: SessionStates,
        sigma: Array,
        most: int,
    ) -> PlannedEffects:
        """The combinations that planned readings show.

        courses  `columns` in the courses that the session may take
        sigma    (N,) noise of the readings, SI
        most     combinations that are unknowns: more describe the effects better, and a
                 search with them takes longer
        """
        changes = courses.mean
        _, sizes, rows = np.linalg.svd(changes / sigma[:, None], full_matrices=False)
        combinations = rows[:most][sizes[:most] > MIN_CHANGE].T
        change = changes @ combinations
        others = np.maximum((changes**2).sum(axis=1) - (change**2).sum(axis=1), 0.0)
        scatter = np.hypot(np.sqrt(others), courses.scatter(courses.of_course))
        tool = courses.mean_tool @ combinations
        total = (courses.mean_tool**2).sum(axis=2) - (tool**2).sum(axis=2)
        rest = courses.tool_rest(courses.of_course)
        return cls(
            readings=Nuisances(change, scatter),
            tool=tool,
            others=np.maximum(total, 0.0).mean(axis=0) + rest,
            columns=columns,
            session=session,
        )
