"""Chapter: forecast compensation, its nodes and what its table leaves."""

from typing import Final

from oed.result import ForecastSection, StudyResult
from pkm_reports import text
from pkm_reports.blocks import (
    Block,
    Chapter,
    Paragraph,
    Table,
    TableColumn,
    headed_list,
)


def blocks(result: StudyResult) -> list[Block]:
    """What is left, and the nodes that were or are to be measured."""
    forecast = result.forecast
    if forecast is None:
        return []
    chapter: list[Block] = [Paragraph(_introduction(forecast)), _planned(forecast)]
    if forecast.readings:
        chapter.append(_residual(forecast))
    if any(c.checked is not None for c in forecast.components.values()):
        chapter.append(_checked(forecast))
    chapter += headed_list("These figures rest on:", forecast.sentences)
    chapter.append(_nodes(forecast))
    return chapter


def printed(result: StudyResult) -> list[Block]:
    """What the figures rest on, and the nodes."""
    forecast = result.forecast
    if forecast is None:
        return []
    rests = headed_list("These figures rest on:", forecast.sentences)
    nodes = [] if forecast.readings else [_nodes(forecast)]
    return [Paragraph(_introduction(forecast)), *rests, *nodes]


def answer(forecast: ForecastSection) -> Table:
    """What the controller's table leaves; before a reading what the plan leaves."""
    return _residual(forecast) if forecast.readings else _planned(forecast)


def _introduction(forecast: ForecastSection) -> str:
    phrase = (
        f"Errors that repeat at the same command are measured at nodes and subtracted in"
        f" advance, relative to {forecast.reference}. The plan has"
        f" {text.count(len(forecast.nodes), 'node')}, which set-up {forecast.setup} reads"
        f" in {forecast.minutes:.0f} min."
    )
    if not forecast.readings:
        return f"{phrase} They are not measured yet."
    grid = " × ".join(str(count) for count in forecast.table.values())
    rows = text.count(forecast.readings, "measured row")
    return (
        f"{phrase} A field of errors is estimated from {rows} with their noise known, and"
        f" the controller's table has {grid} commands."
    )


def _cells(*values: float | None) -> list[str]:
    return ["" if value is None else text.number(value) for value in values]


def _table(
    forecast: ForecastSection, titles: list[str], fields: list[str], caption: str
) -> Table:
    rows = [
        [
            f"{name} [{text.unit_symbol(c.unit)}]",
            *_cells(*(getattr(c, field) for field in fields)),
        ]
        for name, c in forecast.components.items()
    ]
    return Table(
        [TableColumn("Component"), *TableColumn.numbers(*titles)], rows, caption
    )


def _planned(forecast: ForecastSection) -> Table:
    caption = (
        "Before a reading: rms errors that calibration is expected to leave, and that"
        " interpolation between the nodes is predicted to leave."
    )
    return _table(forecast, ["Expected", "Left"], ["expected", "planned"], caption)


def _residual(forecast: ForecastSection) -> Table:
    titles = [
        "At nodes",
        "With table",
        "from",
        "to (95 %)",
        "Left out",
        "its prediction",
    ]
    fields = ["measured", "predicted", "low", "high"]
    fields += ["left_out", "left_out_predicted"]
    caption = (
        "Rms errors at the nodes, and those that the table is predicted to leave over the"
        " workspace with the 95 % interval. Left out: how far each node is from what all other"
        " nodes predict there, noise of its reading included, and how far it should be."
    )
    return _table(forecast, titles, fields, caption)


def _checked(forecast: ForecastSection) -> Table:
    titles = ["Rms", "Predicted", "Largest", "Largest without"]
    fields = ["checked", "checked_predicted", "checked_max", "checked_max_before"]
    caption = "What the table leaves at measured nodes that were not fitted."
    return _table(forecast, titles, fields, caption)


def _nodes(forecast: ForecastSection) -> Table:
    titles = [text.heading(name) for name in forecast.nodes[0]]
    rows = [[text.trimmed(v, 6) for v in node.values()] for node in forecast.nodes]
    return Table(
        TableColumn.numbers(*titles), rows, "Nodes, the most useful one first."
    )


CHAPTER: Final = Chapter("forecast", "Forecast compensation", blocks, printed)
