"""The first lines of a report: what was read or is to be, how accurate, the main doubt."""

from __future__ import annotations

from oed import trust
from oed.result import ForecastSection, GapSection, StudyResult
from pkm_reports import text
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
        *_accuracy(result),
        *_forecast(result.forecast),
    ]
    doubt = warnings.main_doubt(result).words
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
    """How many readings to take or taken, with what, and how long it takes."""
    instruments = text.listing(measure.instrument_names(measure.used_setups(result)))
    by = f" with the {instruments}" if instruments else ""
    if measure.is_plan(result):
        number = measure.planned_readings(result)
        minutes = duration.minutes(result)
        end = f": {minutes}." if minutes else "."
        return [f"Take {text.count(number, 'reading')}{by}{end}"]
    number, values = measure.recorded_readings(result)
    if not number:
        return []
    of_values = "" if values == number else f" ({text.count(values, 'value')})"
    verb = "was" if number == 1 else "were"
    return [f"{text.count(number, 'reading')}{of_values}{by} {verb} evaluated."]


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
        nodes = text.count(len(forecast.nodes), "node")
        return [
            f"Measure the errors at {nodes} with set-up {forecast.setup}:"
            f" {forecast.minutes:.0f} min."
        ]
    parts = [
        f"{name}{text.NO_BREAK}{text.quantity(c.predicted, c.unit)}"
        f" ({text.number(c.low, 2)} to {text.number(c.high, 2)} with 95 %)"
        for name, c in forecast.components.items()
    ]
    return [
        f"{text.count(forecast.readings, 'reading')} of nodes with set-up {forecast.setup}"
        " were evaluated. With the controller's table"
        f" the rms error over the workspace is predicted to be {text.listing(parts)},"
        f" against {forecast.reference}."
    ]
