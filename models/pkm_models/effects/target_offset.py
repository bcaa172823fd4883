"""A wrong target or nest: what is read is off the tool point, by one vector in its frame.

Drawings give a nest's offset to 0.1 mm; one that is mistaken is off by millimetres. On a
platform that does not turn it is the place of the instrument's frame.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

OFFSET = 0.1e-3  # m


def columns(state: State) -> Iterable[Column]:
    """The platform's three axes as the instrument sees them, of a set-up's target."""
    label = references.block(state)
    for axis, name in enumerate("xyz"):
        reading = {f"read_{n}": state.rotation[:, k, axis] for k, n in enumerate("xyz")}
        yield Column(f"{state.setup} {name}", OFFSET, label, reading=reading)


effect = Effect(
    name="target_offset",
    source="ASME B89.4.19 (nests and targets of trackers)",
    about="a target or nest that is not where the set-up states it on the platform",
    columns=columns,
    remedy="measure the target's place on the platform, and state it as the tool",
    nature=natures.REFERENCE,
    exposed_by="poses that turn the platform far, at one place",
    instruments=references.STATIONS,
)
