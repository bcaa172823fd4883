"""The usual mistakes of a session, each undone in turn.

A mistake gives variants: sessions as they would be without it. One that fits the model
within tolerances and noise, where the readings as given do not, explains them.

variant     a session with one mistake undone, or undone by an unknown amount
unit        readings in another unit
deviation   deviations in place of readings, or the reverse
sign        readings with the sign reversed
columns     columns of readings exchanged
order       readings in another order
setups      readings of another set-up
pose        commanded poses with wrong signs, columns or offsets
amounts     other bar length or other tool, an offset of one run
"""

from __future__ import annotations

from collections.abc import Iterator

from oed.checks.mistakes import (
    amounts,
    columns,
    deviation,
    order,
    pose,
    setups,
    sign,
    unit,
)
from oed.checks.mistakes.variant import Alternatives, Variant, VariantOfAmount
from oed.checks.session import SessionReadings

__all__ = [
    "Alternatives",
    "Variant",
    "VariantOfAmount",
    "variants",
    "variants_of_amount",
]

_MISTAKES = (unit, deviation, sign, columns, order, setups, pose)


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Every variant of a session without an unknown amount."""
    for mistake in _MISTAKES:
        yield from mistake.variants(session, alternatives)


def variants_of_amount(session: SessionReadings) -> Iterator[VariantOfAmount]:
    """Every variant of a session with an unknown amount."""
    yield from amounts.variants(session)
