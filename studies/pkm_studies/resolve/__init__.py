"""Turns a study's tables into the kernel's objects, in SI units.

resolve                      the objects of a study
ResolvedStudy                a study as the kernel's objects
described_machine            the machine of a table [machine]
study_machine                the model with the study's numbers
study_kinematics             its kinematics
check_home                   an error where a machine does not close at home
replace_nominal              a machine with other nominal numbers
unreachable                  a sentence on poses that joints do not reach
replace_mean_and_covariance  a machine with other nominal numbers and their covariance
DesignRequest                what [design] means to the kernel
CommandRanges                lower and upper ends of each command, by set-up
PlanRequest                  what [plan] means to the kernel
StudyWorkspace               where a study's machine is used: commands, axes, reference
PredictionRequest            what [prediction] means to the kernel
GapRequest                   what [gap] means to the kernel
ActingEffect                 an effect of the virtual machine
GapDesignRequest             what [gap.design] means to the kernel
PASS_SUFFIX                  how a run's name ends in that of its pass
Circles                      circles of readings, for a map of the condition number
reference_command            the pose that a plan repeats to see heat
ToolPoints                   tool points of commands, and commands of tool points
conventions_listing          the catalogue of a kind, with frames and columns
readings_comments            lines that open a file of readings: frames and columns
comments_of                  such lines of a machine with its set-ups
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.resolve.conventions import (
        comments_of,
        conventions_listing,
        readings_comments,
    )
    from pkm_studies.resolve.design import CommandRanges, DesignRequest
    from pkm_studies.resolve.gap import (
        PASS_SUFFIX,
        ActingEffect,
        GapDesignRequest,
        GapRequest,
    )
    from pkm_studies.resolve.grids import Circles, reference_command
    from pkm_studies.resolve.machine import (
        check_home,
        described_machine,
        replace_nominal,
        study_kinematics,
        study_machine,
    )
    from pkm_studies.resolve.plan import PlanRequest
    from pkm_studies.resolve.prediction import (
        PredictionRequest,
        StudyWorkspace,
        unreachable,
    )
    from pkm_studies.resolve.resolved import ResolvedStudy, resolve
    from pkm_studies.resolve.tolerances import replace_mean_and_covariance
    from pkm_studies.resolve.tool_points import ToolPoints
else:
    __getattr__ = door(__name__)
