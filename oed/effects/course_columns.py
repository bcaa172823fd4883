"""What effects do to planned readings over the courses that a session may take.

Let G(z) b be the change of the readings by effects in the course z (sense of travel,
times, temperatures), with b ~ N(0, I). Where z is recorded, G(z) are columns as any
others. Where it is not, readings of independent courses have the moments

    E[G b] = 0,    cov(G b) = M M^T + diag(S^2),    M = E[G(z)],    S^2 = E[(G(z) - M)^2] 1.

The best linear estimate sees the mean columns M, and S as scatter of single readings.
Likewise the tool, in states that the machine is used in: the mean of its changes can be
known with the coefficients, the rest stays.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.accuracy.maps import Reference
from oed.base import Array, Mask
from oed.effects.columns import ExpectedColumns
from oed.effects.courses import Course
from oed.effects.effect_maps import SessionStates
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect

#: beginnings of what an effect needs that depends on the course of a session
COURSE = ("direction", "time", "temp_")


@dataclasses.dataclass(frozen=True, eq=False)
class CourseColumns:
    """Changes of N planned readings and of n poses by k coefficients over d courses.

    changes    (d, N, k) of the readings in each course, SI
    tool       (d, n, c, k) of c pose components in states drawn anew for each, SI
    of_course  (k,) which depend on the course
    """

    changes: Array
    tool: Array
    of_course: Mask

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


def depends_on_course(effect: Effect) -> bool:
    """Whether an effect is a function of sense of travel, time or temperatures."""
    parts = [part.strip() for need in effect.needs for part in need.split(" or ")]
    return any(part.startswith(COURSE) for part in parts)


def over_courses(
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
    return CourseColumns(np.array(changes), np.array(tool), of_course)


def _depending(columns: ExpectedColumns) -> Mask:
    """Which columns (k,) mix forms of effects that depend on the course."""
    ends = np.cumsum([len(form.names) for form in columns.forms])
    result = np.zeros(columns.mixing.shape[1], dtype=bool)
    blocks = np.split(columns.mixing, ends[:-1])
    for form, block in zip(columns.forms, blocks, strict=True):
        if depends_on_course(form.effect):
            result |= block.any(axis=0)
    return result
