"""Least squares with tolerance priors: how well it fits, what it found, what is left."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from pkm_reports import style, words
from pkm_reports.blocks import (
    Block,
    Notice,
    Paragraph,
    Picture,
    Table,
    TableColumn,
    absent,
    number_column,
)
from pkm_reports.figures import parameters, residuals

ANCHOR: Final = "identification"
TITLE: Final = "Identification"
Part = Mapping[str, Any]


def blocks(result: Part) -> list[Block]:
    """Fit, residuals, parameters as figure and table, iterations."""
    estimate = result.get("estimate")
    if not estimate:
        return absent("Identification")
    values = estimate.get("parameters") or {}
    made: list[Block] = [Paragraph(_fit(estimate))]
    made += [Notice(words.sentence(text)) for text in estimate.get("warnings") or []]
    made.append(Picture("residuals", lambda: residuals.draw(estimate), _left(estimate)))
    if values:
        # The table first: it breaks over pages, so the tall picture leaves no gap
        # before it.
        made += [
            _table(values),
            Picture("parameters", lambda: parameters.draw(values), _found(values)),
        ]
    return made + _iterations(estimate.get("iterations") or [])


def _fit(estimate: Part) -> str:
    units = estimate["units"]
    after = estimate["rms_after"]
    parts = [
        f"{name} from {words.quantity(before, units[name])} to"
        f" {words.quantity(after.get(name), units[name])}"
        for name, before in (estimate.get("rms_before") or {}).items()
    ]
    text = f"{words.count(estimate['readings'], 'reading')} were fitted. "
    text += f"The rms residual falls for {words.listing(parts)}. " if parts else ""
    chi2, dof = words.number(estimate["chi2"]), words.number(estimate["dof"])
    text += f"χ² is {words.num(chi2)} for {words.num(dof)} degrees of freedom"
    return f"{text}{_judged(chi2, dof)}."


def _judged(chi2: float, dof: float) -> str:
    """Whether chi-square agrees with the stated noise, by its normal approximation."""
    if not dof > 0.0:
        return ""
    z = (chi2 - dof) / np.sqrt(2.0 * dof)
    if z > 3.0:
        return (
            ": far more than the stated noise explains, so the model lacks something or"
            " the noise is larger"
        )
    return (
        ": less than the stated noise would leave, so the noise is overstated"
        if z < -3.0
        else ": as the noise predicts"
    )


def _left(estimate: Part) -> str:
    after = style.array(estimate.get("residuals") or [])
    text = (
        "Residual of each reading with nominal and with identified parameters; the"
        " scales differ."
    )
    if not np.isfinite(after).any():
        return text
    worst = int(np.nanargmax(np.abs(after))) + 1
    unit = estimate["units"][estimate["channels"][worst - 1]]
    if len(set(estimate["units"].values())) > 1:
        return text
    return (
        f"{text} The largest left is {words.quantity(np.nanmax(np.abs(after)), unit)}"
        f" at reading {worst}."
    )


def _found(values: Mapping[str, Part]) -> str:
    """Caption of the interval plot: how many are seen, how the truth fared."""
    kinds = [str(v.get("identified")) for v in values.values()]
    text = (
        f"Each parameter against its tolerance. {kinds.count('seen')} of {len(kinds)}"
        f" are seen, {kinds.count('weak')} only weakly, {kinds.count('prior')} stay as"
        " uncertain as the tolerance."
    )
    best = min(values, key=lambda name: parameters.normalised(values[name])[1])
    text += (
        f" Tightened most: {best}, to"
        f" {words.percent(parameters.normalised(values[best])[1])} of its tolerance."
    )
    pulls = [pull for pull in map(_pull, values.values()) if np.isfinite(pull)]
    if pulls:
        inside = sum(abs(p) <= 1.96 for p in pulls)
        text += (
            f" {inside} of {len(pulls)} intervals hold the truth (crosses); about"
            f" {round(0.95 * len(pulls))} should."
        )
    return text


def _pull(value: Part) -> float:
    """(value - truth) / sd."""
    sd = words.number(value["sd"])
    return (
        (words.number(value["value"]) - words.number(value.get("truth"))) / sd
        if sd > 0.0
        else float("nan")
    )


def _table(values: Mapping[str, Part]) -> Table:
    rows = [_row(name, v) for name, v in values.items()]
    columns = [
        TableColumn("Parameter"),
        *number_column("Value", "sd", "Nominal", "Tolerance"),
        TableColumn("Unit"),
        TableColumn("Verdict"),
    ]
    known = any(v.get("truth") is not None for v in values.values())
    if known:
        columns += number_column("Truth", "Pull")
    rows = rows if known else [row[:7] for row in rows]
    weak = {"weak": "chosen", "prior": "bad"}
    caption = (
        "Identified parameters with standard deviations; the tolerance is the standard"
        " deviation before any reading."
    )
    caption += " Pull: (value − truth) / sd." if known else ""
    return Table(
        columns,
        rows,
        caption,
        [weak.get(str(v.get("identified")), "") for v in values.values()],
    )


def _row(name: str, v: Part) -> list[str]:
    decimals = words.decimals_of(v["sd"])
    verdict = parameters.MEANING.get(str(v.get("identified")), str(v.get("identified")))
    return [
        name,
        words.fixed(v["value"], decimals),
        words.fixed(v["sd"], decimals),
        words.plain(v["nominal"], 7),
        words.plain(v["prior_sd"], 3),
        words.unit(str(v["unit"])),
        verdict,
        words.fixed(v.get("truth"), decimals),
        words.fixed(_pull(v), 1),
    ]


def _iterations(rows: list[Mapping[str, float]]) -> list[Block]:
    if not rows:
        return []
    keys = list(dict.fromkeys(key for row in rows for key in row))
    cells = [[words.plain(row.get(key), 4) for key in keys] for row in rows]
    titles = [words.heading(key) for key in keys]
    return [Table(number_column(*titles), cells, "The fit, stage by stage.")]
