"""The steps of a study one by one, for notebooks and scripts: `import oed` offers them.

Each function takes a study or the view that an earlier one returned, and returns a view:
a result that shows itself as a table and keeps the kernel's objects.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import msgspec

from oed.result import StudyResult
from pkm_studies import pipeline
from pkm_studies.base.progress import Silent
from pkm_studies.base.user_code import Origin, consent
from pkm_studies.catalogue import catalogue
from pkm_studies.notebook.views import (
    AccuracyView,
    DesignView,
    DiagnosisView,
    EstimateView,
    PlanView,
    PosteriorView,
    ReadingsView,
    View,
)
from pkm_studies.stages.run_state import (
    Fitted,
    Readings,
    Scheduled,
    promote,
    start,
)
from pkm_studies.stages.steps import design as design_steps
from pkm_studies.stages.steps import fit as fit_steps
from pkm_studies.stages.steps import gap as gap_steps
from pkm_studies.stages.steps import prediction as prediction_steps
from pkm_studies.stages.steps import readings as readings_steps
from pkm_studies.study import Study, load, loader, shipped


def load_study(study: str | Path, *, allow_code: bool = False) -> Study:
    """A study file, or a shipped study by its name. Raises InputError.

    `allow_code` lets Python files that it names run, now and while they are unchanged.
    """
    given = consent(allow_code=allow_code)
    return load(shipped.study_path(Path(study)), given)


def build_study(
    tables: Mapping[str, Any], folder: str | Path = ".", *, allow_code: bool = False
) -> Study:
    """A study from tables as in a study file; paths are relative to `folder`.

    `allow_code` lets Python files that it names run, now and while they are unchanged.
    Raises InputError that names table, field, value and remedy.
    """
    return loader.from_tables(tables, Path(folder), consent(allow_code=allow_code))


def choose_design(study: Study, *, seed: int | None = None) -> DesignView:
    """Choose the readings that [design] asks for, with their certificate.

    Raises InputError where the study has no candidates.
    """
    state = design_steps.select_design(start(study, seed, Silent(), []))
    if state.design is None:
        raise study.place.key("design").error(
            "the study has no candidates to choose from", "add [[design.candidates]]"
        )
    readings = Readings(series=state.design.series)
    scheduled = promote(Scheduled, state, readings=readings)
    scheduled, verdict = design_steps.analyse_identifiability(scheduled)
    return DesignView(design_steps.report_design(scheduled, verdict))


def plan(study: Study, *, seed: int | None = None) -> PlanView:
    """Plan which measurement to do at which stage, by [plan].

    Raises InputError where the study lists no measurement, or none fits the time.
    """
    return PlanView(pipeline.planned_state(study, None, seed, Silent()))


def read_readings(study: Study, *files: str | Path) -> ReadingsView:
    """Readings of files (of the study's own, if none is given). Raises InputError."""
    paths = [Path(file) for file in files] or None
    state = start(study, None, Silent(), paths)
    data = state.resolved.dataset
    if data is None:
        raise study.place.key("readings").error(
            "the study names no readings", "give a file, or add [readings] files"
        )
    return ReadingsView(readings_steps.take_recorded(state, data))


def simulate(source: Study | DesignView | PlanView) -> ReadingsView:
    """Readings of a virtual machine at the planned poses.

    Its parameters are those of [readings] truth, or drawn within their tolerances.
    """
    if not isinstance(source, Study):
        return ReadingsView(readings_steps.take_simulated(source.state))
    state = design_steps.select_design(start(source, None, Silent(), []))
    state = design_steps.plan_stages(state)
    return ReadingsView(readings_steps.take_simulated(state))


def identify(readings: ReadingsView) -> EstimateView:
    """Fit the parameters by least squares with tolerance priors.

    Raises IdentificationError where the fit fails.
    """
    return EstimateView(fit_steps.fit_parameters(readings.state))


def sample(estimate: EstimateView) -> PosteriorView:
    """Sample the posterior about an estimate, as [posterior] says."""
    return PosteriorView(fit_steps.sample_posterior(estimate.state))


def predict(
    source: DesignView | ReadingsView | EstimateView, *, virtual_machines: int = 0
) -> AccuracyView:
    """Predict the residual accuracy over the workspace of [prediction].

    `virtual_machines` are read, identified and compensated to check the prediction.
    Raises InputError where the study has no such table.
    """
    state: Scheduled = source.state
    study, request = state.study, state.resolved.prediction
    if request is None:
        raise study.place.key("prediction").error(
            "the study does not say where accuracy counts",
            "add [prediction] with a workspace, see `oed schema study`",
        )
    table = msgspec.structs.replace(request.table, virtual_machines=virtual_machines)
    request = dataclasses.replace(request, table=table)
    resolved = dataclasses.replace(state.resolved, prediction=request)
    state = state.replace(resolved=resolved)
    return AccuracyView(prediction_steps.predict_accuracy(state))


def diagnose(source: ReadingsView | EstimateView) -> DiagnosisView:
    """Find which effects cause what calibration leaves of the readings."""
    state = source.state
    if not isinstance(state, Fitted):
        state = fit_steps.fit_parameters(state)
    return DiagnosisView(gap_steps.diagnose_always(state))


def run(
    study: Study, out: str | Path | None = None, *, seed: int | None = None
) -> StudyResult:
    """Run all that the study asks for; files and reports in `out` (`out/NAME`)."""
    folder = Path("out") / study.name if out is None else Path(out)
    return pipeline.run(study, folder, seed=seed)


def write_report(view: View[Any], out: str | Path) -> tuple[Path, ...]:
    """HTML and PDF reports of all steps that led to a view, in the folder `out`."""
    from pkm_reports import write_report

    return write_report(_result(view.state), Path(out))


def write_compensation(
    view: View[Any],
    to: str,
    out: str | Path,
    *,
    force: bool = False,
    commands: int | None = None,
) -> tuple[Path, ...]:
    """Files that the controller reads, in the format `to` and the folder `out`.

    Formats are those of `oed list formats`; `commands` limits a table. Raises InputError, and BadFitError where
    the fit is bad, unless forced.
    """
    from pkm_studies.compensation.export import export
    from pkm_studies.stages.corrected.table_grid import COMMANDS

    given = view.state.study.consent
    controller = catalogue.controller_format(to, Origin.command(given))
    result, study, folder = _result(view.state), view.state.study, Path(out)
    largest = COMMANDS if commands is None else commands
    return export(
        result, study, controller, folder, force=force, commands=largest
    ).paths


def _result(state: Scheduled) -> StudyResult:
    return pipeline.assemble_result(design_steps.draw_machine(state))
