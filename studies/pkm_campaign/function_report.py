"""What the cases of a user's function show: its summary, by combination."""

from __future__ import annotations

import math
from typing import Any

from pkm_campaign.tables import Campaign
from pkm_reports import text
from pkm_reports.blocks import Section, Table, TableColumn, number_columns

Rows = list[dict[str, Any]]
#: columns of figures that a table holds beside those of the cases
WIDTH = 6


def sentences(rows: Rows) -> list[str]:
    """How many cases there are, and how many have no figures."""
    failed = sum(int(row["failed"]) for row in rows)
    count = sum(int(row["cases"]) for row in rows)
    return [f"{count} cases in {len(rows)} combinations; {failed} failed."]


def chapters(campaign: Campaign, rows: Rows) -> list[Section]:
    """Tables of the summary; wide ones in parts."""
    names = [
        name
        for name in dict.fromkeys(name for row in rows for name in row)
        if name not in campaign.vary and name not in ("cases", "failed")
    ]
    parts = [names[i : i + WIDTH] for i in range(0, len(names), WIDTH)] or [[]]
    tables = [_table(campaign, rows, part) for part in parts]
    return [Section("summary", "Summary", tables)]


def _table(campaign: Campaign, rows: Rows, names: list[str]) -> Table:
    columns = [
        TableColumn("Combination"),
        *number_columns("cases", "failed", *names),
    ]
    cells = []
    for row in rows:
        counts = [str(row["cases"]), str(row["failed"])]
        figures = [_figure(row.get(name, math.nan)) for name in names]
        cells.append([campaign.words(row), *counts, *figures])
    return Table(columns, cells, "Figures of all cases of a combination.")


def _figure(value: Any) -> str:
    """A number, or a text as it is."""
    return value if isinstance(value, str) else text.number(float(value))
