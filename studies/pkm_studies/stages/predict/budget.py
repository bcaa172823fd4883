"""Reports the uncertainty budget, and what to improve first: `prediction.budget`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.accuracy import Budget, Prediction
from oed.base import Array
from oed.effect_model import EFFECT_SIZES
from oed.effects import ExpectedEffect, ExpectedEffects
from oed.model import Machine
from oed.result import BudgetLine, BudgetSection, UnmodelledLine, UsualEffects
from pkm_studies.results import Values, advice_on, error_ratio

#: largest usual size of an effect that the model lacks, in expected sizes
FAR = EFFECT_SIZES.usual[-1]


def budget_section(
    machine: Machine,
    prediction: Prediction,
    budget: Budget,
    expected: ExpectedEffects | None = None,
) -> BudgetSection:
    """The budget in the components' fine units, with effects that are not modelled."""
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    driven = {c.name: fine[c.name] for c in machine.components if c.compensatable}
    lines = [_line(budget, k, fine) for k in range(len(budget.lines))]
    predicted = _displayed_shares(budget.names, np.sqrt(budget.variance), fine)
    after = np.array([prediction.after[name].rms for name in budget.names])
    effects = [] if expected is None else expected.effects
    unmodelled = [_unmodelled(effect, budget.names, after, fine) for effect in effects]
    geometry = _displayed_shares(budget.names, after, fine)
    unmodelled.sort(key=lambda line: -error_ratio(line.with_it, geometry, driven))
    return BudgetSection(
        predicted=dict(predicted),
        lines=lines,
        unmodelled=unmodelled,
        usual=_usual(expected, budget.names, after, driven or fine),
        advice=advice_on(lines, predicted, driven or fine),
        no_axes={n: v for n, v in geometry.items() if n not in driven},
    )


def _displayed_shares(
    names: Sequence[str], values: Array, fine: Mapping[str, str]
) -> Values:
    pairs = zip(names, values, strict=True)
    return {name: units.number(value, fine[name]) for name, value in pairs}


def _line(budget: Budget, number: int, fine: Mapping[str, str]) -> BudgetLine:
    names, line = budget.names, budget.lines[number]
    share = np.zeros_like(budget.variance)
    np.divide(line.variance, budget.variance, out=share, where=budget.variance > 0.0)
    size = np.sign(line.variance) * np.sqrt(np.abs(line.variance))
    without, halved = (
        None if values is None else dict(_displayed_shares(names, values, fine))
        for values in (line.without, line.halved)
    )
    return BudgetLine(
        source=line.source,
        kind=line.kind,
        share=dict(zip(names, share.tolist(), strict=True)),
        size=dict(_displayed_shares(names, size, fine)),
        without=without,
        halved=halved,
    )


def _unmodelled(
    expected: ExpectedEffect,
    names: Sequence[str],
    after: Array,
    fine: Mapping[str, str],
) -> UnmodelledLine:
    variance = expected.variance.mean(axis=0)
    effect = expected.effect
    return UnmodelledLine(
        effect=effect.name,
        about=effect.about,
        expected=_expected_size(expected),
        size=dict(_displayed_shares(names, np.sqrt(variance), fine)),
        with_it=dict(_displayed_shares(names, np.sqrt(after**2 + variance), fine)),
        remedy=effect.remedy,
        not_testable=expected.not_testable,
        far=dict(_displayed_shares(names, np.sqrt(after**2 + FAR**2 * variance), fine)),
    )


def _usual(
    expected: ExpectedEffects | None,
    names: Sequence[str],
    after: Array,
    shown: Mapping[str, str],
) -> UsualEffects | None:
    """The machine with all effects; None where none are expected.

    shown  {component: fine unit} of those that compensation corrects
    """
    if expected is None:
        return None
    added = expected.added.mean(axis=0)
    fitted = expected.fitted.mean(axis=0)
    return UsualEffects(
        effects=[effect.effect.name for effect in expected.effects],
        unmodelled=_shown_shares(names, np.sqrt(after**2 + added), shown),
        fitted=_shown_shares(names, np.sqrt(fitted), shown),
    )


def _shown_shares(
    names: Sequence[str], values: Array, shown: Mapping[str, str]
) -> dict[str, float]:
    pairs = dict(zip(names, values, strict=True))
    return {name: units.number(pairs[name], unit) for name, unit in shown.items()}


def _expected_size(expected: ExpectedEffect) -> str:
    """Prior standard deviations of the coefficients: `3 C`, or the range of several."""
    sizes: dict[str, list[float]] = {}
    for name, scale in expected.sizes.items():
        unit, factor = units.coefficient_unit(expected.effect.unit(name))
        sizes.setdefault(unit, []).append(scale / factor)
    parts = []
    for unit, values in sizes.items():
        low, high = f"{min(values):.3g}", f"{max(values):.3g}"
        span = low if low == high else f"{low} to {high}"
        parts.append(f"{span} {unit}")
    return ", ".join(parts)
