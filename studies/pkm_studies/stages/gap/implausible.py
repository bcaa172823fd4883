"""States in sentences which coefficients are far beyond their expected sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from oed import units
from oed.effect_model import IMPLAUSIBLE
from oed.result import CoefficientRecord
from oed.text import rounded

#: ppm from which a ratio is stated in percent
PERCENT = 1e4


def sentences(
    coefficients: Iterable[CoefficientRecord], checks: Mapping[str, str]
) -> list[str]:
    """One sentence for each effect with an implausible coefficient, the farthest off.

    checks  {effect: what to check then; "" for nothing in particular}
    """
    worst: dict[str, tuple[CoefficientRecord, float]] = {}
    for c in coefficients:
        if c.shape or not c.prior_sd:
            continue
        size = abs(c.value)
        largest, scale = worst.get(c.effect, (None, c.prior_sd))
        most = IMPLAUSIBLE if largest is None else abs(largest.value) / scale
        if size / c.prior_sd > most:
            worst[c.effect] = c, c.prior_sd
    return [_sentence(c, sd, checks.get(c.effect, "")) for c, sd in worst.values()]


def _sentence(c: CoefficientRecord, expected: float, check: str) -> str:
    ratio = abs(c.value) / expected
    effect = c.effect.replace("_", " ")
    advice = f"check {check}"
    if not check:
        advice = (
            f"another cause may look like it. Check {effect} at the machine, or state"
            " its expected size in [effects]"
        )
    return (
        f"{effect[:1].upper()}{effect[1:]}: {c.name} is {_quantity(c.value, c.unit)} (sd"
        f" {_quantity(c.sd, c.unit)}), {rounded(ratio)} times the"
        f" {_quantity(expected, c.unit)} expected. That is implausible: {advice}."
    )


def _quantity(value: float, unit: str) -> str:
    """A coefficient in a unit that a person reads."""
    name, factor = units.coefficient_unit(unit)
    amount = value / factor
    if name == "ppm" and abs(amount) >= PERCENT:
        return f"{rounded(amount / PERCENT, 3)} %"
    return f"{rounded(amount, 3)} {name}"
