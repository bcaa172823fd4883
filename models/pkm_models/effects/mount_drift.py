"""A mount that drifts: cup or instrument frame moves during the session. Magnetic bases
creep by 1 to 5 um.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, terms

CREEP = 5e-6  #: expected creep of a mount in a session, m
CREEP_ANGLE = 10e-6  #: expected turn of a mount in a session, rad
#: unknowns of set-ups that a mount has
ANGLES = (*(f"turn_{k}" for k in "xyz"), "tilt")
UNKNOWNS = {
    **{f"{name}_{k}": CREEP for name in ("cup", "shift") for k in "xyz"},
    "offset": CREEP,
    **dict.fromkeys(ANGLES, CREEP_ANGLE),
}
#: readings of instruments without such unknowns: a displacement, of a laser or
#: micrometer
READINGS = ("dy", "dz")


def columns(state: State) -> Iterable[Column]:
    """In step with time, an unknown of each set-up, or of all alike, as where the table
    under them moves; shape: any smooth course.
    """
    forms = {"": terms.session_share(state)}
    forms |= {f" {name}": course for name, course in terms.free_courses(state).items()}
    block = f"set-up {state.setup}"
    for name, form in forms.items():
        part = terms.SHAPE_SHARE if name else 1.0
        for unknown, scale in UNKNOWNS.items():
            full = f"{block} {unknown}{name}"
            yield Column(
                full, part * scale, block, nuisances={unknown: form}, shape=bool(name)
            )
        for channel in READINGS:
            full = f"{block} {channel}{name}"
            yield Column(
                full, part * CREEP, block, reading={channel: form}, shape=bool(name)
            )


effect = Effect(
    name="mount_drift",
    source="ISO 230-3 (drift tests); data sheets of magnetic bases: 1 to 5 um in hours",
    about="a cup or instrument that moves during the session",
    columns=columns,
    units={"*turn_*": "rad", "*tilt*": "rad"},
    needs=("time",),
    remedy="clamp the mount to the table, let it settle, and teach the cup again between runs",
    nature=natures.SESSION,
    exposed_by="a set-up repeated at the session's end",
    common_to_limbs=True,
)
