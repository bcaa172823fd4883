"""The numbers that matter, as sentences: what a person reads first."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from oed import result
from pkm_studies.stages.plan import summary

MOST = 5


def sentences(sections: Mapping[str, Any]) -> list[str]:
    """Up to five sentences out of the sections that are there, the most useful first; a
    diagnosis' own before them.
    """
    found: result.GapSection | None = sections.get("gap")
    told = [
        *summary.plan_sentences(sections.get("plan")),
        *_told_apart(sections.get("gap_before")),
        *_accuracy(sections.get("prediction")),
        *_held_out(sections.get("held_out") or []),
        *_rank(sections.get("identifiability")),
        *_gain(sections.get("design")),
        *_design(sections.get("design")),
        *_fit(sections.get("estimate")),
        *_posterior(sections.get("posterior")),
    ]
    return [*(found.words if found is not None else []), *told[:MOST]]


def _told_apart(found: result.GapBeforeSection | None) -> list[str]:
    """What the runs of [gap.design] tell apart."""
    return found.words[:1] if found is not None and found.chosen is not None else []


def predicted(sections: Mapping[str, Any]) -> dict[str, float]:
    """Predicted rms of each component after the plan, in its fine unit."""
    section: result.PredictionSection | None = sections.get("prediction")
    if section is None:
        return {}
    return {
        f"{n}_{section.unit[n]}": c.after.rms for n, c in section.components.items()
    }


def _accuracy(section: result.PredictionSection | None) -> list[str]:
    if section is None:
        return []
    parts = [
        f"{n} {number(c.before.rms)} to {number(c.after.rms)} {section.unit[n]}"
        for n, c in section.components.items()
        if c.compensatable
    ]
    against = {
        "home": "zeroed at home",
        "absolute": "in the base frame",
        "best_fit": "after best alignment",
    }
    how = (
        "rms over the workspace before to after compensation,"
        f" {against[section.reference]}"
    )
    return [f"Predicted residual accuracy, {how}: {'; '.join(parts)}."]


def _held_out(sections: list[result.HeldOutSection]) -> list[str]:
    if not sections:
        return []
    parts = [
        f"{s.name} {number(s.rms)} {s.unit} rms ({100 * s.coverage:.0f} % inside 95 %"
        " intervals)"
        for s in sections
    ]
    return [f"Readings kept out of the fit are predicted to {'; '.join(parts)}."]


def _rank(section: result.IdentifiabilitySection | None) -> list[str]:
    if section is None:
        return []
    lost = section.n - section.rank
    told = f"The readings determine {section.rank} of {section.n} parameters"
    if not lost:
        return [told + "."]
    plural = "s are" if lost > 1 else " is"
    return [
        f"{told}; {lost} direction{plural} lost, see the identifiability section for"
        " what would bring them back."
    ]


def _design(section: result.DesignSection | None) -> list[str]:
    if section is None:
        return []
    d = section.criterion == "D"
    told = f"The {section.criterion}-optimal {section.n} readings reach "
    told += (
        f"log det {section.plans[0].logdet:.2f}"
        if d
        else f"{section.criterion} = {number(section.value)}"
    )
    reached = [f"{p.logdet:.2f}" if d else number(p.value) for p in section.plans]
    others = [
        f"{value} for {p.name} ({100 * p.efficiency:.0f} %"
        f" {section.criterion}-efficiency)"
        for p, value in zip(section.plans[1:], reached[1:], strict=True)
    ]
    if section.proven:
        told += " (proven optimal)"
    elif section.efficiency is not None:
        told += f" (certified to {percent(section.efficiency)} % of the best possible)"
    against = f", against {'; '.join(others)}" if others else ""
    return [
        f"{told}{against}; condition number {number(section.kappa)} ({section.scaling}"
        " scaling)."
    ]


def _gain(section: result.DesignSection | None) -> list[str]:
    """How much more accurate the machine becomes than with the first reference plan."""
    if section is None or len(section.plans) < 2 or not section.plans[0].gain:
        return []
    gain, first = section.plans[0].gain.values(), section.plans[1]
    reading = f"{section.n} readings in {', '.join(section.setups)}"
    return [
        f"With the {reading}, the pose is {min(gain):.2g} to {max(gain):.2g} times as"
        f" accurate as with {first.name}."
    ]


def _fit(section: result.EstimateSection | None) -> list[str]:
    if section is None:
        return []
    parts = [
        f"{n} {number(section.rms_before[n])} to {number(v)} {section.units[n]}"
        for n, v in section.rms_after.items()
    ]
    return [
        f"The fit of {section.readings} readings brings their rms residual from"
        f" {'; '.join(parts)}."
    ]


def _posterior(section: result.PosteriorSection | None) -> list[str]:
    if section is None:
        return []
    marginals = section.marginals.values()
    sizes = _finite([m.ess for m in marginals])
    ratios = _finite([m.rhat for m in marginals])
    if not sizes or not ratios:
        return []
    least, worst = min(sizes), max(ratios)
    draws = section.draws
    return [
        f"The posterior has {draws} draws: effective sample size {least:.0f} or more,"
        f" R-hat {worst:.3f} or less."
    ]


def _finite(values: Iterable[float | None]) -> list[float]:
    """The finite ones; a parameter that is not sampled has no R-hat."""
    return [v for v in values if v is not None and math.isfinite(v)]


def number(value: float) -> str:
    """Three significant digits, without an exponent in the usual range."""
    return f"{value:.0f}" if 1000 <= abs(value) < 1e6 else f"{value:.3g}"


def percent(share: float) -> str:
    """A share in percent with one digit, never rounded up: 99.96 % is not all."""
    return f"{math.floor(1000 * share * (1 + 1e-12)) / 10:.1f}"
