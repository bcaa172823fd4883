"""Columns of a tracker's file that its header explains: points and their uncertainties.

Read are the forms that files of trackers are known to have: X [mm] and U(95) X [mm] of
Hexagon's tracker software, with a unit each, and SpatialAnalyzer's names of the columns in
a comment, without one; of motion capture Position over X, and TX over mm. Points without
a unit are taken for millimetres, which their best fit to the machine confirms or refuses.
Everything else needs a map.
"""

from __future__ import annotations

import re

from pkm_studies.base.csv_table import CsvTable
from pkm_studies.base.errors import InputError
from pkm_studies.importers import column_sources
from pkm_studies.study.tables.column_map import ColumnMap, ColumnSource

CHANNELS = ("read_x", "read_y", "read_z")
UNIT = r"(?:[\[(]\s*(?P<unit>mm|m|in|um)\s*[\])])"
#: measured coordinates: X, x [mm], x_meas, Position X, TX [mm]
MEASURED = re.compile(
    rf"\s*(?:position\s+|t)?(?P<axis>[xyz])\s*(?:{UNIT}|_?meas(?:ured)?|_?m)?\s*",
    re.IGNORECASE,
)
#: expanded uncertainty of a coordinate, of coverage 95 %
U95 = re.compile(rf"\s*U\(95\)\s*(?P<axis>[xyz])\s*{UNIT}\s*", re.IGNORECASE)
COVERAGE = 2.0
#: columns that may be a standard deviation, or k times that
UNCERTAINTY = re.compile(
    r"\s*(?:u|u95|std|stdev|sigma|sd|unc|uncertainty)[ _.]*[(]?[xyz]\b.*", re.IGNORECASE
)
DELETED = "Delete"


def with_measured(given: ColumnMap, table: CsvTable) -> dict[str, str | ColumnSource]:
    """The map's columns, with the points of the file where it names none.

    Raises InputError where two columns may be a coordinate, and for points that the
    tracker's user deleted.
    """
    mapped: dict[str, str | ColumnSource] = dict(given.columns)
    if any(name.startswith(CHANNELS) for name in [*mapped, *table.header]):
        return mapped
    _check_deleted(table)
    others = set(column_sources.names(mapped).values())
    axes: dict[str, str] = {}
    for header in [name for name in table.header if name not in others]:
        match, spread = MEASURED.fullmatch(header), U95.fullmatch(header)
        if match:
            axis = match["axis"].lower()
            _check_alone(table, axis, header, axes)
            mapped[f"read_{axis}_{_unit(match)}"] = axes[axis] = header
        if spread:
            name = f"sigma_read_{spread['axis'].lower()}_{_unit(spread)}"
            mapped[name] = ColumnSource(column=header, k=COVERAGE)
    return mapped


def uncertainty_sentences(
    table: CsvTable, mapped: dict[str, str | ColumnSource]
) -> list[str]:
    """What is not known of columns that may be uncertainties."""
    used = column_sources.names(mapped).values()
    unsure = [n for n in table.header if UNCERTAINTY.fullmatch(n) and n not in used]
    if not unsure:
        return []
    return [
        f"Not read, for want of a coverage factor: {', '.join(unsure)}. A map says it:"
        f' sigma_read_x_mm = {{ column = "{unsure[0]}", k = 2 }} for U95.'
    ]


def _unit(match: re.Match[str]) -> str:
    return (match["unit"] or "mm").lower()


def _check_alone(table: CsvTable, axis: str, header: str, axes: dict[str, str]) -> None:
    if axis in axes:
        raise InputError(
            f"{axes[axis]} and {header} may both be the measured {axis}",
            f"write a map that names one: [columns] read_{axis}_mm",
            file=table.file,
            field="header",
        )


def _check_deleted(table: CsvTable) -> None:
    """Raises InputError for a line that the tracker's user marked as deleted."""
    if DELETED not in table.header:
        return
    for k, cell in enumerate(table.cells(DELETED)):
        if cell.lower() not in ("", "false", "0"):
            remedy = "take the line out, or write a map that names the columns"
            raise table.error(k, DELETED, "the point was deleted", remedy)
