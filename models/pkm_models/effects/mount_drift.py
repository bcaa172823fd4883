"""A mount that drifts: cup or instrument frame moves during the session. Magnetic bases
creep by 1 to 5 um.
"""

from collections.abc import Iterable, Iterator

from oed.base import Array
from oed.effect_model import Column, Effect, State
from pkm_models.effects import natures, references, terms

CREEP = 5e-6  #: expected creep of a mount in a session, m
CREEP_ANGLE = 10e-6  #: expected turn of a mount in a session, rad
#: unknowns of set-ups that a mount has
LENGTHS = (*(f"{name}_{k}" for name in ("cup", "shift") for k in "xyz"), "offset")
ANGLES = (*(f"turn_{k}" for k in "xyz"), "tilt")
#: readings of instruments without such unknowns: a displacement, of a laser or
#: micrometer
READINGS = ("dy", "dz")


def columns(state: State) -> Iterable[Column]:
    """In step with time, an unknown of each set-up, or of all alike, as where the table
    under them moves; shape: any smooth course.
    """
    forms = {"": terms.session_share(state)}
    forms |= {f" {name}": course for name, course in terms.free_courses(state).items()}
    for name, form in forms.items():
        part = terms.SHAPE_SHARE if name else 1.0
        yield from moved_mounts(state, name, form, part * CREEP, part * CREEP_ANGLE)


def moved_mounts(
    state: State, name: str, form: Array, shift: float, turn: float
) -> Iterator[Column]:
    """A form (m,) of each unknown of a set-up and of its readings, of sizes in m and rad;
    `name` is empty for the textbook's.
    """
    block = references.block(state)
    shape = bool(name)
    for unknown in (*LENGTHS, *ANGLES):
        size = turn if unknown in ANGLES else shift
        full = f"{block} {unknown}{name}"
        yield Column(full, size, block, nuisances={unknown: form}, shape=shape)
    for channel in READINGS:
        full = f"{block} {channel}{name}"
        yield Column(full, shift, block, reading={channel: form}, shape=shape)


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
