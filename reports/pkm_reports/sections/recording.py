"""A plan that allows for effects: what it leaves, and what else to record."""

from collections.abc import Iterable, Mapping

from oed.result import RecordedChoice, RecordingSection
from pkm_reports import text
from pkm_reports.blocks import Block, Paragraph, Table, TableColumn


def remaining_errors(
    errors: Mapping[str, Mapping[str, float]], keys: Iterable[str], caption: str
) -> Table:
    """Rms errors by title and component with unit (`z_um`), a row a component."""
    columns = [
        TableColumn("Error after compensation, rms", wide=True),
        *TableColumn.numbers(*errors),
    ]
    rows = []
    for key in keys:
        stem, unit = text.split_unit(key)
        cells = [text.quantity(accuracy[key], unit) for accuracy in errors.values()]
        rows.append([stem, *cells])
    return Table(columns, rows, caption)


def recording_blocks(recording: RecordingSection | None) -> list[Block]:
    """A sentence and the table; nothing where no effect depends on a covariate."""
    if recording is None or not recording.choices:
        return []
    keys = list(recording.accuracy)
    columns = [
        TableColumn("Record as well", wide=True),
        TableColumn("Effects that depend on it", wide=True),
        *TableColumn.numbers("error falls by", "worth", *map(_accuracy_heading, keys)),
    ]
    known = _accuracy_values(recording.accuracy, keys)
    rows = [["nothing", "", "", "", *known]]
    for choice in recording.choices:
        cells = [choice.words, ", ".join(choice.effects) or "-"]
        cells += [text.percent(choice.gain), _worth(choice)]
        rows.append([*cells, *_accuracy_values(choice.accuracy, keys)])
    floor = _accuracy_values(recording.floor, keys)
    rows.append(["nothing, with any number of readings", "", "", "", *floor])
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


def _accuracy_heading(key: str) -> str:
    stem, unit = text.split_unit(key)
    return f"{stem}, {unit}"


def _worth(choice: RecordedChoice) -> str:
    if choice.readings is None:
        return "floor"
    return text.count(choice.readings, "reading")


def _accuracy_values(accuracy: dict[str, float], keys: list[str]) -> list[str]:
    return [f"{accuracy[key]:.3g}" if key in accuracy else "-" for key in keys]
