"""Effects at their expected sizes, as few unknowns of planned readings.

The principal combinations of all effects' columns, in units of the noise, are unknowns of
prior variance 1. What the others change counts as scatter of single readings, and as
error of the tool that no reading can reduce. So does what depends on the course of the
session, which is not recorded (`oed.effects.courses`).
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array
from oed.design import Nuisances
from oed.effects.columns import ExpectedColumns
from oed.effects.courses import CourseColumns
from oed.effects.effect_maps import SessionStates

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
