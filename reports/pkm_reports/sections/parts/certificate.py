"""The certificate of the chosen plan: in words, in numbers, and what was refused
before.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import Block, Paragraph, Table, TableColumn

Part = Mapping[str, Any]
#: what a criterion asks for
MEANING: Final = {
    "D": "log det of the information: the volume of all uncertainty together",
    "Ds": "log det over the parameters of interest alone",
    "A": "sum of the variances of the parameters, with a minus sign",
    "c": "variance of one combination of parameters, with a minus sign",
    "I": "mean variance of the pose over the workspace, with a minus sign",
    "G": "largest variance of the pose over the workspace, with a minus sign",
    "E": "least eigenvalue of the information: the direction known worst",
    "kappa": "condition number of the scaled identification matrix",
    "O1": (
        "geometric mean of the singular values over the root of the number of readings"
    ),
    "O2": "reciprocal condition number",
    "O3": "least singular value",
    "O4": "least singular value squared over the largest",
    "O5": "reciprocal of the sum of the reciprocal singular values",
    "compound": "weighted mean of the logarithms of several criteria",
}


def blocks(design: Part) -> list[Block]:
    """Sentence, numbers, refusals."""
    rows = [[name, text] for name, text in _facts(design) if text]
    columns = [
        TableColumn("Quantity"),
        TableColumn("Of the chosen readings", wide=True),
    ]
    told = Table(columns, rows, _caption(design))
    return [Paragraph(sentence(design)), told, *_refused(design)]


def sentence(design: Part) -> str:
    """How good the choice is known to be."""
    if design.get("words"):
        return words.sentence(str(design["words"]))
    what = f"{words.count(design['n'], 'reading')}"
    if design.get("candidates"):
        what += f" out of {words.count(design['candidates'], 'candidate')}"
    if design.get("proven"):
        return (
            f"Proven optimal: no other choice of {what} is better by criterion"
            f" {design['criterion']}."
        )
    if design.get("efficiency") is not None:
        return (
            f"Certified to {words.certain(design['efficiency'])} of the best possible"
            f" {what}."
        )
    return (
        f"The best {what} that were found by criterion {design['criterion']}; no bound"
        " is known."
    )


def told(criterion: str, value: Any) -> str:
    """A value as criteria are told: logarithms with two decimals."""
    return (
        words.fixed(value, 2)
        if criterion in ("D", "Ds", "compound")
        else words.num(value, 4)
    )


def _facts(design: Part) -> list[tuple[str, str]]:
    """Name and text of all that is stored; empty texts are left out."""
    name = str(design["criterion"])
    shares = {n: words.number(v) for n, v in (design.get("compound") or {}).items()}
    total = sum(shares.values()) or 1.0
    parts = words.listing(f"{words.percent(v / total)} {n}" for n, v in shares.items())
    meaning = MEANING.get(name, "")
    bound, gap, minutes = design.get("bound"), design.get("gap"), design.get("cost_min")
    seen, columns = design.get("directions"), design.get("columns")
    kept = design.get("kept") or 0
    return [
        ("Criterion", f"{name}: {meaning}" if meaning else name),
        ("Shares", parts),
        ("Value", told(name, design["value"])),
        (
            "Bound",
            (
                ""
                if bound is None
                else f"{told(name, bound)}: no choice is {_better(name)}"
            ),
        ),
        (
            "Certificate",
            "proven optimal" if design.get("proven") else _certified(design),
        ),
        ("Slack of the bound", "" if gap is None else _slack(words.number(gap))),
        ("Directions seen", f"{seen} of {columns}" if seen and columns else ""),
        (
            "Readings",
            (
                f"{design['n']}, of which {kept} belonged to the plan before"
                if kept
                else str(design["n"])
            ),
        ),
        ("Candidates", str(design.get("candidates") or "")),
        ("Set-ups, in working order", words.listing(design.get("setups") or [], 20)),
        (
            "Cost",
            (
                ""
                if minutes is None
                else f"{words.quantity(minutes, 'min')} to mount and to read"
            ),
        ),
        ("Condition number", words.num(design.get("kappa"), 4)),
        ("Scaling of the parameters", str(design.get("scaling") or "")),
    ]


def _better(criterion: str) -> str:
    return "smaller" if criterion == "kappa" else "larger"


def _certified(design: Part) -> str:
    if design.get("efficiency") is None:
        polished = design.get("polished") or {}
        if polished and polished.get("before") != polished.get("after"):
            return "of the choice before polishing: the bound is one of the grid"
        return "no bound is known" if design.get("bound") is None else ""
    return f"{words.certain(design['efficiency'])} of the best possible, at the least"


def _slack(gap: float) -> str:
    """How much of the distance to the bound may be the bound's own fault."""
    if not gap > 1e-9:
        return "none to speak of: weights on the candidates reach it"
    return f"it may be up to {words.percent(math.expm1(gap))} too high"


def _caption(design: Part) -> str:
    """Value and bound once more: what one compares first."""
    name, bound = str(design["criterion"]), design.get("bound")
    text = (
        f"The choice in numbers: by criterion {name} it reaches"
        f" {told(name, design['value'])}"
    )
    return (
        f"{text}."
        if bound is None
        else (
            f"{text}, and the best possible is no {_better(name)} than"
            f" {told(name, bound)}."
        )
    )


def _refused(design: Part) -> list[Block]:
    """Why candidates were left out, most refusals first."""
    refused = sorted(
        (design.get("refused") or {}).items(), key=lambda item: -words.number(item[1])
    )
    if not refused:
        return []
    if len(refused) == 1:
        ((reason, count),) = refused
        return [
            Paragraph(
                f"Left out before, because they {words.pretty(reason)}:"
                f" {words.count(count, 'candidate')}."
            )
        ]
    rows = [[str(count), words.pretty(reason)] for reason, count in refused]
    columns = [
        TableColumn("Candidates", number=True),
        TableColumn("which …", wide=True),
    ]
    most = f"Most, {refused[0][1]}, {words.pretty(refused[0][0])}."
    return [
        Table(
            columns,
            rows,
            "Candidates left out before the choice; one may have several reasons."
            f" {most}",
        )
    ]
