"""The steps of a diagnosis: readings of a machine with effects, what can be found, what is."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from msgspec.structs import replace

from oed import dataset, gap, units
from oed.base import Array
from oed.effect_model import Column, Effect, State
from oed.gap import Diagnosis, GapProblem, RunsWanted, SecondVisit, propose_second_visit
from oed.gap import states as states_of
from oed.measurement import Measurement, Series
from oed.result import (
    UNKNOWN,
    ChosenRun,
    ChosenRuns,
    ClosureRecord,
    CoefficientRecord,
    DetectabilityTable,
    EffectNote,
    GapBeforeSection,
    GapSection,
    SecondVisitRecord,
    SizeRecord,
    finite_or_none,
)
from oed.text import capitalised, format_probability, join_words
from pkm_studies.base import Stream
from pkm_studies.resolve import ActingEffect, GapDesignRequest, GapRequest, comments_of
from pkm_studies.stages.fit import run_curves
from pkm_studies.stages.gap import sentences
from pkm_studies.stages.gap.sentences import plain_name
from pkm_studies.stages.run_state import Fitted, ScheduledT

if TYPE_CHECKING:
    import pandas as pd

    from oed.dataset import Dataset


# Simulates readings of a virtual machine that has effects its model lacks.
def empty_readings(
    measurement: Measurement, series: Sequence[Series], request: GapRequest
) -> Dataset:
    """Planned readings without values, with covariates from [gap.conditions]."""
    covariates = request.planned_covariates(measurement, series)
    parted = [s.separate_poses() for s in series]
    empty = np.full(len(measurement.setup_of_readings(parted)), np.nan)
    return dataset.from_series(parted, empty, measurement, covariates)


def covariates_of(
    measurement: Measurement,
    series: Sequence[Series],
    recorded: pd.DataFrame | None,
    request: GapRequest,
) -> pd.DataFrame:
    """Covariates of readings: the recorded ones, or those of [gap.conditions]."""
    if recorded is not None:
        return recorded
    return empty_readings(measurement, series, request).covariates


def exact_readings(
    measurement: Measurement,
    planned: Dataset,
    truth: Array,
    request: GapRequest,
    rng: np.random.Generator,
) -> tuple[Array, list[dict[str, Any]]]:
    """Readings y (N,) without noise, SI, and the acting effects for the truth file.

    truth   (n,) parameters of the virtual machine, SI
    rng     draws the coefficients that are to be drawn

    Raises InputError for coefficients that an effect does not have.
    """
    series = planned.series
    if not request.acting:
        return measurement.readings(series, truth), []
    states = states_of(measurement, series, planned.covariates, truth, request.gravity)
    factors = [_factors(acting, states, rng) for acting in request.acting]
    acting = [
        (entry.effect, entry.constants, factor)
        for entry, factor in zip(request.acting, factors, strict=True)
    ]
    y = gap.exact_readings(measurement, series, truth, states, acting)
    channels = [
        channel
        for s in series
        for _ in range(len(s))
        for channel in planned.layouts[s.setup].channels
    ]
    channel_names = np.array([c.name for c in channels])
    fine = {c.name: units.FINE[c.unit] for c in channels}
    entries = []
    for k, entry in enumerate(request.acting):
        others = acting[:k] + acting[k + 1 :]
        without = gap.exact_readings(measurement, series, truth, states, others)
        rms = {
            f"{name}_{fine[name]}": float(units.from_si(size, fine[name]))
            for name, size in rms_by_channel(y - without, channel_names).items()
        }
        columns = _acting_columns(entry, states)
        coefficients = {
            name: {"value": factor * columns[name].scale, "prior_sds": factor}
            for name, factor in factors[k].items()
        }
        listed = {
            "effect": entry.effect.name,
            "constants": dict(entry.constants),
            "coefficients": coefficients,
            "rms": rms,
        }
        entries.append(listed)
    return y, entries


def check_coefficients(
    measurement: Measurement, series: Sequence[Series], request: GapRequest
) -> None:
    """Raises InputError for coefficients that an acting effect does not have."""
    planned = empty_readings(measurement, series, request)
    nominal, covariates = measurement.nominal, planned.covariates
    states = states_of(
        measurement, planned.series, covariates, nominal, request.gravity
    )
    rng = np.random.default_rng(0)
    for acting in request.acting:
        _factors(acting, states, rng)


def _acting_columns(acting: ActingEffect, states: Sequence[State]) -> dict[str, Column]:
    """Columns of an effect by the names of their coefficients."""
    columns = {}
    for state in states:
        for column in acting.effect.columns(state, **acting.constants):
            columns[column.name] = column
    return columns


def _factors(
    acting: ActingEffect, states: Sequence[State], rng: np.random.Generator
) -> dict[str, float]:
    """Coefficients, in prior standard deviations."""
    columns = _acting_columns(acting, states)
    if acting.coefficients is not None:
        for name in acting.coefficients:
            if name not in columns:
                raise acting.unknown_coefficient(name, list(columns))
        return {n: acting.size * value for n, value in acting.coefficients.items()}
    textbook = [name for name, column in columns.items() if not column.shape]
    values = np.ones(len(textbook))
    if acting.draw:
        values = rng.standard_normal(len(textbook))
    return {n: acting.size * float(v) for n, v in zip(textbook, values, strict=True)}


# Chooses the runs of [gap.design], which separate the wanted effects best.
def choose_runs(
    measurement: Measurement,
    design: GapDesignRequest,
    planned: GapProblem,
    request: GapRequest,
    rng: np.random.Generator,
) -> tuple[ChosenRuns, str]:
    """The runs that separate the wanted effects best from each other and from rivals.

    planned    readings planned without [gap.design]

    Retained runs are among them. The second result is a readings file to fill in.
    Raises InputError where no run shows the effects or the rules allow no plan.
    """
    wanted = RunsWanted(
        runs=design.runs,
        retained=tuple(range(len(design.retained))),
        wanted=design.wanted,
        rivals=design.rivals,
        share=design.table.share,
        rounds=design.table.starts,
    )
    try:
        choice, series, covariates = gap.choose_runs(
            measurement, wanted, design.rules, planned, rng
        )
    except ValueError as error:
        remedy = "give conditions that show it, or other effects or rules"
        raise design.location.error(str(error), remedy) from error
    selected = [design.runs[k] for k in choice.runs]
    timed = covariates
    if "time" not in covariates:
        timed = covariates.assign(time=_times(covariates, design))
    taken = gap.assemble(measurement, series, timed, gravity=request.gravity)
    chosen = ChosenRuns(
        candidates=len(design.candidates),
        retained=len(design.retained),
        runs=[
            ChosenRun(run.setup, run.name, dict(run.condition), run.seconds)
            for run in selected
        ],
        separation=choice.separation,
        bound=choice.bound,
        before=choice.before,
        efficiency=choice.efficiency,
        proven=choice.proven,
        share=design.table.share,
        volume=choice.volume,
        seconds=choice.seconds,
        separations=choice.pairs,
        table=gap.detect(taken, taken.stated_law, request.effects, rng),
    )
    return chosen, poses_csv(measurement, series, covariates)


def _times(covariates: pd.DataFrame, design: GapDesignRequest) -> Array:
    """Time of each reading (n,), s, where the runs follow one another."""
    rules = design.rules
    mounting = dict.fromkeys((run.setup for run in design.runs), 0.0)
    if rules.setups is not None and rules.setups.seconds is not None:
        mounting = dict(zip(mounting, rules.setups.seconds.tolist(), strict=True))
    seconds = {(run.setup, run.name): run.seconds for run in design.runs}
    clock = 0.0
    mounted = ""
    times = []
    for (setup, name), rows in covariates.groupby(["setup", "run"], sort=False):
        clock += mounting[setup] if setup != mounted else 0.0
        mounted = setup
        duration = seconds[setup, name]
        times.append(clock + duration * np.arange(1, len(rows) + 1) / len(rows))
        clock += duration
    return np.concatenate(times)


def poses_csv(
    measurement: Measurement, series: Sequence[Series], covariates: pd.DataFrame
) -> str:
    """Runs as a readings file; readings and times are to be filled in."""
    columns = covariates.drop(columns=["setup", "run", "order"]).assign(time=np.nan)
    empty = np.full(len(measurement.setup_of_readings(series)), np.nan)
    readings = dataset.from_series(series, empty, measurement, columns)
    return dataset.to_csv(readings, comments_of(measurement))


# Diagnoses readings of a study and writes the result's section `gap` of it.
def gap_section(diagnosis: Diagnosis, effects: Sequence[Effect]) -> GapSection:
    """The diagnosis in display units and in sentences."""
    channel_units, channels = _channels(diagnosis)
    factor = np.array([units.factor(channel_units[name]) for name in channels])
    spots, spots_unit = run_curves.spots(diagnosis)
    scatter = diagnosis.scatter
    likeliest_first = sorted(diagnosis.marginal.items(), key=lambda item: -item[1])
    section = GapSection(
        verdict=diagnosis.verdict,
        answers=list(diagnosis.answers),
        set95=list(diagnosis.set95),
        where=list(diagnosis.where),
        closure=[_closure(c) for c in diagnosis.closure],
        not_testable=list(diagnosis.not_testable),
        confusable=[list(group) for group in diagnosis.confusable],
        selected=list(diagnosis.selected),
        tried=[e.name for e in effects],
        marginal={name: float(p) for name, p in likeliest_first},
        about={e.name: _note(e, diagnosis) for e in effects},
        constants={name: dict(c) for name, c in diagnosis.constants.items()},
        coefficients=_coefficients(diagnosis, effects),
        sizes=_sizes(diagnosis, channel_units),
        noise=list(diagnosis.noise_words),
        units=channel_units,
        rms_before=rms_by_channel(diagnosis.before / factor, channels),
        rms_after=rms_by_channel(diagnosis.after / factor, channels),
        traces=run_curves.traces(diagnosis),
        spots=spots,
        spots_unit=spots_unit,
        words=[],
        next=list(diagnosis.next),
        unknown={form: float(p) for form, p in diagnosis.likeness.items()},
        nearest=list(diagnosis.nearest),
        left_out=list(diagnosis.left_out),
        scatter=None if scatter is None else scatter.factor,
        scatter_shape="" if scatter is None else scatter.shape,
        scatter_against="" if scatter is None else scatter.against,
        effective_laws=diagnosis.effective_laws,
    )
    return sentences.add_sentences(section)


def _closure(closure: ClosureRecord) -> ClosureRecord:
    numbers = msgspec.structs.asdict(closure).items()
    finite = {n: finite_or_none(v) for n, v in numbers if isinstance(v, float)}
    return replace(closure, **finite)


def _note(effect: Effect, diagnosis: Diagnosis) -> EffectNote:
    missing = diagnosis.not_testable.get(effect.name, "")
    column = ""
    if missing:
        column = sentences.columns_to_record(effect, diagnosis.problem.states)
    note = msgspec.convert(effect, EffectNote, from_attributes=True)
    return replace(note, missing=missing, column=column)


def _channels(diagnosis: Diagnosis) -> tuple[dict[str, str], np.ndarray]:
    """Fine unit of each channel, and the channel of each reading (N,)."""
    setups, rows = diagnosis.problem.measurement.setups, diagnosis.problem.rows
    fine: dict[str, str] = {}
    for name in dict.fromkeys(rows["setup"]):
        fine |= {c.name: units.FINE[c.unit] for c in setups[name].instrument.channels}
    return fine, rows["channel"].to_numpy()


def rms_by_channel(values: Array, channels: np.ndarray) -> dict[str, float]:
    """Root mean square of values (N,) by the channel (N,) of each."""
    return {
        str(name): float(np.sqrt(np.mean(values[channels == name] ** 2)))
        for name in dict.fromkeys(channels)
    }


def _sizes(diagnosis: Diagnosis, channel_units: dict[str, str]) -> list[SizeRecord]:
    records = []
    for size in diagnosis.sizes:
        rms, remaining = (
            {n: units.number(v, channel_units[n]) for n, v in values.items()}
            for values in (size.rms, size.remaining)
        )
        detectability = finite_or_none(size.detectability)
        records.append(SizeRecord(size.effect, rms, detectability, remaining))
    return records


def _coefficients(
    diagnosis: Diagnosis, effects: Sequence[Effect]
) -> list[CoefficientRecord]:
    """Coefficients, SI, with the prior standard deviation of each."""
    by_name = {effect.name: effect for effect in effects}
    priors = {
        (effect.name, column.name): column
        for effect in effects
        if effect.name in diagnosis.selected
        for column in _effect_columns(effect, diagnosis)
    }
    records = []
    for c in diagnosis.coefficients:
        column = priors.get((c.effect, c.name))
        effect = by_name.get(c.effect)
        if effect is not None:
            c = replace(c, unit=effect.unit(c.name))
        if column is not None:
            c = replace(c, prior_sd=column.scale, shape=column.shape)
        records.append(c)
    return records


def _effect_columns(effect: Effect, diagnosis: Diagnosis) -> list[Column]:
    """All columns of an effect, over its constants and the set-ups."""
    columns: list[Column] = []
    for constants in effect.constant_grid():
        for state in diagnosis.problem.states:
            columns += effect.columns(state, **constants)
    return columns


# Advises a second visit: its record in the result, its readings to fill in, its words.

MAX_LISTED_PAIRS = 3  #: pairs of answers that are named, at most
DECISIVE_PROBABILITY = 0.8  #: probability from which the visit is expected to decide
MIN_GAIN = 0.02  #: gain in probability below which the visit is not worth its time


def _values(stated: float | Sequence[float] | None) -> list[float]:
    """A condition's values, of which a table states one, several or none."""
    if stated is None:
        return []
    return list(stated) if isinstance(stated, Sequence) else [stated]


def add_visit(gap: GapSection, visit: SecondVisitRecord) -> GapSection:
    """The diagnosis with the visit, which stands first in its advice."""
    return replace(gap, second_visit=visit, next=[visit.words[0], *gap.next])


def _record(visit: SecondVisit) -> SecondVisitRecord:
    runs = []
    for run in visit.runs:
        # without its time: the visit may be at any
        condition = {name: v for name, v in run.condition.items() if name != "time"}
        runs.append(ChosenRun(run.setup, run.name, condition, run.seconds))
    record = SecondVisitRecord(
        runs=runs,
        poses=[len(run.command) for run in visit.runs],
        probability_now=visit.probability_now,
        probability_after=visit.probability_after,
        separations=list(visit.pairs),
        inseparable=list(visit.inseparable),
    )
    return replace(record, words=second_visit_sentences(record))


def second_visit_sentences(visit: SecondVisitRecord) -> list[str]:
    """What to read, what it is expected to decide, and what it cannot."""
    count, runs = sum(visit.poses), len(visit.runs)
    now = format_probability(visit.probability_now)
    after = format_probability(visit.probability_after)
    sentences = [
        f"Take the {count} poses of second_visit.csv ({runs} run{'s' * (runs > 1)}) at a"
        " second visit. Expected probability that the likeliest cause is then the right"
        f" one: {after}; now it is {now}.",
        "The expectation is over what these readings leave possible, in the forms of the"
        " library: a cause of another form is not in it.",
    ]
    if visit.probability_after < DECISIVE_PROBABILITY:
        sentences.append(
            "These runs alone will hardly decide: read what else separates the effects"
            " as well."
        )
    if visit.inseparable:
        pairs = [f"{_spoken(a)} from {_spoken(b)}" for a, b in visit.inseparable]
        sentences.append(
            "No run of those read so far separates"
            f" {join_words(pairs[:MAX_LISTED_PAIRS], last='nor')}."
        )
    return sentences


def _spoken(answer: str) -> str:
    """An answer in words: its effects are joined by plus signs."""
    return join_words([plain_name(name) for name in answer.split(" + ")])


# Predicts which effects planned readings could find: the section `gap_before`.

MAX_LISTED_EFFECTS = 6  #: most effects and pairs in one sentence


def _fine_units(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel, in which the sizes of readings are given."""
    setups = measurement.setups.values()
    channels = [c for setup in setups for c in setup.instrument.channels]
    return {c.name: units.FINE[c.unit] for c in channels}


def _gain(chosen: ChosenRuns) -> str:
    pairs = set()
    for s in chosen.separations:
        pairs.add(" and ".join(sorted((plain_name(s.effect), plain_name(s.rival)))))
    named = "; ".join(sorted(pairs)[:MAX_LISTED_EFFECTS])
    bound = f"no plan exceeds {chosen.bound:.1f}"
    if chosen.proven:
        bound = "no plan is better"
    before = "" if chosen.before is None else f" from {chosen.before:.1f}"
    added = f"{len(chosen.runs) - chosen.retained} of {chosen.candidates}"
    retained = f", added to {chosen.retained} retained runs," if chosen.retained else ""
    return (
        f"{added} candidate runs{retained} raise the least distinguishability of"
        f" {named}{before} to {chosen.separation:.1f} ({bound})."
    )


def _findings(readings: str, table: DetectabilityTable) -> list[str]:
    visible = [e for e in table.effects if e.visible]
    testable = [e for e in table.effects if e.not_testable is None]
    too_weak = [plain_name(e.name) for e in testable if not e.visible]
    missed = f"; too weak for them: {join_words(too_weak)}" if too_weak else ""
    sentences = [
        f"{readings} find {len(visible)} of the {len(table.names)} effects that they"
        " can test, at the expected sizes (90 % chance at 1 % false alarm)"
        f"{missed}."
    ]
    absorbed = dict.fromkeys(effect for effect, _ in table.absorbed)
    for name in list(absorbed)[:MAX_LISTED_EFFECTS]:
        rivals = [
            plain_name(rival) for effect, rival in table.absorbed if effect == name
        ]
        subject = capitalised(plain_name(name))
        sentences.append(
            f"{subject} could also be explained by {join_words(rivals, 'or')}."
        )
    for first, second in table.exact[:MAX_LISTED_EFFECTS]:
        sentences.append(
            f"Some forms of {plain_name(first)} and {plain_name(second)} are identical"
            " in these readings, whatever their size."
        )
    untestable = [
        plain_name(e.name) for e in table.effects if e.not_testable is not None
    ]
    if untestable:
        sentences.append(f"They cannot test {join_words(untestable)}.")
    return sentences


# Steps about the gap: what readings could find, and the diagnosis of what remains.

#: the only advice after a fit that failed its check, where no effect explains it
AFTER_BAD_FIT = (
    "Do not compensate with these parameters: the fit is bad, and no effect explains it."
    " Check the readings and the stated noise first."
)


def preview_gap(state: ScheduledT) -> ScheduledT:
    """Predict what the readings could find, and choose the runs of [gap.design]."""
    request = state.resolved.gap
    if request is None:
        return state
    state.progress.stage("what the readings could find")
    series, covariates = state.readings.series, state.readings.covariates
    if covariates is None:
        planned = empty_readings(state.measurement, series, request)
        series, covariates = planned.series, planned.covariates
    problem = gap.assemble(
        state.measurement, series, covariates, gravity=request.gravity
    )
    rng = state.rng(Stream.BEFORE)
    fine = _fine_units(state.measurement)
    design = state.resolved.gap_design
    if design is not None and design.follows_plan:
        plan, plan_request = state.plan, state.resolved.plan
        if plan is None or plan_request is None:
            design = None
        else:
            remaining = plan_request.budget - units.factor("min") * plan.section.cost
            design = design.with_plan(plan.series, remaining)
    chosen = None
    if design is not None:
        used = state.resolved.measurement_with({run.setup for run in design.runs})
        fine |= _fine_units(used)
        chosen, poses = choose_runs(used, design, problem, request, rng)
        state = state.replace(gap_poses=poses)
    # the noise is the stated one: what real runs add to it is unknown before they are read
    table = gap.detect(problem, problem.stated_law, request.effects, rng)
    words = _findings("The planned readings", table)
    if chosen is not None:
        words = [_gain(chosen), *_findings("The chosen runs", chosen.table)]
    return state.add_sections(gap_before=GapBeforeSection(table, fine, chosen, words))


def diagnose_gap(state: Fitted) -> Fitted:
    """Find which effects cause what calibration leaves.

    Of readings of a machine always, unless the study allows the geometry alone or the
    command names the effects; of those of a virtual machine where the study asks for it.
    """
    is_recorded = state.resolved.dataset is not None
    is_asked = state.resolved.allows_effects(is_recorded=is_recorded)
    is_asked = is_asked and not state.with_effects
    if state.resolved.gap is None and not is_asked:
        return state
    return diagnose_always(state)


def _with_estimated_noise(state: Fitted) -> Measurement:
    """The measurement; of an assumed noise that is larger, with the one that the fit found.

    The law of the noise is sought about the stated one, and a guess that is a hundred
    times too large is beyond its reach. A larger scatter may be an effect's, and stays.
    """
    posterior = state.estimate.noise_posterior
    if posterior is None or not state.study.noise.assumed:
        return state.measurement
    law = posterior.prior.laws(posterior.mode[None])
    scale = dict(zip(posterior.structure.names, law.scale[0], strict=True))
    setups = []
    for setup in state.measurement.setups.values():
        names = [f"{setup.name}.{c.name}" for c in setup.instrument.channels]
        sizes = zip(names, setup.sigma, strict=True)
        sigma = tuple(s * min(1.0, float(scale.get(name, 1.0))) for name, s in sizes)
        setups.append(dataclasses.replace(setup, sigma=sigma))
    return state.measurement.with_setups(setups)


def diagnose_always(state: Fitted) -> Fitted:
    """Diagnose by [gap], or by its defaults where the study has none."""
    request, readings = state.resolved.diagnosed, state.readings
    if state.checked is not None and state.checked.mistaken:
        reason = (
            "There is no diagnosis: a mistake in the readings explains their misfit"
        )
        return state.add_warnings(reason).withhold_section("gap", reason)
    state.progress.stage("diagnosis")
    covariates = covariates_of(
        state.measurement, readings.series, readings.covariates, request
    )
    residuals = gap.assemble(
        _with_estimated_noise(state),
        readings.series,
        covariates,
        state.estimate.theta,
        readings.y,
        gravity=request.gravity,
    )
    diagnosis = gap.diagnose(residuals, request.effects, state.rng(Stream.GAP))
    state = state.replace(diagnosis=diagnosis)
    section = gap_section(diagnosis, request.effects)
    if state.fit_is_bad and section.verdict == "none":
        section = replace(section, next=[AFTER_BAD_FIT])
    estimate = state.result.estimate
    if estimate is not None and estimate.held and UNKNOWN in section.answers[0].effects:
        names = [name for one in estimate.held for name in one.parameters]
        advice = (
            f"Let {join_words(names)} be fitted, held parameters that the readings"
            " contradict; then diagnose again."
        )
        section = replace(section, next=[advice, *section.next])
    design = state.resolved.gap_design
    further = () if design is None else design.runs
    rng = state.rng(Stream.VISIT)
    conditions = request.conditions
    values = {
        "feed": [v * units.MM_PER_MIN for v in _values(conditions.feed_mm_min)],
        "payload": _values(conditions.payload),
    }
    visit = propose_second_visit(diagnosis, request.effects, rng, values, further)
    if visit is None or visit.probability_after < visit.probability_now + MIN_GAIN:
        return state.add_sections(gap=section)
    csv = poses_csv(diagnosis.problem.measurement, visit.series, visit.covariates)
    section = add_visit(section, _record(visit))
    return state.replace(visit_poses=csv).add_sections(gap=section)
