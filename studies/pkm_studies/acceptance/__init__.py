"""The acceptance test of a compensated machine: promise, plan, judgement of its readings.

PromisedAccuracy   errors that a result promises over the workspace, with covariances
covariances        covariance of its parameters and of their tolerances, SI
plan_folder        plans the test of a result's folder, and writes the file to fill in
plan_sentences     what the plan demands, and how sure it is
ACCEPTANCE_FILE    name of that file
judge_folder       judges its readings
verdict_sentences  the judgement, component by component
check_folder       compares readings along runs with the prediction of the result
check_sentences    that comparison
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.acceptance.promise import PromisedAccuracy, covariances
    from pkm_studies.acceptance.verification import (
        ACCEPTANCE_FILE,
        check_folder,
        check_sentences,
        judge_folder,
        plan_folder,
        plan_sentences,
        verdict_sentences,
    )
else:
    __getattr__ = door(__name__)
