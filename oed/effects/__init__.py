"""What effects at their expected sizes do to readings and to poses over the workspace.

ActingForm        an effect at its constants, with the coefficients that count
SessionStates     states of a session, from which those of the workspace are drawn
ExpectedColumns   effects at their expected sizes, as columns of the readings
expected_columns  the columns of the effects that a machine can have
ExpectedEffect    errors by one effect that a model lacks
ExpectedEffects   errors by all of them
expected_effects  these errors, through calibration to the workspace
absorbing_shift   how far the parameters move that absorb effects
Course            a course that a planned session may take
draw_courses      courses in pairs of opposite sides
CourseColumns     changes of planned readings over courses
course_changes      what columns change in each course
PlannedEffects    combinations of effects that planned readings show
planned_effects   the combinations of largest change
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.effects.columns import ExpectedColumns, expected_columns
    from oed.effects.courses import Course, CourseColumns, course_changes, draw_courses
    from oed.effects.effect_maps import ActingForm, SessionStates, absorbing_shift
    from oed.effects.planned import PlannedEffects, planned_effects
    from oed.effects.unmodelled import (
        ExpectedEffect,
        ExpectedEffects,
        expected_effects,
    )
else:
    __getattr__ = door(__name__)
