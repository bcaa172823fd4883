"""What planned readings leave where some effects' covariates are recorded, others not.

Recorded columns are those of a course, G(z), and the error is the mean over courses. The
others count by their moments (`oed.compensate.effects.course_columns`). A thermometer adds
its own uncertainty as scatter: u(T) times the change per kelvin.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array, Mask
from oed.compensate.effects.course_columns import CourseColumns
from oed.compensate.effects.remaining_error import RemainingError, remaining_error

#: standard uncertainty of a thermometer on a machine, K: of class A, and its contact
THERMOMETER = 0.2
#: most courses over which errors with a recorded covariate are averaged
AVERAGED = 4


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedReadings:
    """N readings and the n unknowns beside effects.

    white        (N, n) slopes, per prior standard deviation, in units of the noise
    sigma        (N,) noise, SI
    information  (n, n) of the prior
    slopes       (p, c, n) pose errors at p poses, SI
    """

    white: Array
    sigma: Array
    information: Array
    slopes: Array

    def predict(
        self, effects: CourseColumns, recorded: Mask, extra: Array
    ) -> list[RemainingError]:
        """Errors in some courses with recorded (k,) columns; one where none is.

        extra  (N,) standard deviation of further scatter, SI
        """
        hidden = effects.of_course & ~recorded
        scatter = np.hypot(effects.scatter(hidden), extra)
        rest = effects.tool_rest(hidden)
        count = min(len(effects.changes), AVERAGED) if recorded.any() else 1
        errors = []
        for number in range(count):
            columns, tool = effects.mean, effects.mean_tool
            columns[:, recorded] = effects.changes[number][:, recorded]
            tool[:, :, recorded] = effects.tool[number][:, :, recorded]
            errors.append(self._remaining(columns, tool, scatter, rest))
        return errors

    def _remaining(
        self, columns: Array, tool: Array, scatter: Array, rest: Array
    ) -> RemainingError:
        weight = self.sigma / np.hypot(self.sigma, scatter)
        of_effects = columns / self.sigma[:, None]
        white = np.hstack([self.white, of_effects]) * weight[:, None]
        unknowns, first = white.shape[1], self.white.shape[1]
        information = np.eye(unknowns)
        information[:first, :first] = self.information
        slopes = np.concatenate([self.slopes, tool], axis=2)
        return remaining_error(white, information, slopes, rest)


def thermometer_scatter(effects: CourseColumns, kelvin: Array) -> Array:
    """Scatter (N,) by a thermometer's uncertainty, SI.

    effects  what depends on the body's temperature;  kelvin (d, r) in each course, K
    """
    square = (effects.changes**2).sum(axis=2).mean(axis=0)
    return np.asarray(THERMOMETER * np.sqrt(square / np.mean(kelvin**2)))
