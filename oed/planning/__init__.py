"""Plans of several measurements in stages within a time, and their certificate.

Goal               accuracy that plans are judged by
Option             a measurement that a stage may take, with its candidates
PlanProblem        what to plan, and the stages predicted for it
PlanSearchResult   the best plan, its bound and the plans beside it
PlanningTask       what to plan for one machine, and the searches for its plans
PlanStage          one stage: its readings, its time, and the knowledge that it leaves
PlanStreams        random streams of a search
StageMemory        stages that searches have predicted
StagePlan          a sequence of stages
build_option       an option from series of a measurement
propagate          virtual machines carried exactly through a plan
search_plan        the best plan within a time
workspace_goal     the goal over a workspace
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.planning.goal import Goal, workspace_goal
    from oed.planning.option import Option, build_option
    from oed.planning.prediction import PlanStage
    from oed.planning.problem import PlanProblem, PlanStreams, StageMemory, StagePlan
    from oed.planning.search import PlanningTask, PlanSearchResult, search_plan
    from oed.planning.virtual_machines import propagate
else:
    # imported when first used: fits of virtual machines take time to load
    __getattr__ = door(__name__)
