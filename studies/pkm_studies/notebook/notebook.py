"""The steps of a study one by one, for notebooks and scripts: `import oed` offers them.

Each function takes a study or the view that an earlier one returned, and returns a view:
a result that shows itself as a table and keeps the kernel's objects.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import msgspec

from oed.base import Array
from oed.measurement import Measurement
from oed.result import StudyResult
from pkm_studies import shipped
from pkm_studies.base import Silent
from pkm_studies.notebook.views import (
    AccuracyView,
    DesignView,
    DiagnosisView,
    EstimateView,
    PlanView,
    PosteriorView,
    ReadingsView,
    Said,
    View,
)
from pkm_studies.stages import (
    Fitted,
    Measured,
    designed,
    diagnosed,
    fit_checked,
    planned,
    predict_accuracy,
    recorded,
    result_so_far,
    run_study,
    sample_posterior,
    simulated,
)
from pkm_studies.study import Study
from pkm_studies.user_code import Consent, Origin


def load_study(study: str | Path, *, allow_code: bool = False) -> Study:
    """A study file, or a shipped study by its name. Raises InputError.

    `allow_code` lets Python files that it names run, now and while they are unchanged.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> study.name
    'planar_step_calibration'
    """
    permission = Consent.from_call(allow_code=allow_code)
    return Study.load(shipped.study_path(Path(study)), permission)


def build_study(
    tables: Mapping[str, Any], folder: str | Path = ".", *, allow_code: bool = False
) -> Study:
    """A study from tables as in a study file; paths are relative to `folder`.

    `allow_code` lets Python files that it names run, now and while they are unchanged.
    Raises InputError that names table, field, value and remedy.

    >>> import oed
    >>> study = oed.build_study(
    ...     {
    ...         "name": "gauge",
    ...         "machine": {"model": "planar_2dof"},
    ...         "setup": [{"name": "gauge", "instrument": "rm4"}],
    ...     }
    ... )
    >>> study.setup[0].instrument
    'rm4'
    """
    return Study.from_tables(
        tables, Path(folder), Consent.from_call(allow_code=allow_code)
    )


def choose_design(study: Study, *, seed: int | None = None) -> DesignView:
    """Choose the readings that [design] asks for, with their certificate.

    Raises InputError where the study has no candidates.

    >>> import oed
    >>> design = oed.choose_design(oed.load_study("a3_ball_bar"))
    >>> design.section.n
    30
    >>> design.section.efficiency > 0.9
    True
    """
    return DesignView(designed(study, seed))


def plan(study: Study, *, seed: int | None = None) -> PlanView:
    """Plan which measurement to do at which stage, by [plan].

    Raises InputError where the study lists no measurement, or none fits the time.

    >>> import oed
    >>> plan = oed.plan(oed.load_study("planar_plan"))
    >>> plan.section.stages[0].measurement
    'RM 4'
    """
    return PlanView(planned(study, None, seed, Silent()))


def read_readings(study: Study, *files: str | Path) -> ReadingsView:
    """Readings of files (of the study's own, if none is given). Raises InputError.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> readings = oed.simulate(study)
    >>> readings.to_pandas().to_csv("mine.csv", index=False)
    >>> oed.read_readings(study, "mine.csv").title
    '45 readings, recorded'
    """
    paths = [Path(file) for file in files] or None
    return ReadingsView(recorded(study, paths))


def simulate(source: Study | DesignView | PlanView) -> ReadingsView:
    """Readings of a virtual machine at the planned poses.

    Its parameters are those of [readings] truth, or drawn within their tolerances.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> readings = oed.simulate(study)
    >>> readings.title
    '45 readings, of a virtual machine'
    """
    return ReadingsView(
        simulated(source if isinstance(source, Study) else source.state)
    )


def identify(
    readings: ReadingsView,
    *,
    estimate_noise: bool | None = None,
    start: Mapping[str, float] | None = None,
    stages: Sequence[Sequence[str]] | None = None,
    effects: str | Sequence[str] | None = None,
) -> EstimateView:
    """Fit the parameters by least squares with tolerance priors.

    estimate_noise  estimate the noise law from the readings, or take it as stated; as
                    [noise] estimate says by default
    start           parameters, SI, where the fit begins; the others begin at nominal
    stages          patterns of the parameters freed in turn (`[["dq*"], ["*"]]`); as
                    [identify] stages says by default
    effects         what the readings are asked about beside the geometry: "catalogue", or
                    names; by default the geometry alone is fitted, and `diagnose` asks

    Raises IdentificationError where the fit fails, and ValueError for a start that
    names no parameter.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> estimate = oed.identify(oed.simulate(study))
    >>> estimate.names[:3]
    ('D', 'z1', 'z2')
    >>> estimate.theta.shape == estimate.sd.shape
    True
    """
    state = _add_readings(readings)
    if effects is not None:
        table = msgspec.structs.replace(
            state.study.identify, effects=_effects_value(effects)
        )
        study = msgspec.structs.replace(state.study, identify=table)
        resolved = dataclasses.replace(state.resolved, study=study)
        state = state.replace(study=study, resolved=resolved)
    if estimate_noise is not None:
        noise = msgspec.structs.replace(state.study.noise, estimate=estimate_noise)
        study = msgspec.structs.replace(state.study, noise=noise)
        state = state.replace(study=study)
    if stages is not None:
        patterns = tuple(tuple(stage) for stage in stages)
        resolved = dataclasses.replace(state.resolved, identification_stages=patterns)
        state = state.replace(resolved=resolved)
    theta = None if start is None else _start_of(state.measurement, start)
    fitted = fit_checked(state, theta)
    if effects is None or effects == "none":
        return EstimateView(fitted)
    return EstimateView(diagnosed(fitted))


def _add_readings(source: Any) -> Measured:
    """The state of readings. Raises InputError where there are none."""
    state = getattr(source, "state", None)
    if isinstance(state, Measured):
        return state
    study = source if isinstance(source, Study) else getattr(state, "study", None)
    if study is None:
        raise TypeError(f"readings are needed, here is {type(source).__name__}")
    raise study.location.error(
        "there are no readings to identify from",
        'take `oed.read_readings(study, "mine.csv")`, or `oed.simulate(study)`',
    )


def _effects_value(
    effects: str | Sequence[str],
) -> Literal["none", "catalogue"] | list[str]:
    """Effects as [identify] has them; a single name is a list of one."""
    if effects == "none":
        return "none"
    if effects == "catalogue":
        return "catalogue"
    return [effects] if isinstance(effects, str) else list(effects)


def _start_of(measurement: Measurement, start: Mapping[str, float]) -> Array:
    """Nominal parameters (n,), SI, with those of `start` in their place."""
    unknown = [name for name in start if name not in measurement.names]
    if unknown:
        raise ValueError(
            f"start: {unknown[0]!r} is no parameter; they are"
            f" {', '.join(measurement.names)}."
        )
    theta = measurement.nominal.copy()
    for name, value in start.items():
        theta[measurement.names.index(name)] = value
    return theta


def sample(estimate: EstimateView) -> PosteriorView:
    """Sample the posterior about an estimate, as [posterior] says.

    Raises WithheldError where [posterior] is off.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> posterior = oed.sample(oed.identify(oed.simulate(study)))
    >>> posterior.title
    'Posterior of ... draws'
    """
    return PosteriorView(sample_posterior(estimate.state))


def predict(
    source: DesignView | ReadingsView | EstimateView, *, virtual_machines: int = 0
) -> AccuracyView:
    """Predict the residual accuracy over the workspace of [prediction].

    `virtual_machines` are read, identified and compensated to check the prediction.
    Raises InputError where the study has no such table, and WithheldError where the fit
    is bad.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> accuracy = oed.predict(oed.identify(oed.simulate(study)))
    >>> list(accuracy.section.components)
    ['y', 'z']
    """
    state = source.state
    study, request = state.study, state.resolved.prediction
    if request is None:
        raise study.location.key("prediction").error(
            "the study does not say where accuracy counts",
            "add [prediction] with a workspace, see `oed schema study`",
        )
    table = msgspec.structs.replace(request.table, virtual_machines=virtual_machines)
    request = dataclasses.replace(request, table=table)
    resolved = dataclasses.replace(state.resolved, prediction=request)
    state = state.replace(resolved=resolved)
    return AccuracyView(predict_accuracy(state))


def diagnose(source: ReadingsView | EstimateView) -> DiagnosisView:
    """Find which effects cause what calibration leaves of the readings.

    The same as `oed diagnose`, with `corrected` and the mixture of the section. Raises
    WithheldError where a mistake in the readings explains their misfit.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> diagnosis = oed.diagnose(oed.simulate(study))
    >>> diagnosis.section.verdict
    'none'
    """
    state = _add_readings(source)
    if not isinstance(state, Fitted):
        state = fit_checked(state)
    return DiagnosisView(diagnosed(state))


def next_reading(study: Study, readings: str | Path, *, wanted: str = "") -> Said:
    """The best next reading after those of a file, and whether to stop.

    wanted  rms errors at which to stop, `z_um=30,theta_arcsec=5`; by default the study's

    Raises InputError.

    >>> import oed
    >>> study = oed.load_study("a3_ball_bar")
    >>> oed.simulate(study).to_pandas().head(6).to_csv("few.csv", index=False)
    >>> advice = oed.next_reading(study, "few.csv")
    >>> 0.0 < advice.outcome.gain < 1.0
    True
    """
    from pkm_studies.sessions import Adviser

    adviser = Adviser(study, wanted)
    advice = adviser.advise(Path(readings))
    return Said(tuple(adviser.advice_sentences(advice)), advice)


def verify(
    folder: str | Path, readings: str | Path | None = None, *, promise: str = ""
) -> Said:
    """Plan the acceptance test of the result in a folder, or judge its readings.

    readings  the filled-in acceptance.csv of that folder; without, the test is planned
    promise   rms errors to confirm, `z_um=30`; by default the predicted ones

    Raises InputError.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> result = oed.run(study, "out/planar")
    >>> oed.verify("out/planar").sentences[-1]
    'To fill in: out/planar/acceptance.csv'
    """
    from pkm_studies import acceptance

    if readings is not None:
        verdict = acceptance.judge_folder(Path(folder), Path(readings))
        return Said(tuple(acceptance.verdict_sentences(verdict)), verdict)
    section, path = acceptance.plan_folder(Path(folder), promised=promise)
    sentences = acceptance.plan_sentences(section)
    return Said((*sentences, f"To fill in: {path}"), section)


def run(
    study: Study, out: str | Path | None = None, *, seed: int | None = None
) -> StudyResult:
    """Run all that the study asks for; files and reports in `out` (`out/NAME`).

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> result = oed.run(study, "out/planar")
    >>> result.study
    'planar_step_calibration'
    """
    folder = Path("out") / study.name if out is None else Path(out)
    return run_study(study, folder, seed=seed)


def write_report(view: View[Any], out: str | Path) -> tuple[Path, ...]:
    """HTML and PDF reports of all steps that led to a view, in the folder `out`.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> estimate = oed.identify(oed.simulate(study))
    >>> [path.name for path in oed.write_report(estimate, "out/report")]
    ['report.html', 'report.pdf']
    """
    from pkm_reports import write_report

    return write_report(result_so_far(view.state), Path(out))


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

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> estimate = oed.identify(oed.simulate(study))
    >>> [path.name for path in oed.write_compensation(estimate, "json", "out/control")]
    ['compensation.json']
    """
    from pkm_studies.compensation import export_result, named_format

    permission = view.state.study.consent
    controller = named_format(to, Origin.command(permission))
    result = result_so_far(view.state)
    study = view.state.study
    folder = Path(out)
    return export_result(
        result, study, controller, folder, force=force, commands=commands
    ).paths
