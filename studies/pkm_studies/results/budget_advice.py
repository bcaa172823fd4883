"""What an uncertainty budget says, in sentences: what to improve, what the model lacks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from oed.result import BudgetLine, BudgetSection

#: share of the error below which an improvement is not worth a sentence
WORTH = 0.02
#: sentences on what to improve
MOST_ADVICE = 2
#: improvements in words, by kind of line
IMPROVEMENTS = {
    "prior": "half the tolerances of the machine's parameters",
    "interpolation": "a fine enough table",
    "rounding": "half the step of the printed digits, and of what the model misses,",
    "left out": "a file that holds the effects",
}

#: rms errors by component, in its fine unit
Values = Mapping[str, float]


def unmodelled_sentence(
    section: BudgetSection, after: Values, driven: Mapping[str, str]
) -> str | None:
    """What the effect that adds most does to the accuracy, and the remedy.

    after   rms error of each component with geometry alone
    driven  {component: unit} of those that the controller corrects
    """
    if not section.unmodelled:
        return None
    worst = section.unmodelled[0]
    geometry = error_quantities(after, driven)
    opening = f"This is geometry alone ({geometry})."
    effect = f"{worst.effect} of its expected size ({worst.expected})"
    usual = section.usual
    if usual is None or len(usual.effects) == 1:
        whole = error_quantities(worst.with_it, driven)
        added = f"{effect} would bring {whole}, as calibration takes a part of it for"
        cause = "geometry"
    else:
        whole = error_quantities(usual.unmodelled, driven)
        added = f"All {len(usual.effects)} usual effects would bring {whole}, as"
        cause = f"calibration takes a part of them for geometry; most is {effect}"
    corrected = ""
    if usual is not None:
        corrected = (
            ". Fitted with the geometry and corrected they would leave"
            f" {error_quantities(usual.fitted, driven)}"
        )
    return (
        f"{opening} {added} {cause}{corrected}. Sizes vary by decades. Remedy:"
        f" {worst.remedy}."
    )


def advice_on(
    lines: Sequence[BudgetLine], predicted: Values, components: Mapping[str, str]
) -> list[str]:
    """The improvements of components {name: unit} that bring most, in sentences."""
    sentences = []
    best = improvements(lines, predicted, components)
    for number, (improvement, after) in enumerate(best):
        order = "Improve first" if number == 0 else "Then"
        sentences.append(
            f"{order}: {improvement} brings {error_quantities(after, components)} instead of"
            f" {error_quantities(predicted, components)}."
        )
    return sentences


def improvements(
    lines: Sequence[BudgetLine], predicted: Values, components: Mapping[str, str]
) -> list[tuple[str, Values]]:
    """The improvements of components {name: unit} that bring most, and what each brings.

    In words, the best first.
    """
    ranked: list[tuple[float, str, Values]] = []
    for line in lines:
        better = line.halved or line.without
        if better is not None:
            gain = error_ratio(better, predicted, components)
            ranked.append((gain, _improvement(line), better))
    ranked.sort(key=lambda entry: entry[0])
    best: dict[str, Values] = {}
    for gain, improvement, after in ranked:
        if gain < 1.0 - WORTH:
            best.setdefault(improvement, after)  # several lines may have the same one
    return [*best.items()][:MOST_ADVICE]


def error_ratio(changed: Values, whole: Values, components: Mapping[str, str]) -> float:
    """Geometric mean of changed over whole errors of some components."""
    logs = [
        math.log(changed[name] / whole[name])
        for name in components
        if whole[name] > 0.0 and changed[name] > 0.0
    ]
    return math.exp(sum(logs) / len(logs)) if logs else 1.0


def _improvement(line: BudgetLine) -> str:
    """An improvement in words."""
    if line.kind in IMPROVEMENTS:
        return IMPROVEMENTS[line.kind]
    if line.halved is None:
        return "a known set-up" if line.kind == "set-up" else f"known {line.source}"
    return f"half the {line.source}"


def error_quantities(values: Values, components: Mapping[str, str]) -> str:
    """Values of components {name: unit} in words."""
    parts = [f"{name} {values[name]:.3g} {unit}" for name, unit in components.items()]
    return ", ".join(parts)
