"""Cyclic error of a screw: once a turn, a sin(2 pi q / p) + b cos(2 pi q / p), and its
second harmonic.

ISO 3408-3 allows 6 (class 3) to 8 um (class 5) from end to end within a turn. Over a
joint's travel the phase slips by many turns between two neighbouring pitches, so only
leads that screws are made with are tried (ISO 3408-2, and 15, 30 and 50 mm of
catalogues; 2 and 2.5 mm are the second harmonics of 4 and 5), unless a study states its
own, `drive = { kind = "screw", lead_mm = 7 }`.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from oed.model import Machine
from pkm_models.effects import natures, terms

AMPLITUDE = 3e-6  # m, amplitude
LEADS_MM = (3, 4, 5, 6, 8, 10, 12, 15, 16, 20, 25, 30, 32, 40, 50)
LEADS = tuple(1e-3 * lead for lead in LEADS_MM)


def columns(state: State, pitch: float) -> Iterable[Column]:
    """Sine and cosine of the screw's angle a leg; shape: twice a turn."""
    return terms.harmonics(state, pitch, AMPLITUDE)


def unfit(machine: Machine) -> str | None:
    """Why it cannot occur on a machine; None where it can."""
    if machine.cable_stiffness is not None:
        return "its struts are cables: it has no screws"
    if machine.drive not in ("", "screw"):
        drive = machine.drive.replace("_", " ")
        return f"a {drive} moves each joint: it has no screws"
    return terms.has_rotary_drives(machine)


effect = Effect(
    name="screw_cyclic",
    source="ISO 3408-3 (travel variation within 2 pi), ISO 3408-2 (nominal leads)",
    about="cyclic error of each screw, once a turn",
    columns=columns,
    constants={"pitch": LEADS},
    of_drive="pitch",
    remedy=(
        "align the screw's bearings and coupling, or close the loop by a linear encoder"
    ),
    nature=natures.TRAVEL,
    exposed_by="poses so dense that several fall within one turn of the screw",
    unfit=unfit,
)
