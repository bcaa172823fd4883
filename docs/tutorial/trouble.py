"""Machines that do not assemble, on purpose, and the errors that they raise."""

import dataclasses

import numpy as np
from my_machine import INWARD, LIMBS, machine, target

from oed.mechanism import AssemblyError, Kinematics


def attempt(title, call):
    print(f"-- {title}")
    try:
        call()
    except AssemblyError as error:
        print(f"{error} [failing rows: {error.indices[:4]}]")


def starting_at(joints):
    """The machine with another guess for its joints."""
    return Kinematics(dataclasses.replace(machine, guess=lambda c: (target(c), joints)))


kinematics = Kinematics(machine)
x, q = kinematics.inverse(machine.home_command)
poses = np.array(
    [[0.0, 0.0, phi] for phi in np.deg2rad([-20.0, -10.0, 0.0, 10.0, 20.0])]
)

attempt(
    "out of reach",
    lambda: kinematics.inverse(np.array([[0.1, 0.0, 0.0], [0.4, 0.0, 0.0]])),
)
attempt(
    "millimetres for metres", lambda: kinematics.inverse(np.array([[100.0, 0.0, 0.0]]))
)
attempt("degrees for radians", lambda: kinematics.inverse(np.array([[0.1, 0.0, 10.0]])))
attempt(
    "a guess at a singular pose",
    lambda: starting_at([INWARD[i] for i in LIMBS]).inverse(poses),
)
attempt(
    "a guess between two modes", lambda: starting_at([0.0, 0.0, 0.0]).inverse(poses)
)
attempt(
    "joints in degrees", lambda: kinematics.forward(np.rad2deg(q), machine.nominal, x)
)

right = starting_at([INWARD[i] - 1.0 for i in LIMBS])
print("-- every elbow to the right: no error, another machine")
cranks = right.inverse(machine.home_command)[1][0] - [INWARD[i] for i in LIMBS]
print("cranks at home:", np.rad2deg(cranks).round(2))
