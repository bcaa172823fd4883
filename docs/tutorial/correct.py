"""Joints for the controller from an identified machine; then, as this machine is
virtual, its true error.
"""

import json
from pathlib import Path

import numpy as np
from my_machine import machine

from oed import compensate, units
from oed.kinematics import Kinematics

found = json.loads(Path("fit/result.json").read_text(encoding="utf-8"))["estimate"][
    "parameters"
]
identified = machine.nominal  # parameters held stay there
for name, told in found.items():
    if "." not in name:  # "centre.cup_x" belongs to the set-up
        identified[machine.index(name)] = units.to_si(told["value"], told["unit"])
kinematics = Kinematics(machine)

axes = np.meshgrid(
    [0.04, 0.08, 0.12], np.deg2rad(np.arange(0, 360, 30)), np.deg2rad([-15, 0, 15])
)
command = np.column_stack([axis.ravel() for axis in axes])
before = compensate.joints(kinematics, command, machine.nominal)
after = compensate.joints(kinematics, command, identified)
print(
    "first pose, joints before and after, degrees:",
    np.rad2deg(before[0]).round(3),
    np.rad2deg(after[0]).round(3),
)

truth = json.loads(Path("readings.truth.json").read_text(encoding="utf-8"))
true = np.array([truth[p.name]["value"] for p in machine.parameters])
home = machine.home_command[None]
for name, q, believed in (
    ("before", before, machine.nominal),
    ("after", after, identified),
):
    error = compensate.pose_error(kinematics, command, q, true)
    error = error - compensate.pose_error(
        kinematics, home, compensate.joints(kinematics, home, believed), true
    )
    x, y, phi = np.sqrt(np.mean(error[:, [0, 1, 5]] ** 2, axis=0))
    print(
        f"{name}: x {x * 1e6:.1f} um, y {y * 1e6:.1f} um, phi"
        f" {np.rad2deg(phi) * 3600:.1f} arcsec rms"
    )
