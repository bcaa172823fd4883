"""The first lines of a report: what was read or is to be, how accurate, the main doubt."""

from __future__ import annotations

from oed import trust
from oed.result import ForecastSection, GapSection, StudyResult
from pkm_reports import missing, text
from pkm_reports.blocks import Block, Notice, Paragraph
from pkm_reports.sections.answer import accuracy, duration, measure, warnings


def title(result: StudyResult) -> str:
    """The heading of the lines."""
    return "In short"


def blocks(result: StudyResult) -> list[Block]:
    """One paragraph, and the main doubt with what removes it; a bad fit before all."""
    sentences = [
        *_causes(result.gap),
        *_readings(result),
        *_fit(result),
        *_accuracy(result),
        *_forecast(result.forecast),
    ]
    doubt = warnings.main_doubt(result)
    content: list[Block] = [Paragraph(" ".join(sentences))] if sentences else []
    if not doubt:
        return content
    if trust.objections(result):
        return [Notice(doubt), *content]
    return [*content, Notice(doubt)]


def _causes(gap: GapSection | None) -> list[str]:
    """The verdict of a diagnosis."""
    return [] if gap is None else text.sentences(gap.words[:1])


def _readings(result: StudyResult) -> list[str]:
    """How many readings to take with what, and how long it takes."""
    if not measure.is_plan(result):
        return []
    number = measure.planned_readings(result)
    instruments = measure.instrument_names(measure.used_setups(result))
    sentence = f"Take {text.count(number, 'reading')}"
    if instruments:
        sentence += f" with the {text.listing(instruments)}"
    minutes = duration.minutes(result)
    return [f"{sentence}: {minutes}." if minutes else f"{sentence}."]


def _fit(result: StudyResult) -> list[str]:
    """What the fit leaves of the readings; a diagnosis says it for its hypotheses."""
    estimate = result.estimate
    if estimate is None or result.gap is not None or measure.is_plan(result):
        return []
    changes = [
        f"{channel} from {text.channel_value(channel, before, estimate.units)} to"
        f" {text.channel_value(channel, after, estimate.units)}"
        for channel, after in estimate.rms_after.items()
        for before in [missing.entry(estimate.rms_before, channel)]
    ]
    number = text.count(estimate.readings, "reading")
    return [f"The fit of {number} changes the rms residual of {text.listing(changes)}."]


def _accuracy(result: StudyResult) -> list[str]:
    """The error that is left of each component, and the condition of the figures."""
    prediction = result.judged_prediction
    if prediction is None or not prediction.components:
        return []
    errors = accuracy.remaining_errors(result, prediction.components)
    judged = accuracy.verdicts(result, prediction.components)
    parts = []
    for name, error in errors.items():
        part = f"{name}{text.NO_BREAK}{text.quantity(error.rms, error.unit)}"
        if name in judged:
            wanted = text.quantity(judged[name].wanted, error.unit)
            part += f" ({wanted} wanted: {judged[name].judgement})"
        parts.append(part)
    scopes = text.listing(dict.fromkeys(error.scope for error in errors.values()))
    reference = text.meaning(prediction.reference, accuracy.REFERENCES)
    return [
        f"After compensation the rms error is predicted to be {text.listing(parts)},"
        f" {reference}, {scopes}."
    ]


def _forecast(forecast: ForecastSection | None) -> list[str]:
    """What the controller's table of a forecast leaves, or what its plan reads."""
    if forecast is None:
        return []
    if not forecast.readings:
        return [
            f"Measure the errors at {text.count(len(forecast.nodes), 'node')} with set-up"
            f" {forecast.setup}: {forecast.minutes:.0f} min."
        ]
    parts = [
        f"{name}{text.NO_BREAK}{text.quantity(c.predicted, c.unit)}"
        f" ({text.number(c.low, 2)} to {text.number(c.high, 2)} with 95 %)"
        for name, c in forecast.components.items()
    ]
    return [
        "With the controller's table the rms error over the workspace is predicted to be"
        f" {text.listing(parts)}."
    ]
