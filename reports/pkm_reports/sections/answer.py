"""The first page: what a user asked, answered before anything is explained.

A question that a result does not answer has no part.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from typing import Final, NamedTuple

from oed import trust, units
from oed.result import (
    ComponentAccuracy,
    CorrectedSection,
    EffectEstimate,
    ForecastSection,
    GapSection,
    HeldOutSection,
    IdentifiabilityFinding,
    IdentifiabilitySection,
    PlanSection,
    PredictionSection,
    SpreadRecord,
    StudyResult,
    WantedVerdict,
)
from oed.text import format_probability
from oed.verdict import SURE_PROBABILITY, accuracy_verdicts
from pkm_reports import missing, text
from pkm_reports.blocks import (
    Block,
    Items,
    Notice,
    Paragraph,
    Section,
    Table,
    TableColumn,
    headed_list,
)
from pkm_reports.sections import acceptance, forecast, gap_figures
from pkm_reports.sections.gap_figures import size_in_readings, spoken
from pkm_reports.sections.identifiability import lost_count
from pkm_reports.sections.measure import (
    instrument_names,
    is_plan,
    measure_blocks,
    measure_title,
    plan_minutes,
    planned_readings,
    recorded_readings,
    used_setups,
)
from pkm_reports.sections.plan import budget_phrase, is_missed


# The first lines of a report: what was read or is to be, how accurate, the main doubt.
def lead_blocks(result: StudyResult) -> list[Block]:
    """One paragraph, and the main doubt with what removes it; a bad fit before all."""
    sentences = [
        *_causes(result.gap),
        *_readings(result),
        *_accuracy_sentences(result),
        *_forecast(result.forecast),
        *_agreement(result),
    ]
    doubt = main_doubt(result).words
    content: list[Block] = [Paragraph(" ".join(sentences))] if sentences else []
    if not doubt:
        return content
    if trust.objections(result):
        return [Notice(doubt), *content]
    return [*content, Notice(doubt)]


def _causes(gap: GapSection | None) -> list[str]:
    return [] if gap is None else text.sentences(gap.words[:1])


def _readings(result: StudyResult) -> list[str]:
    """How many readings to take or taken, with what, and how long it takes."""
    instruments = text.listing(instrument_names(used_setups(result)))
    by = f" with the {instruments}" if instruments else ""
    if is_plan(result):
        number = planned_readings(result)
        minutes = plan_minutes(result)
        end = f": {minutes}." if minutes else "."
        return [f"Take {text.count(number, 'reading')}{by}{end}"]
    number, values = recorded_readings(result)
    if not number:
        return []
    of_values = "" if values == number else f" ({text.count(values, 'value')})"
    verb = "was" if number == 1 else "were"
    return [f"{text.count(number, 'reading')}{of_values}{by} {verb} evaluated."]


def _accuracy_sentences(result: StudyResult) -> list[str]:
    """The error that is left of each component, and the condition of the figures."""
    prediction = result.judged_prediction
    if prediction is None or not prediction.components:
        return []
    errors = remaining_errors(result, prediction.components)
    judged = verdicts(result, prediction.components)
    parts = []
    for name, error in errors.items():
        part = f"{name}{text.NO_BREAK}{text.quantity(error.rms, error.unit)}"
        interval = _span(prediction.judged_components[name].judged, error.rms)
        phrases = [f"{interval}, 95 %"] if interval else []
        if name in judged:
            wanted = text.quantity(judged[name].wanted, error.unit)
            phrases.append(f"{wanted} wanted: {judged[name].judgement}")
        parts.append(f"{part} ({'; '.join(phrases)})" if phrases else part)
    scopes = text.listing(dict.fromkeys(error.scope for error in errors.values()))
    reference = text.meaning(prediction.reference, REFERENCES)
    return [
        f"After compensation the rms error is predicted to be {text.listing(parts)},"
        f" {reference}, {scopes}."
    ]


def _forecast(forecast: ForecastSection | None) -> list[str]:
    """What the controller's table of a forecast leaves, or what its plan reads."""
    if forecast is None:
        return []
    if not forecast.readings:
        nodes = text.count(len(forecast.nodes), "node")
        return [
            f"Measure the errors at {nodes} with set-up {forecast.setup}:"
            f" {forecast.minutes:.0f} min."
        ]
    parts = [
        f"{name}{text.NO_BREAK}{text.quantity(c.predicted, c.unit)}"
        f" ({text.number(c.low, 2)} to {text.number(c.high, 2)}, 95 %)"
        for name, c in forecast.components.items()
    ]
    return [
        f"{text.count(forecast.readings, 'reading')} of nodes with set-up {forecast.setup}"
        " were evaluated. With the controller's table"
        f" the rms error over the workspace is predicted to be {text.listing(parts)},"
        f" relative to {forecast.reference}."
    ]


#: verdicts of held-out readings that raise no doubt of the fit
FITTING: Final = ("confirms", "agrees")


def _agreement(result: StudyResult) -> list[str]:
    """Channels of held-out readings that do not contradict the fit, in one sentence."""
    sections = [s for s in result.held_out if s.verdict in FITTING]
    if not sections:
        return []
    confirming = sum(section.verdict == "confirms" for section in sections)
    inside = sorted(round(100.0 * section.coverage) for section in sections)
    shares = " to ".join(map(str, dict.fromkeys((inside[0], inside[-1]))))
    return [
        f"Held-out readings agree with the fit in {len(sections)} of"
        f" {len(result.held_out)} channels, in {confirming or 'none'} better than with the"
        f" nominal numbers; {shares} % lie inside the predicted 95 %."
    ]


# After a diagnosis: ranked causes, what remains, and what to do.

#: causes that are listed, and coefficients that stand for the size of one
MAX_CAUSES: Final = 5
MAX_COEFFICIENTS: Final = 3
#: probability below which an effect that is not selected is no cause to list
MIN_LISTED_PROBABILITY: Final = 0.05
#: standard deviations from which a coefficient counts as a size
MIN_COEFFICIENT_DEVIATIONS: Final = 2.0


def cause_blocks(result: StudyResult) -> list[Block]:
    """Causes by size, what remains, what to do next."""
    gap = result.gap
    if gap is None:
        return []
    content: list[Block] = []
    ranked = _ranked_causes(gap)
    if ranked:
        content.append(_cause_table(gap, ranked, result.corrected))
    remaining = _remains(gap)
    if remaining:
        content.append(Paragraph(remaining))
    actions = text.sentences(gap.next)
    if gap.closure and not actions:
        actions = ["Nothing: no effect needs a remedy."]
    return [*content, *headed_list("What to do:", actions)]


def _ranked_causes(gap: GapSection) -> list[str]:
    """Selected effects by their size, then others that are not unlikely."""
    sizes = {size.effect: sum(v * v for v in size.rms.values()) for size in gap.sizes}
    selected = sorted(gap.selected, key=lambda n: -sizes[n] if n in sizes else 0.0)
    others = [
        name
        for name in sorted(gap.marginal, key=lambda n: -gap.marginal[n])
        if name not in gap.selected and gap.marginal[name] >= MIN_LISTED_PROBABILITY
    ]
    return [*selected, *others][:MAX_CAUSES]


def _cause_table(
    gap: GapSection, ranked: Sequence[str], corrected: CorrectedSection | None
) -> Table:
    columns = [
        TableColumn("Cause"),
        *TableColumn.numbers("Probability"),
        # of one channel a number, of six a list
        TableColumn("In the readings, rms", wide=True),
        TableColumn("After calibration, rms", wide=True),
        TableColumn("Own size", wide=True),
    ]
    sizes = {size.effect: size for size in gap.sizes}
    rows = []
    for name in ranked:
        rms = remaining = ""
        if name in sizes:
            rms = size_in_readings(gap, sizes[name].rms)
            remaining = size_in_readings(gap, sizes[name].remaining)
        chance = missing.entry(gap.marginal, name)
        rows.append(
            [
                "an effect of unknown form" if name == "unknown" else spoken(name),
                gap_figures.chance_text(chance),
                rms or text.MISSING,
                remaining or text.MISSING,
                own_size(name, corrected) or text.MISSING,
            ]
        )
    caption = (
        "Causes: the size of each in the readings, what calibration leaves of it, and the"
        " probability that it acts. Effects that look alike share their probability. Own"
        " size: the clearest coefficients, ± one standard deviation."
    )
    marks = ["chosen" if name in gap.selected else "" for name in ranked]
    return Table(columns, rows, caption, marks)


def own_size(effect: str, corrected: CorrectedSection | None) -> str:
    """The clearest coefficients of an effect in its own unit: leg 3 6.00 ± 0.04 µm."""
    if corrected is None:
        return ""
    clear = {
        name.partition(": ")[2]: e
        for name, e in corrected.effects.items()
        if e.effect == effect
        and abs(e.value) > MIN_COEFFICIENT_DEVIATIONS * e.sd
        and not e.shape
    }
    order = sorted(clear, key=lambda name: -abs(clear[name].value))
    phrases = [_coefficient(name, clear[name]) for name in order[:MAX_COEFFICIENTS]]
    if len(order) > MAX_COEFFICIENTS:
        phrases.append(text.count(len(order) - MAX_COEFFICIENTS, "smaller coefficient"))
    return text.listing(phrases)


def _coefficient(name: str, estimate: EffectEstimate) -> str:
    value, sd, unit = estimate.value, estimate.sd, estimate.unit
    if unit == "ppm" and abs(value) >= units.PPM_A_PERCENT:
        value, sd, unit = value / units.PPM_A_PERCENT, sd / units.PPM_A_PERCENT, "%"
    decimals = text.decimals_for(sd)
    size = f"{text.fixed(value, decimals)} ± {text.fixed(sd, decimals)}"
    return f"{name} {text.append_unit(size, unit)}"


def _remains(gap: GapSection) -> str:
    """The rms residual before and after, and what the noise is."""
    if not gap.rms_before:
        return ""
    if not gap.selected:
        sizes = [
            f"{name} {text.channel_value(name, rms, gap.units)}"
            for name, rms in gap.rms_before.items()
        ]
        phrase = f"What calibration leaves, rms: {'; '.join(sizes)}."
        return " ".join([phrase, *text.sentences(gap.noise)])
    parts = []
    for name, before in gap.rms_before.items():
        after = missing.entry(gap.rms_after, name)
        change = (
            f"{name} {text.channel_value(name, before, gap.units)} before,"
            f" {text.channel_value(name, after, gap.units)} after"
        )
        parts.append(change)
    phrase = f"What remains with these causes in the model, rms: {'; '.join(parts)}."
    return " ".join([phrase, *text.sentences(gap.noise)])


# A printer: the numbers of its configuration, before and after.

#: machines whose parameters are the numbers of a configuration file
PRINTERS: Final = ("delta_printer", "rotary_delta_printer")


def number_blocks(result: StudyResult) -> list[Block]:
    """Each number that is fitted of a printer's configuration; none of other machines."""
    section = result.corrected or result.estimate
    if section is None or result.machine.name not in PRINTERS or is_plan(result):
        return []
    mixture = None if result.gap is None else result.gap.mixture
    sent = {name: p.value for name, p in section.parameters.items()}
    sent |= {} if mixture is None else mixture.controller
    rows = []
    for name, p in section.parameters.items():
        if "." in name:  # of a set-up
            continue
        unit = p.unit
        factor = 1.0
        if unit == "mrad":  # as firmware has angles
            unit = "deg"
            factor = float(units.to_si(1.0, "mrad")) / units.DEG
        new = sent[name] * factor
        old = p.nominal * factor
        decimals = text.decimals_for(p.sd * factor)
        row = [text.fixed(value, decimals) for value in (old, new, new - old)]
        rows.append(
            [f"{name} [{text.unit_symbol(unit)}]", *row, text.number(p.sd * factor, 2)]
        )
    caption = (
        "Numbers of the configuration, before and after this fit; sd: standard deviation"
        " of the new one. `oed compensate` writes them for the firmware."
    )
    return [
        Table(
            [TableColumn("Number"), *TableColumn.numbers("Old", "New", "Change", "sd")],
            rows,
            caption,
        )
    ]


# How accurate the machine is afterwards, with what is wanted beside it.

REFERENCES: Final = {
    "absolute": "in the base frame",
    "home": "zeroed at the home pose",
    "best_fit": "after the best alignment of the workpiece",
}
MAX_EFFECTS: Final = 4  #: effects that a caption names
#: share of an error from which its unknown part is worth a sentence of its own
CLEARLY_LESS: Final = 0.8

LIMIT_COLUMNS: Final = (
    TableColumn("Wanted", number=True),
    TableColumn("Within", number=True),
    TableColumn("Verdict"),
)


def accuracy_blocks(result: StudyResult) -> list[Block]:
    """Acceptance test, the predicted components, and held-out readings."""
    content: list[Block] = []
    if result.verification is not None:
        content.append(Notice(acceptance.verdict(result.verification)))
    prediction = result.judged_prediction
    if prediction is not None and prediction.components:
        content += _predicted_accuracy(result, prediction)
    elif result.plan is not None and result.plan.accuracy:
        content.append(_planned_accuracy(result.plan))
    if result.forecast is not None:
        content.append(forecast.answer(result.forecast))
    return content + _held_out(result)


def _held_out(result: StudyResult) -> list[Block]:
    """What readings that the fit did not use say of it: a table where all fit."""
    judged = [s for s in result.held_out if s.words]
    fitting = [s for s in judged if s.verdict != "contradicts"]
    if len(fitting) < 2:
        fitting = []
    content: list[Block] = [
        Notice(text.sentence(s.words))
        if s.verdict == "contradicts"
        else Paragraph(text.sentence(s.words))
        for s in judged
        if s not in fitting
    ]
    return [*content, _held_out_table(fitting)] if fitting else content


def _held_out_table(sections: Sequence[HeldOutSection]) -> Table:
    verdicts = [s.verdict or text.MISSING for s in sections]
    differ = len(set(verdicts)) > 1
    columns = [
        TableColumn("Channel"),
        *TableColumn.numbers("Predicted", "Seen", "Nominal", "Inside"),
        *([TableColumn("Verdict")] if differ else []),
    ]
    several = len({s.name for s in sections}) > 1
    rows = []
    for s, judgement in zip(sections, verdicts, strict=True):
        where = f"{s.name}, " if several else ""
        errors = [missing.or_nan(v) for v in (s.predicted, s.rms, s.rms_before)]
        rows.append(
            [
                f"{where}{s.channel} [{text.unit_symbol(s.unit)}]",
                *map(text.number, errors),
                text.percent(s.coverage),
                *([judgement] if differ else []),
            ]
        )
    names = text.listing(dict.fromkeys(f"{s.name} ({s.n})" for s in sections))
    caption = (
        f"Held-out readings of {names}, rms: predicted, seen, and with the nominal"
        " numbers; the share inside the predicted 95 %."
    )
    if not differ and verdicts[0] == "confirms":
        caption += " All channels confirm the fit."
    elif not differ and verdicts[0] == "agrees":
        caption += " All channels agree with the fit, none confirms it."
    return Table(columns, rows, caption)


# -- what is wanted --------------------------------------------------------------------
def wanted_accuracy(result: StudyResult) -> dict[str, float]:
    """Accuracy that the study asks for, by component and unit (`z_um`)."""
    accuracies: dict[str, float] = {}
    if result.design is not None and result.design.how_many is not None:
        accuracies |= result.design.how_many.wanted
    if result.plan is not None:
        accuracies |= result.plan.goal
    prediction = result.judged_prediction
    if prediction is not None:
        unit = prediction.unit
        accuracies |= {f"{n}_{unit[n]}": v for n, v in prediction.wanted.items()}
    return accuracies


def verdicts(
    result: StudyResult, components: Mapping[str, ComponentAccuracy]
) -> dict[str, WantedVerdict]:
    """The verdict on all that the study asks for, by predicted component."""
    goals = wanted_accuracy(result)
    limits = {
        name: missing.entry(goals, f"{name}_{c.after.unit}")
        for name, c in components.items()
    }
    stated = {name: limit for name, limit in limits.items() if math.isfinite(limit)}
    return accuracy_verdicts(result, stated)


def remaining_errors(
    result: StudyResult, components: Mapping[str, ComponentAccuracy]
) -> dict[str, WantedVerdict]:
    """The error of each component that verdicts rest on: wanted or driven, else all."""
    goals = verdicts(result, components)
    shown = [n for n, c in components.items() if n in goals or c.compensatable]
    names = sorted(shown or components, key=lambda name: name not in goals)
    return accuracy_verdicts(result, dict.fromkeys(names, math.inf))


def _predicted_accuracy(
    result: StudyResult, prediction: PredictionSection
) -> list[Block]:
    components = prediction.judged_components
    judged = verdicts(result, components)
    errors = remaining_errors(result, components)
    interval = "95 % of machines" if is_plan(result) else "95 % interval"
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers("Before", "Afterwards", interval),
        *(LIMIT_COLUMNS if judged else []),
    ]
    rows, marks = [], []
    for name, error in errors.items():
        before = components[name].before.rms
        unit = text.unit_symbol(error.unit)
        cells = [f"{name} [{unit}]", text.number(before), text.number(error.rms)]
        cells.append(_span(components[name].judged, error.rms))
        rows.append([*cells, *_limit_cells(name, judged)])
        marks.append(text.MARKS[judged[name].judgement] if name in judged else "")
    table = Table(columns, rows, _accuracy_caption(prediction, errors, judged), marks)
    return [table, *_undriven(components)]


def _span(spread: SpreadRecord, rms: float) -> str:
    """Ends of the interval of one machine's rms error, in proportion to a larger error."""
    if spread.rms_interval is None or not spread.rms > 0.0:
        return ""
    low, high = (text.number(end * rms / spread.rms, 2) for end in spread.rms_interval)
    return f"{low} to {high}"


def _limit_cells(name: str, judged: Mapping[str, WantedVerdict]) -> list[str]:
    """What is wanted, the probability that it is met, and the verdict."""
    if not judged:
        return []
    if name not in judged:
        return [text.MISSING] * len(LIMIT_COLUMNS)
    stated = judged[name]
    phrase = text.VERDICTS[stated.judgement]
    if stated.judgement == "pass":
        phrase += ", confirmed" if stated.confirmed else ", predicted"
    return [text.number(stated.wanted), format_probability(stated.probability), phrase]


def _accuracy_caption(
    prediction: PredictionSection,
    errors: Mapping[str, WantedVerdict],
    judged: Mapping[str, WantedVerdict],
) -> str:
    reference = text.meaning(prediction.reference, REFERENCES)
    scopes = text.listing(dict.fromkeys(error.scope for error in errors.values()))
    caption = f"Predicted rms error over the workspace, {reference}: {scopes}."
    caption += _usual_effects(prediction)
    if not judged:
        return f"{caption} The study states no wanted accuracy."
    decide = dict.fromkeys(v.decide for v in judged.values() if v.decide)
    sentences = [
        caption,
        "Within: probability that the machine keeps what is wanted; it passes from"
        f" {text.percent(SURE_PROBABILITY)} on. What no drive corrects is judged by its"
        " unknown part.",
        *(f"To decide: {text.sentence(phrase)}" for phrase in decide),
    ]
    return " ".join(sentences)


def _usual_effects(prediction: PredictionSection) -> str:
    """Which effects a planned accuracy counts."""
    budget = prediction.budget
    if prediction.mode != "plan" or budget is None or budget.usual is None:
        return ""
    effects = [line.effect.replace("_", " ") for line in budget.unmodelled]
    return f" Effects, the one that costs most first: {text.listing(effects, MAX_EFFECTS)}."


def _undriven(components: Mapping[str, ComponentAccuracy]) -> list[Block]:
    """Why an error can stay large although it is known: with this machine's numbers."""
    remaining = [
        name
        for name, c in components.items()
        if not c.compensatable and c.known.rms < CLEARLY_LESS * c.after.rms
    ]
    if not remaining:
        return []
    name = max(remaining, key=lambda n: components[n].after.rms)
    component = components[name]
    after = text.quantity(component.after.rms, component.after.unit)
    unknown = text.quantity(component.known.rms, component.after.unit)
    return [
        Paragraph(
            f"No drive corrects {text.listing(remaining)}: {name} keeps {after}, but all of"
            f" this except {unknown} is known. The compensation table lists it for an"
            " additional axis or the part program."
        )
    ]


def _planned_accuracy(plan: PlanSection) -> Table:
    """Accuracy of a plan of stages, which has no prediction of its own, and no verdict."""
    columns = [
        TableColumn("Component"),
        *TableColumn.numbers("Afterwards"),
        *(TableColumn.numbers("Wanted") if plan.goal else []),
        *TableColumn.numbers("Before"),
    ]
    rows = []
    for key, value in plan.accuracy.items():
        limits = [text.number(missing.entry(plan.goal, key))] if plan.goal else []
        before = text.number(missing.entry(plan.start_accuracy, key))
        rows.append([text.heading(key), text.number(value), *limits, before])
    within = budget_phrase(plan)
    caption = f"Predicted rms error over the workspace after the plan{within}."
    return Table(columns, rows, caption)


# What the readings leave unknown, and what would bring it back.

MAX_REMEDIES: Final = 4  #: remedies of a finding that are named


def unknown_blocks(result: StudyResult) -> list[Block]:
    """Lost and weak directions, each with its remedies; where nothing is, that."""
    section = result.identifiability
    if section is None:
        return []
    findings = [f for f in section.words if f.kind in ("lost", "weak")]
    content: list[Block] = [Paragraph(_determined(section))]
    if findings:
        content.append(Items([_finding(finding) for finding in findings]))
    return content


def _determined(section: IdentifiabilitySection) -> str:
    lost = lost_count(section)
    parameters = text.count(section.n, "unknown")
    if not lost:
        return f"The readings determine all of the {parameters}."
    verb = "stays" if lost == 1 else "stay"
    directions = text.count(lost, "combination")
    return (
        f"The readings determine {section.rank} of {parameters}: {directions} of them"
        f" {verb} as uncertain as the tolerances."
    )


def _finding(finding: IdentifiabilityFinding) -> str:
    phrase = text.sentence(finding.text)
    if not finding.remedies:
        return phrase
    return f"{phrase} What helps: {'; '.join(finding.remedies[:MAX_REMEDIES])}."


# What could go wrong or has gone wrong, the most harmful first.
def warnings_title(result: StudyResult) -> str:
    """The question that the part answers."""
    if trust.objections(result):
        return "The fit is not to be trusted"
    return "What could go wrong"


class Doubt(NamedTuple):
    """What spoils the figures most."""

    words: str  #: as the first lines of the report have it; empty where there is none
    warning: str = ""  #: the warning that it states; empty where it is none of them


def warning_blocks(result: StudyResult) -> list[Block]:
    """Findings, missed goals and claims, warnings, conditions, but for the main doubt."""
    sentences = _warnings(result)
    doubt = main_doubt(result)
    if not sentences and not doubt.words:
        return [Paragraph("The study has no warnings.")]
    stated = doubt.warning
    return [Notice(sentence) for sentence in sentences if sentence != stated]


def main_doubt(result: StudyResult) -> Doubt:
    """What spoils the figures most, and what removes it."""
    worst = next(iter(_warnings(result)), "")
    checked = result.goodness
    findings = [] if checked is None else map(text.sentence, checked.findings)
    if trust.objections(result) or worst in findings:
        return Doubt(worst, worst)
    of_effects = _effects_doubt(result.prediction)
    if worst and not of_effects:
        return Doubt(f"Main doubt: {worst[:1].lower()}{worst[1:]}", worst)
    other = of_effects or _scope_doubt(result)
    return Doubt(f"Main doubt: {other}" if other else "")


def _warnings(result: StudyResult) -> list[str]:
    """All warnings once, those that spoil the most first."""
    return list(dict.fromkeys(map(text.sentence, ranked_warnings(result))))


def _effects_doubt(prediction: PredictionSection | None) -> str:
    """The effect beside the geometry that costs a planned machine most."""
    budget = None if prediction is None else prediction.budget
    if prediction is None or budget is None or not budget.unmodelled:
        return ""
    if prediction.mode != "plan":
        return ""
    largest = budget.unmodelled[0]
    effect = largest.effect.replace("_", " ")
    size = text.replace_symbols(largest.expected)
    by_form = ", depending on its form" if " to " in size else ""
    return (
        f"{effect}, counted at its usual size of {size}{by_form}: on this machine it can be"
        f" ten times larger or smaller. What removes it: {largest.remedy.rstrip('.')}."
    )


def _scope_doubt(result: StudyResult) -> str:
    """What figures leave out that nothing else speaks against."""
    if result.forecast is not None and result.forecast.sentences:
        holds = result.forecast.sentences[1:2] or result.forecast.sentences
        return (
            f"{holds[0].rstrip('.')}. What removes it: nodes read in the state of use."
        )
    if result.judged_prediction is None or result.gap is not None:
        return ""
    return (
        "the figures are of the geometry alone; heat, load, play and other effects come on"
        " top. What removes it: a test of the compensated machine, which `oed verify` plans."
    )


def fits_with_effects(result: StudyResult) -> bool:
    """Whether the fit with effects is delivered, and nothing speaks against it."""
    return result.corrected is not None and not result.corrected.warnings


def ranked_warnings(result: StudyResult) -> Iterator[str]:
    """All warnings of a result, those that spoil the most first.

    A bad fit spoils everything; then what was promised and is not kept; then what a
    fit or a correction rests on.
    """
    objections = trust.objections(result)
    is_trusted = not objections
    if fits_with_effects(result):
        yield from _conditions(result)
    if result.goodness is not None:
        yield from result.goodness.findings
        if result.goodness.bad_fit and result.goodness.findings:
            objections = objections[1:]
    yield from objections
    if result.plan is not None and is_missed(result.plan):
        yield "The plan does not reach the wanted accuracy"
    failed = [claim.claim for claim in result.claims if not claim.met]
    if failed:
        noun = "a claim" if len(failed) == 1 else f"{len(failed)} claims"
        yield f"The study misses {noun}: {text.listing(failed)}"
    if result.corrected is not None and not fits_with_effects(result):
        yield from _conditions(result)
        yield from result.corrected.warnings
    fit = [] if result.estimate is None else result.estimate.warnings
    is_virtual = is_plan(result) and result.judged_prediction is not None
    if is_virtual and is_trusted:
        # what the fit of a virtual machine leaves unknown has a part of its own
        yield from (warning for warning in result.warnings if warning not in fit)
        return
    if not fits_with_effects(result):
        yield from fit
    yield from result.warnings


def _test(gap: GapSection) -> str:
    """Which readings would show the likeliest cause that is known."""
    for answer in gap.answers:
        for effect in answer.effects:
            if effect in gap.about and gap.about[effect].exposed_by:
                name = effect.replace("_", " ")
                return f"readings that show whether it is {name}: {gap.about[effect].exposed_by}"
    return "the readings under What to do"


def _conditions(result: StudyResult) -> Iterator[str]:
    """What the accuracy of the first page rests on beside the readings."""
    section, gap = result.corrected, result.gap
    if section is None or not section.conditions:
        return
    if gap is not None and gap.mixture is not None and gap.mixture.with_effects is None:
        yield (
            "The cause is not certain: parameters are sent, no effect is corrected, and the"
            f" accuracy is an average over the possible causes. What removes this: {_test(gap)}"
        )
        return
    yield (
        f"The accuracy rests on these conditions: {'; '.join(section.conditions)}. What"
        " removes this: a test of the compensated machine, which `oed verify` plans"
    )


#: anchor, title and content of each part, in order
Title = str | Callable[[StudyResult], str]
Part = tuple[str, Title, Callable[[StudyResult], list[Block]]]
PARTS: Final[tuple[Part, ...]] = (
    ("short", "In short", lead_blocks),
    ("causes", "What causes the error", cause_blocks),
    ("numbers", "Old and new numbers", number_blocks),
    ("measure", measure_title, measure_blocks),
    ("how-accurate", "How accurate it is afterwards", accuracy_blocks),
    ("unknown", "What stays unknown", unknown_blocks),
    ("warnings", warnings_title, warning_blocks),
)


def answer_parts(result: StudyResult) -> list[Section]:
    """The parts of the first page that this result can answer.

    A table of accuracies with verdicts is as wide as two cards, and stands above them.
    """
    parts = list(PARTS)
    if wanted_accuracy(result):
        anchors = [anchor for anchor, _, _ in PARTS]
        accuracy = parts.pop(anchors.index("how-accurate"))
        parts.insert(anchors.index("measure"), accuracy)
    content = [
        Section(
            anchor, title if isinstance(title, str) else title(result), blocks(result)
        )
        for anchor, title, blocks in parts
    ]
    return [part for part in content if part.blocks]


# What a terminal shows of a report: its first lines, and one accuracy a component.

MAX_FINDINGS: Final = 3  #: sentences of a diagnosis, the verdict among them


@dataclasses.dataclass(frozen=True, slots=True)
class FirstLines:
    """The first page in a few lines."""

    sentences: list[str]  #: what was read or is to be, how accurate, the main doubt
    table: Table | None  #: of the accuracy; None without a prediction
    findings: list[str]  #: of a diagnosis: how large the causes are, and where
    actions: list[str]  #: what to do next
    warnings: list[str]  #: those beside the main doubt
    is_plan: bool  #: whether readings are to be taken, not evaluated


def first_lines(result: StudyResult) -> FirstLines:
    """The lines of a result, plain: no typographic spaces."""
    parts: dict[str, Sequence[Block]] = {
        "short": (),
        "how-accurate": (),
        "warnings": (),
    }
    parts |= {part.anchor: part.blocks for part in answer_parts(result)}
    gap = result.gap
    tables = [block for block in parts["how-accurate"] if isinstance(block, Table)]
    return FirstLines(
        sentences=_sentences(parts["short"]),
        table=tables[0] if tables else None,
        findings=[] if gap is None else _plain(gap.words[1:MAX_FINDINGS]),
        actions=[] if gap is None else _plain(gap.next[:1]),
        warnings=_sentences(b for b in parts["warnings"] if isinstance(b, Notice)),
        is_plan=is_plan(result),
    )


def _plain(phrases: Sequence[str]) -> list[str]:
    return [text.plain(sentence) for sentence in text.sentences(phrases)]


def _sentences(blocks: Iterable[Block]) -> list[str]:
    """The words of paragraphs and notices, as a terminal shows them."""
    return [
        text.plain(block.text)
        for block in blocks
        if isinstance(block, Paragraph | Notice)
    ]
