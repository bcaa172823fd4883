"""In which order the steps of a study follow: the only file that knows.

Lists of steps for a run into a folder; and, for notebooks and campaigns, the states that
several steps lead to.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from msgspec.structs import replace

from oed.base import Array
from oed.dataset import Dataset, reading_digests
from oed.result import StudyResult
from oed.verdict import accuracy_verdicts
from pkm_studies import describe
from pkm_studies.base import Progress, Silent
from pkm_studies.results import load_result
from pkm_studies.stages import headline
from pkm_studies.stages.correct.corrected import correct_for_effects, refuse_untestable
from pkm_studies.stages.correct.mixture import mix_answers
from pkm_studies.stages.design.section import (
    analyse_identifiability,
    draw_machine,
    plan_stages,
    report_design,
    report_single_stage,
    select_design,
)
from pkm_studies.stages.fit.estimate import (
    check_readings,
    fit_parameters,
    sample_posterior,
)
from pkm_studies.stages.forecast import forecast_errors
from pkm_studies.stages.gap.diagnosis import diagnose_always, diagnose_gap, preview_gap
from pkm_studies.stages.plan.task import read_earlier_session
from pkm_studies.stages.predict.prediction import predict_accuracy, predict_held_out
from pkm_studies.stages.readings import (
    plan_readings,
    simulate_readings,
    take_readings,
    take_recorded,
    take_simulated,
)
from pkm_studies.stages.run_state import Fitted, Measured, RunState, Scheduled, promote
from pkm_studies.study import Study

Step = Callable[[Any], Any]  #: takes a state of a run and returns the next


def steps_to_readings(readings_given: bool) -> list[Step]:
    """From a study to its readings: recorded, of a virtual machine, or planned.

    readings_given  whether readings came with the command: then no stages are planned
    """
    planning = _unless(readings_given, plan_stages)
    return [select_design, *planning, take_readings]


def steps_of_diagnosis(is_recorded: bool) -> list[Step]:
    """From a study to the diagnosis of its readings; recorded ones need no plan."""
    return [
        *_unless(is_recorded, select_design, plan_stages),
        take_readings,
        check_readings,
        analyse_identifiability,
        fit_parameters,
        diagnose_always,
        correct_for_effects,
        mix_answers,
        draw_machine,
    ]


def steps_from_readings(state: Scheduled) -> list[Step]:
    """From readings to accuracy: what the study asks for, of planned ones a forecast."""
    only_planned = not isinstance(state, Measured)
    fit = (fit_parameters, sample_posterior, diagnose_gap)
    return [
        *_unless(only_planned, check_readings, refuse_untestable),
        analyse_identifiability,
        report_design,
        preview_gap,
        *_unless(only_planned, *fit, correct_for_effects, mix_answers),
        predict_accuracy,
        *_unless(only_planned, predict_held_out),
        *_unless(state.study.forecast is None, forecast_errors),
        report_single_stage,
        draw_machine,
    ]


def designed(study: Study, seed: int | None) -> Scheduled:
    """The state with the chosen design and its verdict. Raises InputError."""
    state = select_design(RunState.start(study, seed, Silent(), []))
    if state.design is None:
        raise study.location.key("design").error(
            "the study has no candidates to choose from", "add [[design.candidates]]"
        )
    return report_design(analyse_identifiability(plan_readings(state)))


def recorded(study: Study, files: Sequence[Path] | None) -> Measured:
    """The state with unchecked readings, given or the study's. Raises InputError."""
    state = RunState.start(study, None, Silent(), files)
    data = state.resolved.dataset
    if data is None:
        raise study.location.key("readings").error(
            "the study names no readings", "give a file, or add [readings] files"
        )
    return take_recorded(state, data)


def checked(state: RunState, data: Dataset) -> Measured:
    """The state with recorded readings, checked; single outliers are set aside."""
    return check_readings(take_recorded(state, data))


def simulated(source: Study | RunState) -> Measured:
    """The state with readings of a virtual machine at the planned poses."""
    if isinstance(source, RunState):
        return take_simulated(source)
    return take_simulated(planned_state(source, None))


def planned_state(study: Study, seed: int | None) -> RunState:
    """The state with what the study plans, design or stages, and no readings."""
    return plan_stages(select_design(RunState.start(study, seed, Silent(), [])))


def scheduled(study: Study) -> Scheduled:
    """The state with the poses that a virtual machine is read at, as planned."""
    return plan_readings(planned_state(study, None))


def virtual_fit(state: Scheduled) -> Fitted:
    """Readings of the seed's virtual machine at the planned poses, fitted.

    Raises IdentificationError, AssemblyError, numpy.linalg.LinAlgError.
    """
    readings = simulate_readings(state, state.readings.series)
    return fit_parameters(promote(Measured, state, readings=readings))


def fit_checked(state: Measured, theta: Array | None = None) -> Fitted:
    """Check and fit readings from theta (n,), SI, or nominal. Raises IdentificationError."""
    return fit_parameters(analyse_identifiability(check_readings(state)), theta)


def diagnosed(state: Fitted) -> Fitted:
    """The diagnosis of what a fit leaves, and what follows from it."""
    return mix_answers(correct_for_effects(diagnose_always(state)))


def planned(
    study: Study, after: Path | None, seed: int | None, progress: Progress
) -> Scheduled:
    """The state of a run with the plan of stages. Raises InputError as a run of it."""
    state = RunState.start(study, seed, progress, [])
    if state.resolved.plan is None:
        raise study.location.path("plan", "measurement").error(
            "the study lists no measurement to plan with",
            "add [[plan.measurement]] tables",
        )
    earlier = None
    if after is not None:
        earlier_result = load_result(after)
        earlier = read_earlier_session(state.resolved, after, earlier_result)
        state = state.replace(resolved=earlier.resolved)
    of_plan = analyse_identifiability(plan_readings(plan_stages(state, earlier)))
    if of_plan.identifiability is not None:
        measurement = of_plan.identifiability.measurement
        of_plan = of_plan.replace(measurement=measurement)
    of_plan = draw_machine(of_plan)
    cause = of_plan.resolved.gap_design
    if cause is not None and cause.follows_plan:
        return preview_gap(of_plan)
    return of_plan


def result_so_far(state: Scheduled) -> StudyResult:
    """The result of a state's steps, with the drawing of the machine."""
    return assemble_result(draw_machine(state))


def assemble_result(state: RunState) -> StudyResult:
    """The result of the steps so far; without claims."""
    machine = state.resolved.machine
    setups = state.measurement.setups.values()
    info = describe.add_earlier_sessions(
        describe.machine_info(machine), state.study, state.resolved.measurement
    )
    is_recorded = state.resolved.dataset is not None
    series = state.readings.series if isinstance(state, Scheduled) else ()
    readings: list[str] = []
    if isinstance(state, Measured):
        readings = reading_digests(series, state.readings.y, state.measurement.setups)
    return replace(
        state.result,
        seed=state.seed,
        machine=info,
        readings=state.resolved.counted_digests(readings),
        setups=[describe.setup_info(machine, setup, series) for setup in setups],
        versions=describe.package_versions(),
        verdicts=accuracy_verdicts(state.result),
        headline=headline.sentences(state.result, is_recorded, info),
        warnings=list(dict.fromkeys(state.warnings)),
    )


def _unless(left_out: bool, *steps: Step) -> tuple[Step, ...]:
    return () if left_out else steps
