"""Gears that do not run true: a pinion off its centre moves its crank once a turn of
the pinion, back and forth.
"""

import numpy as np

from oed.effect import Column, Effect

RUNOUT = 0.1e-3  # rad of the crank: a pinion of quality 8, 15 um off on a wheel of 150 mm (ISO 1328-2)


def columns(state, ratio):
    """For each motor, sine and cosine of the pinion's angle; a coefficient is worth
    RUNOUT, more or less.
    """
    for i in state.limbs:
        pinion = ratio * state.joints[:, i]
        yield Column(
            f"motor {i + 1} sine", RUNOUT, f"leg {i + 1}", joints={i: np.sin(pinion)}
        )
        yield Column(
            f"motor {i + 1} cosine", RUNOUT, f"leg {i + 1}", joints={i: np.cos(pinion)}
        )


effect = Effect(
    name="gear_runout",
    source="ISO 1328-2 (runout of gears)",
    about="pinions that do not run true",
    columns=columns,
    constants={
        "ratio": (6.0, 8.0, 10.0)
    },  # of those that the supplier has; the readings tell which
    remedy=(
        "replace the pinion, or correct the motor's angle by a table over a turn of the"
        " pinion"
    ),
    exposed_by="circles read every few degrees",
    unfit=lambda machine: (
        None
        if any(c.unit == "rad" for c in machine.joints)
        else "its drives have no gears"
    ),
)
