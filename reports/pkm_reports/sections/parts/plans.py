"""The chosen plan and others side by side: by the criterion, and by the accuracy that
they lead to.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Picture,
    Table,
    TableColumn,
    number_column,
    transposed,
)
from pkm_reports.figures import predicted
from pkm_reports.sections.parts import certificate

Part = Mapping[str, Any]


def blocks(design: Part) -> list[Block]:
    """Scores, then predicted accuracy as figure and table."""
    plans = design.get("plans") or []
    if not plans:
        return []
    made: list[Block] = [_scores(design, plans)]
    if any(p.get("predicted") for p in plans):
        made.append(Picture("predicted", lambda: predicted.draw(plans), _dots(plans)))
        made.append(_accuracy(design, plans))
    return made


# -- by the criterion ------------------------------------------------------------------


def _scores(design: Part, plans: Sequence[Part]) -> Table:
    names = list(
        dict.fromkeys(key for p in plans for key in p.get("observability") or {})
    )
    criterion = str(plans[0]["criterion"])
    own = (
        []
        if criterion == "D"
        else [(criterion, [certificate.told(criterion, p.get("value")) for p in plans])]
    )
    told = [
        ("Readings", [str(p["n"]) for p in plans]),
        *own,
        ("log det", [words.fixed(p["logdet"], 2) for p in plans]),
        (f"{criterion}-efficiency", [words.percent(p["efficiency"]) for p in plans]),
        *(
            []
            if criterion == "kappa"
            else [("κ", [words.num(p["kappa"], 4) for p in plans])]
        ),
        *[
            (o, [words.num((p.get("observability") or {}).get(o), 3) for p in plans])
            for o in names
            if o != criterion
        ],
    ]
    cells = [[str(p["name"]) for p in plans], *[texts for _, texts in told]]
    columns = [
        TableColumn("Plan", wide=True),
        *number_column(*[title for title, _ in told]),
    ]
    return Table(
        columns, transposed(cells), _compared(design, plans), _marks(design, plans)
    )


def _marks(design: Part, plans: Sequence[Part]) -> list[str]:
    return ["chosen" if _is_chosen(p, design) else "" for p in plans]


def _is_chosen(score: Part, design: Part) -> bool:
    return score["name"] == "chosen" or all(
        score.get(key) == design.get(key) for key in ("n", "value", "kappa")
    )


def _compared(design: Part, plans: Sequence[Part]) -> str:
    """Caption of the comparison: the chosen plan against the best and worst of the
    others.
    """
    text = (
        "The chosen plan (marked) and plans to compare it with. Higher log det is"
        " better, lower κ is better."
    )
    mine = [p for p in plans if _is_chosen(p, design)]
    others = [
        p
        for p in plans
        if not _is_chosen(p, design) and words.number(p["efficiency"]) > 0.0
    ]
    if not mine or not others or not words.number(mine[0]["efficiency"]) > 0.0:
        return text
    rival = max(others, key=lambda p: words.number(p["efficiency"]))
    share = words.number(rival["efficiency"]) / words.number(mine[0]["efficiency"])
    if share > 1.0:
        return f"{text} The plan “{rival['name']}” is ahead of the chosen one."
    text += (
        f" The next best, “{rival['name']}”, is worth {words.percent(share)} of the"
        " chosen one"
    )
    if rival["criterion"] != "D" or rival["n"] != mine[0]["n"]:
        return f"{text}."
    # D-efficiency grows in proportion to the number of readings.
    more = math.ceil(rival["n"] / share - rival["n"])
    return (
        f"{text}: it would take about {words.count(more, 'reading')} more to learn as"
        " much."
    )


# -- by predicted accuracy -------------------------------------------------------------


def _dots(plans: Sequence[Part]) -> str:
    """Caption of the figure: what the chosen plan leaves of each component."""
    first = plans[0]
    rms = [
        f"{words.parted(k)[0]} {words.quantity(v, words.parted(k)[1])}"
        for k, v in first["predicted"].items()
    ]
    text = (
        "Predicted rms error of each component over the workspace once all that is"
        " known of it is corrected, on a log scale; a mark for each plan, left is"
        " better."
    )
    text += f" The plan “{first['name']}” leaves {words.listing(rms)}." if rms else ""
    left = len([p for p in plans if p.get("predicted")]) - predicted.MOST
    return text + (f" {left} more are in the table only." if left > 0 else "")


def _accuracy(design: Part, plans: Sequence[Part]) -> Table:
    """Two lines for each plan: rms errors, and how many times as accurate as the plan
    to compare with.
    """
    keys, marks, against = (
        predicted.components(plans),
        _marks(design, plans),
        _reference(plans),
    )
    rows, marked = [], []
    for plan, mark in zip(plans, marks, strict=True):
        rows.append(
            [
                str(plan["name"]),
                *[words.num((plan.get("predicted") or {}).get(key)) for key in keys],
            ]
        )
        marked.append(mark)
        if against is not None and plan is not against and plan.get("gain"):
            rows.append(
                [
                    "… times as accurate",
                    *[words.factor(plan["gain"].get(key)) for key in keys],
                ]
            )
            marked.append(mark)
    columns = [
        TableColumn("Plan", wide=True),
        *number_column(*[words.heading(key) for key in keys]),
    ]
    caption = "Predicted rms errors, plan by plan"
    caption += (
        f", and how many times as accurate as with “{against['name']}”."
        if against
        else "."
    )
    gain = [words.number(v) for v in (plans[0].get("gain") or {}).values()]
    if against is not None and gain:
        least, most = words.factor(min(gain)), words.factor(max(gain))
        caption += (
            " The chosen plan gains"
            f" {least if least == most else f'{least} to {most}'}."
        )
    return Table(columns, rows, caption, marked)


def _reference(plans: Sequence[Part]) -> Part | None:
    """The plan that gains are told against: the first after the chosen one."""
    return plans[1] if len(plans) > 1 and any(p.get("gain") for p in plans) else None
