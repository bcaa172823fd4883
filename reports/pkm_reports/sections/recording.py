"""Table of what else to record: what each covariate or choice is worth to a plan."""

from __future__ import annotations

from oed.result import RecordedChoice, RecordingSection
from pkm_reports import text
from pkm_reports.blocks import Block, Paragraph, Table, number_columns, wide_column


def blocks(recording: RecordingSection | None) -> list[Block]:
    """A sentence and the table; nothing where no effect depends on a covariate."""
    if recording is None or not recording.choices:
        return []
    keys = list(recording.accuracy)
    columns = [
        wide_column("Record as well"),
        wide_column("Effects that depend on it"),
        *number_columns("error falls by", "worth", *map(_heading, keys)),
    ]
    rows = [_first(recording)]
    for choice in recording.choices:
        cells = [choice.words, ", ".join(choice.effects) or "-"]
        cells += [text.percent(choice.gain), _worth(choice)]
        rows.append([*cells, *_values(choice.accuracy, keys)])
    rows.append(_floor(recording))
    sentence = (
        "What else to record: the predicted error where nothing but poses and readings is"
        " recorded, and what each covariate or choice takes off it. The same covariate must"
        " be known when the machine is used."
    )
    caption = (
        f"Rms errors over the workspace after compensation by {recording.readings}"
        " readings, to first order. Worth: further readings like these that would give the"
        " same without it; floor: no number does."
    )
    return [Paragraph(sentence), Table(columns, rows, caption)]


def _first(recording: RecordingSection) -> list[str]:
    values = _values(recording.accuracy, list(recording.accuracy))
    return ["nothing", "", "", "", *values]


def _floor(recording: RecordingSection) -> list[str]:
    values = _values(recording.floor, list(recording.accuracy))
    return ["nothing, with any number of readings", "", "", "", *values]


def _heading(key: str) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem}, {unit}"


def _worth(choice: RecordedChoice) -> str:
    if choice.readings is None:
        return "floor"
    return text.count(choice.readings, "reading")


def _values(accuracy: dict[str, float], keys: list[str]) -> list[str]:
    return [f"{accuracy[key]:.3g}" if key in accuracy else "-" for key in keys]
