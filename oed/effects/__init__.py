"""What effects at their expected sizes do to readings and to poses over the workspace.

SessionStates     states of a session, from which those of the workspace are drawn
ExpectedColumns   effects at their expected sizes, as columns of the readings
ExpectedEffect    errors by one effect that a model lacks
ExpectedEffects   errors by all of them
absorbing_shift   how far the parameters move that absorb effects
Course            a course that a planned session may take
CourseColumns     changes of planned readings over courses
PlannedEffects    combinations of effects that planned readings show
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.effects.columns import ExpectedColumns
    from oed.effects.courses import Course, CourseColumns, PlannedEffects
    from oed.effects.effect_maps import SessionStates, absorbing_shift
    from oed.effects.unmodelled import ExpectedEffect, ExpectedEffects
else:
    __getattr__ = door(__name__)
