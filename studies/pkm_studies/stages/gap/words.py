"""Names of effects in words."""

from __future__ import annotations

from oed.result import UNKNOWN


def plain_name(effect: str) -> str:
    """An effect's name as a person says it: `leg_thermal` -> leg thermal."""
    return (
        "an effect of unknown form" if effect == UNKNOWN else effect.replace("_", " ")
    )
