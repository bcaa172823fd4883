"""Names of effects, lists and probabilities in words."""

from __future__ import annotations

from collections.abc import Sequence

from oed.gap.data.diagnosis import UNKNOWN


def plain_name(effect: str) -> str:
    """An effect's name as a person says it: `leg_thermal` -> leg thermal."""
    return (
        "an effect of unknown form" if effect == UNKNOWN else effect.replace("_", " ")
    )


def capitalised(text: str) -> str:
    """The text with a capital first letter."""
    return text[:1].upper() + text[1:]


def join_words(names: Sequence[str], last: str = "and") -> str:
    """a, b and c."""
    if len(names) < 2:
        return "".join(names)
    return f"{', '.join(names[:-1])} {last} {names[-1]}"


def format_probability(p: float) -> str:
    """A probability in percent; 100 % and 0 % only where they are exact."""
    if 0.995 < p < 1.0:
        return "over 99 %"
    return "under 1 %" if 0.0 < p < 0.005 else f"{100.0 * p:.0f} %"
