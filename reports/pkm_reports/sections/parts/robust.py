"""The plan that is good on many machines and set-ups, against the one made for the
nominal machine.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Final

from pkm_reports import words
from pkm_reports.blocks import Block, Paragraph, Picture
from pkm_reports.figures import robust

RISKS: Final = {"mean": "the mean over all", "worst": "the worst"}


def blocks(design: Mapping[str, Any]) -> list[Block]:
    """A sentence, and the scenarios of both plans."""
    part = design.get("robust")
    if not part:
        return []
    caption = _caption(part)
    return [
        Paragraph(_sentence(part)),
        Picture("robust", lambda: robust.draw(part), caption),
    ]


def _sentence(part: Mapping[str, Any]) -> str:
    count = part.get("scenarios") or len(part.get("values") or [])
    text = (
        f"The plan was made robust: judged by {_risk(part)} of"
        f" {words.count(count, 'scenario')}, machines and set-ups drawn within what is"
        " known of them beforehand"
    )
    gain = words.number(part.get("value")) - words.number(part.get("nominal"))
    if math.isfinite(gain):
        text += (
            f". By that risk it is worth {words.factor(math.exp(gain))} the plan made"
            " for the nominal machine"
        )
    if part.get("efficiency") is not None:
        text += (
            f", and is certified to {words.certain(part['efficiency'])} of the best"
            " possible"
        )
    return f"{text}."


def _risk(part: Mapping[str, Any]) -> str:
    risk = str(part.get("risk") or "mean")
    if risk == "cvar":
        return f"the mean of the worst {words.percent(part.get('level'))}"
    return RISKS.get(risk, risk)


def _caption(part: Mapping[str, Any]) -> str:
    """In how many scenarios each plan is ahead."""
    text = (
        "Worth of the robust and of the nominal plan in each scenario, exp(value −"
        " largest value of all), worst first; dashed: by the risk asked for. Right is"
        " better."
    )
    pairs = list(
        zip(part.get("values") or [], part.get("nominal_values") or [], strict=False)
    )
    known = [(words.number(a), words.number(b)) for a, b in pairs]
    ahead = sum(a > b for a, b in known)
    return (
        f"{text} The robust plan is ahead in {ahead} of {len(known)}."
        if known
        else text
    )
