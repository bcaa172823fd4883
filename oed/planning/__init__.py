"""Plans of several measurements in stages within a time, and their certificate.

Goal               accuracy that plans are judged by
Option             a measurement that a stage may take, with its candidates
PlanSearchResult   the best plan, its bound and the plans beside it
PlanStage          one stage: its readings, its time, and the knowledge that it leaves
PlanStreams        random streams of a search
StageMemory        stages that searches have predicted
StagePlan          a sequence of stages
StageRealisation   a stage on virtual machines
ToolErrors         what effects beside the geometry do to the tool
build_option       an option from series of a measurement
covariance_of_all  what all candidates of all options leave
predict_plan       a plan of given candidates
propagate          virtual machines carried exactly through a plan
search_plan        the best plan within a time
workspace_goal     the goal over a workspace
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.planning.goal import Goal, ToolErrors, workspace_goal
    from oed.planning.option import Option, build_option
    from oed.planning.prediction import PlanStage
    from oed.planning.problem import (
        PlanStreams,
        StageMemory,
        StagePlan,
        covariance_of_all,
        predict_plan,
    )
    from oed.planning.search import PlanSearchResult, search_plan
    from oed.planning.virtual_machines import StageRealisation, propagate
else:
    # imported when first used: fits of virtual machines take time to load
    __getattr__ = door(__name__)
