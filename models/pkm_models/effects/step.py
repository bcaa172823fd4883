"""A step: at some time a joint loses its zero, or a mount is knocked: H(t - t0),
perhaps put right later.
"""

from collections.abc import Iterable

from oed.effect_model import Column, Effect, State
from pkm_models.effects import mount_drift, natures, terms

LOST_STEPS = 20e-6  #: expected steps that a joint loses, m
MOUNT_SHIFT = 10e-6  #: expected shift of a mount that is knocked, m
TURN_RATIO = 2.0  #: turn of a mount over its shift, rad / m
N_MOMENTS = 59  #: moments of the session at which it may happen
WHEN = tuple(
    (k + 1) / (N_MOMENTS + 1) for k in range(N_MOMENTS)
)  # share of the session
#: shares of the session that it lasts, to the end first
LASTS = (
    9.0,
    *(
        sign * share
        for share in (0.04, 0.08, 0.13, 0.19, 0.27, 0.37, 0.5)
        for sign in (1.0, -1.0)
    ),
)


def columns(state: State, when: float, lasts: float) -> Iterable[Column]:
    """A step a leg, and one of each unknown of a set-up; shape: one that comes a third,
    or two, of a grid step later.

    `lasts`: share of the session after which all is as before; negative: before `when`,
    from which on it is.
    """
    time = terms.session_share(state)
    first, last = (when, when + lasts) if lasts > 0.0 else (when + lasts, when)
    inside = ((time >= first) & (time < last)).astype(float)
    if not inside.any():
        return
    fine = [inside * (time < first + k / 3.0 / (N_MOMENTS + 1)) for k in (1, 2)]
    unit = terms.joint_per_metre(state)
    for name, form, part in (
        ("", inside, 1.0),
        (" later", fine[0], 0.5),
        (" latest", fine[1], 0.5),
    ):
        for i in state.limbs:
            leg = f"leg {i + 1}"
            lost = {i: unit[:, i] * form}
            size = part * LOST_STEPS
            yield Column(f"{leg}{name}", size, leg, lost, shape=bool(name))
        shift = part * MOUNT_SHIFT
        yield from mount_drift.moved_mounts(
            state, name, form, shift, shift * TURN_RATIO
        )


effect = Effect(
    name="step",
    source="ISO 230-2 (repeatability); practice: a lost reference mark, a collision, a knocked cup",
    about="a joint's zero or a set-up that changes at once",
    columns=columns,
    units={"*turn_*": "rad", "*tilt*": "rad"},
    needs=("time",),
    constants={"when": WHEN, "lasts": LASTS},
    remedy=(
        "look up the log at that time, home the leg again or repeat the set-up, and"
        " drop the readings on one side"
    ),
    nature=natures.SESSION,
    incident=True,
    exposed_by="a reference circle repeated before and after",
)
