"""Acceptance test of a result's folder: its plan, and the judgement of its readings."""

import dataclasses
import shlex
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
from msgspec.structs import replace
from scipy import linalg, stats

from oed import csv_text, units, verdict
from oed.acceptance import MIN_POWER, AcceptancePlan, Promise, judge, positioning
from oed.base import Array, Index
from oed.dataset import commented
from oed.measurement import Measurement, Series
from oed.model import Component, Machine
from oed.result import (
    AcceptanceSection,
    Judgement,
    PromiseRecord,
    RunCurve,
    StudyResult,
    VerdictRecord,
    VerificationSection,
    finite_or_none,
)
from oed.text import format_p_value, rounded
from pkm_studies import csv_table, describe, result_folder
from pkm_studies.acceptance.promise import FurtherPromise, PromisedAccuracy
from pkm_studies.base import InputError, Location, Silent, Stream
from pkm_studies.compensation import result_study
from pkm_studies.csv_table import CsvTable
from pkm_studies.earlier_result import si_estimates
from pkm_studies.quantities import component_values
from pkm_studies.resolve import readings_comments, study_machine
from pkm_studies.results import (
    Estimated,
    estimated_section,
    load_result,
    refuse_bad_fit,
)
from pkm_studies.stages import RunState, compensated_series, measured_curves
from pkm_studies.user_code import Consent

# Compares readings along runs of the compensated machine with their prediction.

#: probability below which readings contradict their prediction
CONTRADICTION_P_VALUE = 1e-3


@dataclasses.dataclass(frozen=True)
class RunCheck:
    """Readings of the compensated machine against their prediction."""

    curves: list[RunCurve]  #: along circles and lines
    readings: int  #: number of values
    p_high: float  #: probability of a larger chi2

    @property
    def passed(self) -> bool:
        """Whether the prediction stands."""
        return self.p_high >= CONTRADICTION_P_VALUE


def check_folder(
    folder: Path,
    readings: Path,
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
) -> RunCheck:
    """Compare the readings with the result of a folder, and write the runs into it.

    Raises InputError where the result holds no estimate, where its commands are unknown
    or out of reach, and as readings are read; BadFitError where the fit promises
    nothing.
    """
    result = load_result(folder)
    location = Location(str(folder / "result.json"))
    section = estimated_section(result, folder)
    refuse_bad_fit(result)
    study = result_study(result, folder, study_file, consent)
    state = RunState.start(study, None, Silent(), [readings])
    data = state.resolved.dataset
    if data is None:
        raise location.error(
            f"{readings} has no readings", "give readings of the study"
        )
    measurement = state.resolved.measurement_with(set(data.setups))
    check = _compare(measurement, data.series, data.y, section)
    if check is None:
        raise location.error(
            "the compensated machine's joints are not known at these readings",
            "record commands within reach, not joints",
        )
    result = replace(result, after_compensation=check.curves)
    result_folder.rewrite(folder, result)
    return check


def _compare(
    measurement: Measurement, series: Sequence[Series], y: Array, section: Estimated
) -> RunCheck | None:
    """The comparison; None where the compensated joints are not known."""
    # what is known of the machine; set-ups are mounted anew
    theta = measurement.nominal.copy()
    covariance = np.array(measurement.prior_covariance)
    known = {p.name for p in measurement.machine.parameters} & {*section.parameters}
    places = [k for k, name in enumerate(measurement.names) if name in known]
    names = [measurement.names[k] for k in places]
    theta[places], of_machine = si_estimates(section, names)
    covariance[places] = covariance[:, places] = 0.0
    covariance[np.ix_(places, places)] = of_machine
    compensated = compensated_series(measurement, series, theta)
    if compensated is None:
        return None
    residual = y - measurement.readings(compensated, theta)
    jacobian = measurement.jacobian(compensated, theta)
    scale = 1.0  # of the stated noise, where the fit left more than it
    if section.dof > 0.0:
        scale = max(1.0, float(np.sqrt(section.chi2 / section.dof)))
    noise = np.diag((scale * measurement.sigma(series)) ** 2)
    total = jacobian @ covariance @ jacobian.T + noise
    count = len(measurement.machine.parameters)
    of_setup, of_parameters = jacobian[:, count:], covariance[count:, count:]
    root = linalg.cho_factor(total)
    weighed = linalg.cho_solve(root, residual)
    gain = of_setup @ of_parameters @ of_setup.T
    remaining = residual - gain @ weighed
    keep = np.eye(len(y)) - gain @ linalg.cho_solve(root, np.eye(len(y)))
    sd = np.sqrt(np.einsum("ij,jk,ik->i", keep, total, keep))
    return RunCheck(
        curves=measured_curves(measurement, series, y, y - remaining, sd),
        readings=len(y),
        p_high=float(stats.chi2.sf(residual @ weighed, len(y))),
    )


def check_sentences(check: RunCheck) -> Iterator[str]:
    """The comparison in words."""
    largest, unit = 0.0, ""
    inside = count = 0
    for curve in check.curves:
        error = np.abs(np.subtract(curve.measured, curve.predicted))
        inside += int((error <= curve.half_widths).sum())
        count += len(error)
        if error.max() > largest:
            largest = float(error.max())
            unit = curve.unit
    if count:
        runs = len({(curve.setup, curve.run) for curve in check.curves})
        yield (
            f"{inside} of {count} values read along {runs} runs lie inside their"
            f" 95 % interval; the largest difference from the prediction is {largest:.3g}"
            f" {unit}."
        )
    verdict = "agree with" if check.passed else "contradict"
    yield (
        f"The {check.readings} values read after compensation {verdict} their prediction"
        f" (p {format_p_value(check.p_high)})."
    )
    if not check.passed:
        yield (
            "Either the controller does not use this compensation, or the machine changed,"
            " or effects beside the parameters act: check the first two, then run"
            " `oed diagnose`."
        )


# Plans an acceptance test from a result: poses, limits and power.

#: share of the range of a coordinate by which a pose differs from a calibration pose
MIN_RANGE_SHARE = 0.02
ERROR = "error_{}_{}"  #: column of an error to fill in, by component and unit
#: column that says whether additional axes took the known errors back: 1, or 0 or empty
AXES = "further_axes"


def plan_section(
    result: StudyResult,
    accuracy: PromisedAccuracy,
    rng: np.random.Generator,
    *,
    power: float,
    most: int,
) -> AcceptanceSection:
    """The acceptance plan. Raises InputError where no other poses are left."""
    command = accuracy.command
    names = list(describe.displayed_command(accuracy.machine, command[0]))
    commands = [] if result.estimate is None else result.estimate.commands
    rows = [
        [float(units.to_si(c[n], units.split(n)[1])) for n in names] for c in commands
    ]
    used = np.array(rows).reshape(len(rows), len(names))
    # workspace poses that the calibration did not read
    candidates = np.arange(len(command))
    if len(used):
        size = np.ptp(np.vstack([command, used]), axis=0)
        scaled = np.where(size > 0.0, size, 1.0)
        distance = np.abs(command[:, None] - used[None]) / scaled
        candidates = np.flatnonzero(distance.max(axis=2).min(axis=1) > MIN_RANGE_SHARE)
    if not len(candidates):
        raise InputError(
            "every workspace pose is one of the calibration",
            "give more poses in [prediction] of the study",
        )
    plan = accuracy.promise.plan(candidates, rng, power=power, most=most)
    further = accuracy.further
    return AcceptanceSection(
        poses=[
            describe.displayed_command(accuracy.machine, accuracy.command[k])
            for k in plan.poses
        ],
        components=_demands(accuracy.components, accuracy.promise, plan),
        reference=accuracy.reference,
        miss=plan.miss,
        false_alarm=plan.false_alarm,
        conditions=list(accuracy.conditions),
        further={} if further is None else _further_demands(further, plan, rng),
        offsets=[] if further is None else _offsets(further, plan),
    )


def _demands(
    components: Sequence[Component], promise: Promise, plan: AcceptancePlan
) -> dict[str, PromiseRecord]:
    demands = {}
    for k, component in enumerate(components):
        unit = units.FINE[component.unit]
        demands[component.name] = PromiseRecord(
            promised=units.number(promise.rms[k], unit),
            limit=units.number(plan.limits[k], unit),
            confirms=finite_or_none(units.number(plan.confirms[k], unit)),
            power=float(plan.power[k]),
            uncertainty=units.number(promise.uncertainty[k], unit),
            unit=unit,
        )
    return demands


def _further_demands(
    further: FurtherPromise, plan: AcceptancePlan, rng: np.random.Generator
) -> dict[str, PromiseRecord]:
    """Demands at the same poses on what no drive corrects, with additional axes."""
    stated = further.promise.limits_at(plan.poses, rng, miss=plan.miss)
    demands = _demands(further.components, further.promise, stated)
    return {
        name: replace(demand, without=units.number(rms, demand.unit))
        for (name, demand), rms in zip(demands.items(), further.without, strict=True)
    }


def _offsets(further: FurtherPromise, plan: AcceptancePlan) -> list[dict[str, float]]:
    """Known errors at each pose without additional axes, in the components' fine units."""
    return [
        {
            c.name: units.number(value, units.FINE[c.unit])
            for c, value in zip(further.components, further.known[k], strict=True)
        }
        for k in plan.poses
    ]


def error_columns(components: Mapping[str, PromiseRecord]) -> dict[str, str]:
    """{component: its column in the file to fill in}."""
    return {n: ERROR.format(n, demand.unit) for n, demand in components.items()}


#: what an error is against a reference that has to be taken off
RELATIVE = {
    "home": "home: of the place, the error at home is subtracted; of the orientation R, the turn"
    " from home R R_home^T is compared with the commanded one, in the base frame",
    "best_fit": "best_fit: what is left after the one shift and turn that fits all measured"
    " errors best; those in the instrument's own frame hold its set-up as well",
}


def _comments(section: AcceptanceSection, machine: Machine) -> Iterator[str]:
    """Lines above the header: the frames, and what each column means."""
    yield from readings_comments(machine, {}, list(section.poses[0]))
    about = {c.name: c.about for c in machine.components}
    for name, column in error_columns(
        {**section.components, **section.further}
    ).items():
        yield f"{column}: {about[name]}; reference: {section.reference}"
    if section.reference in RELATIVE:
        yield RELATIVE[section.reference]
    if section.further:
        yield f"{AXES}: 1 where additional axes took the known errors back, else 0 or empty"


def acceptance_form(section: AcceptanceSection, machine: Machine) -> str:
    """CSV of the poses, with empty columns for the measured errors."""
    columns = list(error_columns(section.components).values())
    if section.further:
        columns += [*error_columns(section.further).values(), AXES]
    rows = [[*section.poses[0], "direction", *columns]]
    for pose in section.poses:
        values = [f"{value:.10g}" for value in pose.values()]
        rows.append([*values, "", *[""] * len(columns)])
    return commented(_comments(section, machine)) + csv_text.of_rows(rows)


# Judges the readings of an acceptance test.

#: largest difference of a commanded coordinate from the plan, in its unit
SAME_POSE = 1e-3


def judge_file(section: AcceptanceSection, path: Path) -> VerificationSection:
    """The judgement of a file that was filled in.

    A pose may stand in several rows: its errors are then averaged, and give the
    repeatability. Raises InputError for poses that the plan does not have or that the
    file lacks, and for cells that are no numbers.
    """
    table = csv_table.read(path)
    target = _targets(section, table)
    direction = np.full(len(table), np.nan)
    if "direction" in table.header:
        direction = table.numbers("direction", gaps=True)
    errors, figures = {}, {}
    for name, column in error_columns(section.components).items():
        values = table.numbers(column)
        errors[name] = _values_by_pose(values, target, len(section.poses))
        unit = section.components[name].unit
        positioning_figures = positioning(values, target, direction, unit)
        if positioning_figures is not None:
            figures[name] = positioning_figures
    components = judge(errors, section.components)
    further = _further(section, table, target)
    every = (*components.values(), *further.values())
    worst = verdict.overall(c.judgement for c in every)
    return VerificationSection(
        passed=worst == "pass",
        verdict=worst,
        readings=len(table),
        components=components,
        positioning=figures,
        further=further,
    )


def _further(
    section: AcceptanceSection, table: CsvTable, target: Index
) -> dict[str, VerdictRecord]:
    """Verdicts on what no drive corrects, as far as it was measured.

    Where additional axes were off, the errors that are known in advance are taken off, and
    where they were on, these are added for the error without them.
    """
    taken_back = np.zeros(len(table), dtype=bool)
    if AXES in table.header:
        taken_back = table.numbers(AXES, gaps=True) > 0.0
    verdicts = {}
    for name, column in error_columns(section.further).items():
        if column not in table.header or not any(table.cells(column)):
            continue
        demand = section.further[name]
        expected = np.array([offsets[name] for offsets in section.offsets])
        measured = table.numbers(column)
        known_of_rows = expected[target]
        with_axes = np.where(taken_back, measured, measured - known_of_rows)
        remaining = _values_by_pose(with_axes, target, len(expected))
        judged = judge({name: remaining}, {name: demand})[name]
        without = float(np.sqrt(np.mean((remaining + expected) ** 2)))
        verdicts[name] = replace(judged, without=without)
    return verdicts


def _values_by_pose(values: Array, target: Index, poses: int) -> Array:
    """Means (poses,) of values (n,) by planned pose."""
    return np.array([values[target == k].mean() for k in range(poses)])


def _targets(section: AcceptanceSection, table: CsvTable) -> Index:
    """Number of the planned pose of each row. Raises InputError."""
    names = list(section.poses[0])
    commanded = np.column_stack([table.numbers(name) for name in names])
    planned = np.array([[pose[n] for n in names] for pose in section.poses])
    distance = np.abs(commanded[:, None] - planned[None]).max(axis=2)
    target = distance.argmin(axis=1)
    for k, nearest in enumerate(distance.min(axis=1)):
        if nearest > SAME_POSE:
            raise table.error(
                k,
                names[0],
                "the acceptance plan has no such pose",
                "measure at the poses of acceptance.csv",
            )
    absent = sorted(set(range(len(planned))) - set(target.tolist()))
    if absent:
        pose = ", ".join(
            f"{n} = {planned[absent[0], i]:.6g}" for i, n in enumerate(names)
        )
        problem = f"{len(absent)} planned poses were not measured, the first at {pose}"
        remedy = "measure them: the stated power holds for the whole plan"
        raise InputError(problem, remedy, file=table.file)
    return np.asarray(target)


# What a plan said that a healthy machine of its kind reaches, beside the measured error.
def healthy_accuracy(
    result: StudyResult, plan: Path | None, demands: Mapping[str, PromiseRecord]
) -> dict[str, float]:
    """Rms of each demanded component that a plan with effects predicted, in its unit.

    plan  folder of `oed plan` or `oed run`; by default the result's own plan. Raises
          InputError where a folder's plan allows for no effects, or is of another machine.
    """
    planned = result if plan is None else load_result(plan)
    if planned.machine.name != result.machine.name:
        problem = f"that is a plan for the machine {planned.machine.name}"
        remedy = f"name a plan for {result.machine.name}"
        raise InputError(problem, remedy, field="--plan", value=str(plan))
    accuracy = _predicted(planned)
    if plan is not None and not accuracy:
        raise InputError(
            "its plan allows for no effects, and says nothing of a healthy machine",
            'plan with effects = "catalogue" in [plan] or [design]',
            file=str(plan / "result.json"),
            field="--plan",
        )
    keys = {name: f"{name}_{demand.unit}" for name, demand in demands.items()}
    return {name: accuracy[key] for name, key in keys.items() if key in accuracy}


def _predicted(result: StudyResult) -> Mapping[str, float]:
    """Accuracy of the plan, else of the design, on a machine with effects."""
    if result.plan is not None and result.plan.effects is not None:
        return result.plan.accuracy
    if result.design is not None and result.design.effects is not None:
        return result.design.effects.accuracy
    return {}


def healthy_sentences(section: VerificationSection) -> list[str]:
    """The measured errors beside those of a healthy machine; none without a plan."""
    sentences = []
    for name, rms in section.healthy.items():
        verdict = section.components[name]
        times = verdict.rms / rms
        sentences.append(
            f"{name}: the plan predicted {rounded(rms, 3)} {verdict.unit} rms for a healthy machine,"
            f" with all that is known corrected; measured are {rounded(verdict.rms, 3)}"
            f" {verdict.unit}, {rounded(times)} times that."
        )
    return sentences


ACCEPTANCE_FILE = "acceptance.csv"
CONCLUSIONS: Final[dict[Judgement, str]] = {
    "pass": "The machine meets its promised accuracy.",
    "fail": "The machine does not meet its promised accuracy.",
    "cannot tell": (
        "Whether the machine meets its promised accuracy, this test cannot tell: measure"
        " more accurately, or at more poses."
    ),
}


def plan_folder(
    folder: Path,
    *,
    promised: str = "",
    uncertainty: str = "",
    power: float = 0.9,
    most: int = 12,
    study_file: Path | None = None,
    consent: Consent = Consent.RECORDED,
    planned: Path | None = None,
) -> tuple[AcceptanceSection, Path]:
    """Plan the acceptance test of a result; the section, and the file to fill in.

    promised, uncertainty  `z_um=30,theta_arcsec=20`, in place of the predicted rms and
                           of the study's instrument
    power                  asked for
    most                   poses at most
    study_file             study, where it names a machine in a file of its own
    consent                to run that file
    planned                folder of the plan that said what a healthy machine reaches

    Raises InputError, and BadFitError where the fit promises nothing.
    """
    result = load_result(folder)
    refuse_bad_fit(result)
    study = result_study(result, folder, study_file, consent)
    machine = study_machine(study)
    accuracy = PromisedAccuracy.from_result(
        result,
        study,
        folder,
        component_values(promised, "--promise", machine),
        component_values(uncertainty, "--uncertainty", machine),
    )
    rng = Stream.ACCEPTANCE.rng(result.seed)
    section = plan_section(result, accuracy, rng, power=power, most=most)
    healthy = healthy_accuracy(result, planned, section.components)
    section = replace(section, healthy=healthy)
    result = replace(result, acceptance=section, verification=None)
    texts = {ACCEPTANCE_FILE: acceptance_form(section, machine)}
    _, (path,) = result_folder.add_files(folder, result, texts)
    return section, path


def judge_folder(folder: Path, readings: Path) -> VerificationSection:
    """Judge the readings of an acceptance test, and write it into the result.

    Raises InputError where the folder has no acceptance plan, and BadFitError where the
    fit promises nothing.
    """
    result = load_result(folder)
    if result.acceptance is None:
        problem = "this result has no acceptance plan"
        remedy = f"make it with `oed verify {shlex.quote(str(folder))}`"
        raise InputError(problem, remedy, file=str(folder / "result.json"))
    refuse_bad_fit(result)
    section = judge_file(result.acceptance, readings)
    section = replace(section, healthy=result.acceptance.healthy)
    result = replace(result, verification=section)
    result_folder.rewrite(folder, result)
    return section


def plan_sentences(section: AcceptanceSection) -> Iterator[str]:
    """What the plan demands and how sure it is."""
    yield f"Measure the pose errors of the compensated machine at {len(section.poses)} poses."
    for name, d in section.components.items():
        yield (
            f"{name}: promised rms {rounded(d.promised, 3)} {d.unit}; {_limits(d)}"
            f" rms over these poses, measured to"
            f" {rounded(d.uncertainty)} {d.unit} (1 sd). A machine with"
            f" {100 * (section.miss - 1):.0f} % more than promised is caught with"
            f" probability {d.power:.2f}{_confirmation(d)}."
        )
    yield f"A machine just at its promise fails with probability {section.false_alarm:.2f}."
    for name, d in section.further.items():
        bare = np.nan if d.without is None else d.without
        yield (
            f"{name}: no drive corrects it: {rounded(bare, 3)} {d.unit} rms are predicted"
            f" without additional axes. With axes that take the known errors back it is"
            f" promised {rounded(d.promised, 3)} {d.unit}; {_limits(d)} rms, measured to"
            f" {rounded(d.uncertainty)} {d.unit} (1 sd). Leave its column empty where you"
            " do not measure it."
        )
    if section.further:
        yield f"Write 1 into {AXES} where these axes were on; 0, or nothing, where not."
    for condition in section.conditions:
        yield f"Condition: {condition}."


def _limits(demand: PromiseRecord) -> str:
    """Up to which measured rms error it meets its promise, and from which on it fails."""
    unit = demand.unit
    fails = f"it fails above {rounded(demand.limit, 3)} {unit}"
    if demand.confirms is None:
        return fails
    return f"it meets that up to {rounded(demand.confirms, 3)} {unit}, and {fails[3:]}"


def _confirmation(demand: PromiseRecord) -> str:
    if demand.confirms is not None:
        return ""
    return f": below {MIN_POWER:g} this test ends only in fail or cannot tell"


def verdict_sentences(section: VerificationSection) -> Iterator[str]:
    """The judgement, component by component."""
    for name, c in section.components.items():
        yield (
            f"{name}: {c.judgement}: rms {rounded(c.rms, 3)} {c.unit}, limit {rounded(c.limit, 3)}"
            f" {c.unit} (promised {rounded(c.promised, 3)} {c.unit}), largest"
            f" {rounded(c.max, 3)} {c.unit}."
        )
    for name, c in section.further.items():
        bare = np.nan if c.without is None else c.without
        yield (
            f"{name}: without additional axes rms {rounded(bare, 3)} {c.unit}; with them"
            f" {c.judgement}: rms {rounded(c.rms, 3)} {c.unit}, limit {rounded(c.limit, 3)} {c.unit}"
            f" (promised {rounded(c.promised, 3)} {c.unit}), largest {rounded(c.max, 3)}"
            f" {c.unit}."
        )
    for name, p in section.positioning.items():
        yield (
            f"{name}, after ISO 230-2 with {p.approaches} approaches at {p.targets}"
            f" targets (the standard asks for 5 along an axis): accuracy A"
            f" {rounded(p.accuracy, 3)}, systematic deviation E {rounded(p.systematic, 3)},"
            f" repeatability R {rounded(p.repeatability, 3)}{_both_ways(p.mean, p.reversal)}"
            f" {p.unit}."
        )
    yield from healthy_sentences(section)
    yield CONCLUSIONS[section.judgement]


def _both_ways(mean: float | None, reversal: float | None) -> str:
    if mean is None or reversal is None:
        return ""
    return f", mean bidirectional deviation M {rounded(mean, 3)}, reversal B {rounded(reversal, 3)}"
