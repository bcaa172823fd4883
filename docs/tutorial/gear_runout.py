"""Eccentric pinions: each moves its crank back and forth once per pinion turn."""

import numpy as np

from oed import Column, Effect

#: rad of the crank: quality 8, 15 um on a wheel of 150 mm (ISO 1328-2)
RUNOUT = 0.1e-3


def columns(state, ratio):
    """Sine and cosine of each pinion's angle; RUNOUT is the coefficients' prior sd."""
    for i in state.limbs:
        pinion, where = ratio * state.joints[:, i], f"leg {i + 1}"
        sine, cosine = {i: np.sin(pinion)}, {i: np.cos(pinion)}
        yield Column(f"motor {i + 1} sine", RUNOUT, where, joints=sine)
        yield Column(f"motor {i + 1} cosine", RUNOUT, where, joints=cosine)


def unfit(machine):
    turning = any(joint.unit == "rad" for joint in machine.joints)
    return None if turning else "its drives have no gears"


effect = Effect(
    name="gear_runout",
    source="ISO 1328-2 (runout of gears)",
    about="eccentric pinions",
    columns=columns,
    constants={"ratio": (6.0, 8.0, 10.0)},  # the supplier's; the readings decide
    units={"*": "rad"},  # of its coefficients; m by default
    remedy="replace the pinion, or correct the motor's angle by a table over its turn",
    exposed_by="circles read every few degrees",
    unfit=unfit,
)
