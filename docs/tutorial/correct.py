"""Joint values for the controller, and the virtual machine's true error with them."""

import json
from pathlib import Path

import numpy as np
from my_machine import machine

from oed import compensate, units
from oed.mechanism import Kinematics, pose_error

result = json.loads(Path("fit/result.json").read_text(encoding="utf-8"))
identified = machine.nominal  # fixed parameters stay there
for name, estimate in result["estimate"]["parameters"].items():
    if "." not in name:  # "centre.cup_x" belongs to the set-up
        value = units.to_si(estimate["value"], estimate["unit"])
        identified[machine.index(name)] = value
kinematics = Kinematics(machine)

axes = np.meshgrid(
    [0.04, 0.08, 0.12], np.deg2rad(np.arange(0, 360, 30)), np.deg2rad([-15, 0, 15])
)
command = np.column_stack([axis.ravel() for axis in axes])
before = compensate.compensated_joints(kinematics, command, machine.nominal)
after = compensate.compensated_joints(kinematics, command, identified)
print(
    "first pose, joints before and after, degrees:",
    np.rad2deg(before[0]).round(3),
    np.rad2deg(after[0]).round(3),
)

truth = json.loads(Path("readings.truth.json").read_text(encoding="utf-8"))
true = np.array([truth[p.name]["value"] for p in machine.parameters])
home = machine.home_command[None]
for name, q, model in (
    ("before", before, machine.nominal),
    ("after", after, identified),
):
    q_home = compensate.compensated_joints(kinematics, home, model)
    error = pose_error(kinematics, command, q, true)
    error = error - pose_error(kinematics, home, q_home, true)
    x, y, phi = np.sqrt(np.mean(error[:, [0, 1, 5]] ** 2, axis=0))
    turn = np.rad2deg(phi) * 3600
    print(f"{name}: x {x * 1e6:.1f} um, y {y * 1e6:.1f} um, phi {turn:.1f} arcsec rms")
