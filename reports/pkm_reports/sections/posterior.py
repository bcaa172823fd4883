"""The posterior by sampling: worst directions, marginals, and whether the sampler can
be trusted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from pkm_reports import words
from pkm_reports.blocks import (
    Block,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    absent,
    number_column,
    transposed,
)
from pkm_reports.figures import corner

ANCHOR: Final = "posterior"
TITLE: Final = "Posterior"
Part = Mapping[str, Any]
LARGEST_RHAT: Final = 1.01
SMALLEST_ESS: Final = 1000.0


def blocks(result: Part) -> list[Block]:
    """Sampler, corner plot, directions, marginals."""
    part = result.get("posterior")
    if not part:
        return absent("Sampling the posterior")
    made: list[Block] = [
        Paragraph(_sampler(part)),
        *_doubts(part.get("marginals") or {}),
    ]
    made.append(Picture("corner", lambda: corner.draw(part), _caption(part)))
    return made + _directions(part) + _marginals(part.get("marginals") or {})


def _sampler(part: Part) -> str:
    return (
        f"{words.num(part['draws'])} draws were kept from"
        f" {words.count(part['walkers'], 'walker')};"
        f" {words.percent(part['acceptance'])} of the moves were accepted, and the"
        f" autocorrelation time is {words.num(part['autocorrelation'])} steps. All"
        " draws are in posterior.nc."
    )


def _doubts(marginals: Mapping[str, Part]) -> list[Block]:
    """A notice where a marginal is not well sampled, one sentence where all are; held
    parameters are not sampled.
    """
    sampled = {
        name: m for name, m in marginals.items() if np.isfinite(words.number(m["rhat"]))
    }
    if not sampled:
        return []
    rhat, ess = (
        max(m["rhat"] for m in sampled.values()),
        min(words.number(m["ess"]) for m in sampled.values()),
    )
    told = (
        f"R-hat is at most {words.fixed(rhat, 3)}, and at least {words.fixed(ess, 0)}"
        " draws are effective"
    )
    bad = [
        n
        for n, m in sampled.items()
        if m["rhat"] > LARGEST_RHAT or not words.number(m["ess"]) >= SMALLEST_ESS
    ]
    if not bad:
        return [Paragraph(f"Every marginal is well sampled: {told}.")]
    wanted = f"wanted: {LARGEST_RHAT} at most, {SMALLEST_ESS:.0f} at least"
    return [
        Notice(
            f"The sampler has not fully mixed: {told} ({wanted}). Concerned:"
            f" {words.listing(bad, 8)}."
        )
    ]


def _caption(part: Part) -> str:
    names, draws = corner.shown(part)
    text = (
        "Posterior of the worst-seen directions in prior standard deviations: below the"
        " diagonal the draws of each pair (dashed, where it fits: the prior's 1-sigma"
        " circle), on it the histogram, with the prior in grey."
    )
    if not names:
        return text
    sds = np.std(draws, axis=0)
    told = [
        f"{name} {words.num(sd, 2)}"
        for name, sd in zip(corner.short(names), sds, strict=True)
    ]
    wide = int(np.sum(sds > 0.7))
    verdict = {0: "All are clearly tightened by the readings."}.get(
        wide,
        f"{wide} of {len(names)} stay nearly as wide as the prior: the readings say"
        " little about them.",
    )
    return f"{text} Standard deviations: {words.listing(told)}. {verdict}"


def _directions(part: Part) -> list[Block]:
    """What d1, d2, ... stand for, where the names are too long for the axes."""
    names, draws = corner.shown(part)
    short = corner.short(names)
    if not names or short == names:
        return []
    columns = [
        TableColumn("Label"),
        TableColumn("Direction", wide=True),
        *number_column("Mean", "sd"),
    ]
    spread = [words.fixed(x, 2) for x in np.std(draws, axis=0)]
    rows = transposed(
        [short, names, [words.fixed(x, 2) for x in np.mean(draws, axis=0)], spread]
    )
    return [
        Table(
            columns,
            rows,
            "Directions of the corner plot, in prior standard deviations (1 means:"
            " nothing learnt).",
        )
    ]


def _marginals(marginals: Mapping[str, Part]) -> list[Block]:
    if not marginals:
        return []
    rows = []
    for name, m in marginals.items():
        decimals = words.decimals_of(m["sd"])
        numbers = [
            words.fixed(m[key], decimals) for key in ("mean", "sd", "q025", "q975")
        ]
        ess = words.fixed(m["ess"], 0)
        rows.append(
            [name, *numbers, words.unit(str(m["unit"])), words.fixed(m["rhat"], 3), ess]
        )
    columns = [
        TableColumn("Parameter"),
        *number_column("Mean", "sd", "2.5 %", "97.5 %"),
        TableColumn("Unit"),
    ]
    columns += number_column("R-hat", "ESS")
    return [
        Table(
            columns,
            rows,
            "Marginals of the posterior with sampler diagnostics (ESS: effective sample"
            " size).",
        )
    ]
