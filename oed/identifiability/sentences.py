"""Identifiability in sentences: what is determined, what only in combination, what not.

Each sentence is an `IdentifiabilityFinding`. Directions that no reading determines come
with remedies, whose effect `oed.identifiability.assessment` computes.
"""

import re
from collections.abc import Mapping

import numpy as np

from oed import text, units
from oed.base import Array, Index
from oed.identifiability import identifiability
from oed.identifiability.assessment import Assessment, Readings, recoveries
from oed.result import IdentifiabilityFinding

#: posterior over prior standard deviation above which a parameter counts as weak
WEAK_SHRINKAGE = 0.7
MAX_TERMS = 8  #: number of parameters that the sentence on a lost direction names
MIN_SHARE = 0.05  #: their least share of the largest one


def explain(
    assessment: Assessment, alternatives: Mapping[str, Readings] | None = None
) -> list[IdentifiabilityFinding]:
    """An assessment in sentences, with `alternatives` by name as remedies."""
    findings = [
        *_one_by_one(assessment),
        _weak_common_errors(assessment),
        _combinations(assessment),
        _lost(assessment, alternatives or {}),
    ]
    return [finding for finding in findings if finding is not None]


def combination_text(terms: Mapping[str, float], unit: Mapping[str, str]) -> str:
    """One linear combination as text, such as `beta1 + 0.279 rad/m z1`, pivot first.

    terms  coefficient by parameter, SI; the pivot's is 1
    unit   SI unit by parameter
    """
    pivot = _pivot(terms)
    parts = [pivot]
    for name, coefficient in terms.items():
        if name == pivot:
            continue
        sign = "-" if coefficient < 0 else "+"
        size = abs(coefficient)
        factor = "" if abs(size - 1.0) < 5e-4 else f"{size:.3g} "
        parts.append(f"{sign} {factor}{_ratio(unit[pivot], unit[name])}{name}")
    return " ".join(parts)


def _pivot(terms: Mapping[str, float]) -> str:
    """The last parameter with coefficient 1; the first one where there is none."""
    for name in reversed(list(terms)):
        if abs(terms[name] - 1.0) < 1e-9:
            return name
    return next(iter(terms))


def _ratio(pivot_unit: str, unit: str) -> str:
    """Unit of a coefficient, with a space; empty for equal units and for ratios."""
    if pivot_unit == unit or "1" in (pivot_unit, unit):
        return ""
    return f"{pivot_unit}/{unit} "


def _one_by_one(assessment: Assessment) -> list[IdentifiabilityFinding]:
    """Parameters that no null direction moves, those near their tolerance by themselves."""
    null_space = assessment.identifiability.null_space
    by_itself = np.asarray(np.sum(null_space**2, axis=0) < 1e-12)
    is_weak = assessment.shrinkage > WEAK_SHRINKAGE
    strong = np.flatnonzero(by_itself & ~is_weak)
    weak = np.flatnonzero(by_itself & is_weak)
    first = "weak", "The readings determine no parameter by itself."
    if strong.size:
        first = (
            "seen",
            "Determined one by one, with the standard deviation before and after the"
            f" readings: {_shrinkages(assessment, strong)}.",
        )
    findings = [IdentifiabilityFinding(*first)]
    if weak.size:
        sentence = (
            "Determined in principle, but in practice these stay near their tolerance:"
            f" {_shrinkages(assessment, weak)}."
        )
        findings.append(IdentifiabilityFinding("weak", sentence))
    return findings


def _shrinkages(assessment: Assessment, indices: Index) -> str:
    """Parameters with their standard deviation before and after, as a list in words."""
    parameters = {p.name: p for p in assessment.measurement.parameters}
    phrases = []
    for k in indices:
        parameter = parameters[assessment.names[k]]
        unit = units.display(parameter.unit)
        before = units.number(parameter.tolerance, unit)
        after = f"{before * assessment.shrinkage[k]:.2g}{_suffix(unit)}"
        phrases.append(f"{parameter.name} ({before:.3g} before, {after} after)")
    return ", ".join(phrases)


def _weak_common_errors(assessment: Assessment) -> IdentifiabilityFinding | None:
    """Kinds of machine parameters whose common error the readings hardly reduce."""
    phrases = []
    for kind, members in _machine_parameters_by_kind(assessment.names).items():
        if len(members) < 2:
            continue
        common = np.zeros(len(assessment.names))
        common[members] = 1.0 / np.sqrt(len(members))
        share = float(np.sqrt(common @ assessment.covariance @ common))
        if share > WEAK_SHRINKAGE:
            names = ", ".join(assessment.names[k] for k in members)
            phrases.append(
                f"the common {kind} ({names}) keeps {text.percent(share)} of its tolerance"
            )
    if not phrases:
        return None
    return IdentifiabilityFinding(
        "weak",
        f"Not identifiable in practice from these readings: {'; '.join(phrases)}.",
    )


def _machine_parameters_by_kind(names: tuple[str, ...]) -> dict[str, list[int]]:
    """Indices of the machine's parameters by kind: the name without its digits."""
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        if "." not in name:
            kinds.setdefault(re.sub(r"\d", "", name), []).append(k)
    return kinds


def _combinations(assessment: Assessment) -> IdentifiabilityFinding | None:
    identified = assessment.identifiability
    unit = {p.name: p.unit for p in assessment.measurement.parameters}
    phrases = []
    for terms in identified.coefficients_by_name(identified.combinations):
        if len(terms) > 1:
            phrases.append(combination_text(terms, unit))
    if not phrases:
        return None
    return IdentifiabilityFinding(
        "combination",
        f"Determined only in combination ({len(phrases)}): {'; '.join(phrases)}.",
    )


def _lost(
    assessment: Assessment, alternatives: Mapping[str, Readings]
) -> IdentifiabilityFinding | None:
    identified = assessment.identifiability
    count = len(identified.names) - identified.rank
    if not count:
        return IdentifiabilityFinding(
            "seen", "The readings determine every free parameter."
        )
    machine = assessment.measurement.machine
    motions, remainder = identifiability.lost_motions(
        identified, machine, assessment.scale
    )
    directions = [f"the {motion}" for motion in motions]
    for row in identifiability.echelon(remainder):
        directions.append(_direction(assessment, row))
    plural = "s" if count > 1 else ""
    sentence = (
        f"Lost, {count} direction{plural} of {len(identified.names)}:"
        f" {'; '.join(directions)}. No reading changes when the parameters move along"
        " these."
    )
    trials = recoveries(assessment, alternatives)
    return IdentifiabilityFinding("lost", sentence, tuple(trials))


def _direction(assessment: Assessment, row: Array) -> str:
    """A null direction (n,) as relative changes of its largest parameters."""
    parameters = {p.name: p for p in assessment.measurement.parameters}
    shown = [units.display(parameters[name].unit) for name in assessment.names]
    moves = [
        units.number(move, unit)
        for move, unit in zip(row * assessment.scale, shown, strict=True)
    ]
    # rounded, so that equal entries keep the parameters' order
    size = np.round(np.abs(row) / np.abs(row).max(), 9)
    change = np.array(moves) / moves[np.argmax(size)]
    by_size = np.argsort(-size, kind="stable")
    order = [k for k in by_size if size[k] > MIN_SHARE]
    phrases = [
        f"{assessment.names[k]} by {change[k]:+.3g}{_suffix(shown[k])}"
        for k in order[:MAX_TERMS]
    ]
    more = " and more" if len(order) > MAX_TERMS else ""
    return f"moving {', '.join(phrases)}{more}"


def _suffix(unit: str) -> str:
    """A unit after a number, with its space; nothing for a ratio."""
    return "" if unit == "1" else f" {unit}"
