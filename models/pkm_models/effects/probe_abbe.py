"""Abbe error of a probe: its line of measurement passes beside the tool point.

An offset d of the probe's tip, in the platform's frame, moves what it reads by the
height of R d: d times the angles of pitch and yaw.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references

OFFSET = 50e-6  # m


def columns(state: State) -> Iterable[Column]:
    """The offset of each set-up's probe along x and y of the platform."""
    if state.instrument in references.HEIGHT_PROBES:
        block = references.block(state)
        for k, name in enumerate("xy"):
            height = state.rotation[:, 2, k]
            yield Column(
                f"{block} offset {name}", OFFSET, block, reading={"height": height}
            )


effect = Effect(
    name="probe_abbe",
    source="ISO 230-1 (Abbe error) and ISO 230-10 (probe offset): 10 to 100 um after centring",
    about="a probe or gauge beside the tool point: its offset times pitch and yaw",
    columns=columns,
    instruments=references.HEIGHT_PROBES,
    remedy="centre the stylus on the tool's axis, or state its offset as the tool point",
    check="the run-out of the stylus against the spindle",
    nature=natures.REFERENCE,
    exposed_by="the same points with the probe turned by 180 degrees in its holder",
)
