"""Designs for several criteria: what the plan made for one is worth by the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    number_column,
)
from pkm_reports.figures import compared
from pkm_reports.sections.parts import certificate

Part = Mapping[str, Any]
#: more criteria than this, and the cross values have a table of their own
TOGETHER: Final = 4


def blocks(design: Part) -> list[Block]:
    """Figure of efficiencies, and the values behind it."""
    entries = design.get("compared") or []
    if not entries:
        return []
    names = [str(entry["name"]) for entry in entries]
    made: list[Block] = [Paragraph(_about(names))]
    made.append(
        Picture(
            "compared",
            lambda: compared.draw(design),
            _caption(entries, design.get("directions")),
        )
    )
    own = [_own(entry) for entry in entries]
    cross = [_cross(entry, names) for entry in entries]
    columns = [
        TableColumn("Criterion"),
        *number_column("Value", "Bound", "Certified", f"Gain over {names[0]}"),
    ]
    others = number_column(*[f"made for {name}" for name in names])
    about = (
        "One row a criterion: what the plan made for it reaches, the bound that no"
        " plan passes, the share of the best possible it is certified to, and by how"
        f" much it betters the plan made for {names[0]}."
    )
    values = (
        "Values by each criterion (row) of the plan made for each criterion (column)."
        f" {_larger(names)}"
    )
    if len(names) <= TOGETHER:
        rows = [[*left, *right] for left, right in zip(own, cross, strict=True)]
        return [
            *made,
            Table(
                [*columns, *others],
                rows,
                f"{about} Then its value for the plan made for each criterion.",
            ),
        ]
    rows = [[name, *right] for name, right in zip(names, cross, strict=True)]
    return [
        *made,
        Table(columns, own, about),
        Table([TableColumn("By"), *others], rows, values),
    ]


def _about(names: Sequence[str]) -> str:
    several = "1 criterion" if len(names) == 1 else f"{len(names)} criteria"
    return (
        f"Under the same rules plans were made for {several}, {words.listing(names)},"
        " and each was judged by all of them. The plan of this study is the one made"
        f" for {names[0]}."
    )


def _larger(names: Sequence[str]) -> str:
    """Which way is better."""
    return (
        "Larger is better; for kappa, smaller."
        if "kappa" in names
        else "Larger is better."
    )


def _own(entry: Part) -> list[str]:
    name = str(entry["name"])
    bound = entry.get("bound")
    share = "proven" if entry.get("proven") else words.certain(entry.get("efficiency"))
    limit = words.MISSING if bound is None else certificate.told(name, bound)
    return [
        name,
        certificate.told(name, entry.get("value")),
        limit,
        share,
        words.factor(entry.get("gain")),
    ]


def _cross(entry: Part, names: Sequence[str]) -> list[str]:
    values = entry.get("values") or {}
    return [certificate.told(str(entry["name"]), values.get(name)) for name in names]


def _caption(entries: Sequence[Part], directions: Any) -> str:
    """The dearest and the cheapest compromise."""
    names, table = (
        [str(entry["name"]) for entry in entries],
        compared.efficiencies(entries, directions),
    )
    text = (
        "Efficiency by each criterion (row) of the plan made for each criterion"
        " (column), against the plan that was made for the row's criterion."
    )
    apart = np.where(np.eye(len(names), dtype=bool), np.nan, table)
    if not np.isfinite(apart).any():
        return text
    i, j = np.unravel_index(int(np.nanargmin(apart)), apart.shape)
    text += (
        f" The worst: the plan made for {names[j]} is worth"
        f" {words.percent(apart[i, j])} by {names[i]}."
    )
    least = np.nanmin(np.where(np.isfinite(table), table, np.inf), axis=0)
    best = int(np.argmax(least))
    return (
        f"{text} The best compromise is the plan made for {names[best]}:"
        f" {words.percent(least[best])} or more by all."
    )
