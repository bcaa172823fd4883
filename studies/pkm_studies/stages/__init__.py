"""What a study asks for: each step takes the state of a run and returns the next.

run_study           all that a study asks for, into a folder
diagnose_study      fit readings, and diagnose what the fit leaves, into a folder
plan_study          the plan of stages alone, into a folder
forecast_study      the nodes of a forecast compensation, or their fit, into a folder
simulate_study      readings of a virtual machine, into a file
RunState            what was asked for, and the result so far
Scheduled           a run whose readings are known, planned or taken
Measured            a run whose readings have values
Fitted              a run whose readings are fitted
written             a section of the result, or an error that says why there is none
designed            the state with the chosen design
planned             the state with the plan of stages
recorded            the state with recorded readings
checked             the state with readings of a dataset, checked
simulated           the state with readings of a virtual machine
fit_checked         the state with a fit of its readings, checked before
sample_posterior    the state with draws about its estimate
predict_accuracy    the state with the accuracy that it predicts
diagnosed           the state with a diagnosis, and what follows from it
diagnose_always     the state with a diagnosis alone
result_so_far       the result of a state's steps
scheduled           the state that virtual machines of a campaign are read from
virtual_fit         a fit of the readings of such a machine
check_inputs        remarks on a study that is sound; errors as its run would raise them
check_dataset       what a check finds in readings
select_design       the chosen candidates of a study, without their section
estimate_section    an estimate as the result holds it
measured_curves     readings along circles and lines, as the result holds them
compensated_series  readings at the joints of a controller with other parameters
forecast_sentences  a forecast in sentences
report_outcome      print a result, and return the exit code
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.stages.design.select import select_design
    from pkm_studies.stages.fit.estimate import (
        check_dataset,
        estimate_section,
        sample_posterior,
    )
    from pkm_studies.stages.fit.run_curves import compensated_series, measured_curves
    from pkm_studies.stages.forecast import forecast_sentences
    from pkm_studies.stages.gap.diagnosis import diagnose_always
    from pkm_studies.stages.headline import report_outcome
    from pkm_studies.stages.order import (
        checked,
        designed,
        diagnosed,
        fit_checked,
        planned,
        recorded,
        result_so_far,
        scheduled,
        simulated,
        virtual_fit,
    )
    from pkm_studies.stages.pipeline import (
        diagnose_study,
        forecast_study,
        plan_study,
        run_study,
        simulate_study,
    )
    from pkm_studies.stages.predict.prediction import predict_accuracy
    from pkm_studies.stages.readings import check_inputs
    from pkm_studies.stages.run_state import (
        Fitted,
        Measured,
        RunState,
        Scheduled,
        written,
    )
else:
    __getattr__ = door(__name__)
