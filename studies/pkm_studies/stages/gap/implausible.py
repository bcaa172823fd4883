"""States in sentences which coefficients are far beyond their expected sizes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from oed.base import units
from oed.model.expected_size import IMPLAUSIBLE
from oed.result.gap import CoefficientRecord

#: ppm from which a ratio is stated in percent
PERCENT = 1e4


def sentences(
    coefficients: Iterable[CoefficientRecord], checks: Mapping[str, str]
) -> list[str]:
    """One sentence for each effect with an implausible coefficient, the farthest off.

    checks  {effect: what to check then; "" for nothing in particular}
    """
    worst: dict[str, tuple[float, CoefficientRecord]] = {}
    for c in coefficients:
        ratio = 0.0 if not c.prior_sd else abs(c.value) / c.prior_sd
        known = worst.get(c.effect)
        if not c.shape and ratio > (known[0] if known else IMPLAUSIBLE):
            worst[c.effect] = ratio, c
    return [
        _sentence(ratio, c, checks.get(c.effect, "")) for ratio, c in worst.values()
    ]


def _sentence(ratio: float, c: CoefficientRecord, check: str) -> str:
    assert c.prior_sd is not None
    effect = c.effect.replace("_", " ")
    advice = f"check {check}"
    if not check:
        advice = (
            f"another cause may look like it. Check {effect} at the machine, or state"
            " its expected size in [effects]"
        )
    return (
        f"{effect[:1].upper()}{effect[1:]}: {c.name} is {_quantity(c.value, c.unit)} (sd"
        f" {_quantity(c.sd, c.unit)}), {_rounded(ratio)} times the"
        f" {_quantity(c.prior_sd, c.unit)} expected. That is implausible: {advice}."
    )


def _rounded(ratio: float) -> str:
    """Two digits, without an exponent: 1200."""
    return f"{float(f'{ratio:.2g}'):g}"


def _quantity(value: float, unit: str) -> str:
    """A coefficient in a unit that a person reads."""
    name, factor = units.coefficient_unit(unit)
    amount = value / factor
    if name == "ppm" and abs(amount) >= PERCENT:
        return f"{amount / PERCENT:.3g} %"
    return f"{amount:.3g} {name}"
