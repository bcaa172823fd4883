"""Does the machine assemble where it should, and as the real one stands?"""

import numpy as np
from my_machine import INWARD, LIMBS, machine

from oed.mechanism import Kinematics

kinematics = Kinematics(machine)
inward = np.array([INWARD[i] for i in LIMBS])

x, q = kinematics.inverse(machine.home_command)
print(
    "cranks at home, degrees to the left of the line to the middle:",
    np.rad2deg(q - inward).round(2),
)

axes = np.meshgrid(
    [0.0, 0.06, 0.12], np.deg2rad(np.arange(0, 360, 15)), np.deg2rad([-20, 0, 20])
)
command = np.column_stack([axis.ravel() for axis in axes])
x, q = kinematics.inverse(command)


def named(items, values):
    return {item.name: value for item, value in zip(items, values, strict=True)}


p = named(machine.parameters, machine.nominal)
gap = [
    machine.closure(named(machine.pose, xi), named(machine.joints, qi), p)
    for xi, qi in zip(x, q, strict=True)
]
largest = np.abs(np.array(gap, dtype=float)).max()
print(f"{len(command)} poses, largest gap of a rod: {largest:.0e} m")

again = kinematics.forward(q, machine.nominal, x + 0.005)
print(f"forward after inverse: {np.abs(again - x).max():.0e}")
distance = kinematics.slopes.reciprocal_condition(x, q, machine.nominal).min()
print(f"distance to singular poses (1 / condition number): {distance:.3f}")
lower, upper = np.array([[c.lower, c.upper] for c in machine.joints]).T
print("all joints in range:", bool(((lower < q) & (q < upper)).all()))
