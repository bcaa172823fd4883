"""RepRapFirmware: M665 and M666 of a delta."""

from __future__ import annotations

import numpy as np

from oed.arrays import Array
from pkm_studies.compensation.build import sentences_of
from pkm_studies.compensation.content import Compensation, ControllerFormat, Texts
from pkm_studies.compensation.formats.delta import (
    ANGLES,
    DeltaNumbers,
    delta_joints,
    delta_numbers,
    not_a_delta,
)
from pkm_studies.compensation.formats.marlin import words


def write(compensation: Compensation) -> Texts:
    """Homed height H, and M666 with adjustments of mean zero.

    The firmware homes every carriage to H + (the carriages' common height over the tool
    where all stand equal) + adjustment.
    """
    numbers = delta_numbers(compensation)
    lean = numbers.angles - ANGLES
    height = float(np.mean(numbers.carriages)) - carriage_over_tool(numbers)
    adjust = numbers.carriages - np.mean(numbers.carriages)
    arms = ":".join(f"{arm:.4f}" for arm in numbers.arms)
    lines = [f"; {sentence}" for sentence in sentences_of(compensation)]
    lines += [
        "; config.g; several lengths after L need RepRapFirmware 3",
        f"M665 L{arms} R{numbers.radius:.4f} H{height:.4f}"
        f" X{lean[0]:.4f} Y{lean[1]:.4f} Z{lean[2]:.4f}",
        f"M666 X{adjust[0]:.4f} Y{adjust[1]:.4f} Z{adjust[2]:.4f}",
        "",
    ]
    return {".g": "\n".join(lines)}


def carriage_over_tool(numbers: DeltaNumbers) -> float:
    """Height of the carriages over the tool, mm, where all carriages stand equal.

    Differences of |tool - tower_i|^2 + h^2 = arm_i^2 are linear in the tool's x, y.
    """
    angle = np.deg2rad(numbers.angles)
    tower = numbers.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    right = 0.5 * (numbers.arms[0] ** 2 - numbers.arms[1:] ** 2)
    tool = np.linalg.solve(tower[1:] - tower[0], right)
    across = float(((tool - tower[0]) ** 2).sum())
    return float(np.sqrt(numbers.arms[0] ** 2 - across))


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Travels of a printer with these commands."""
    geometry = words(texts[".g"], "M665")
    adjust = words(texts[".g"], "M666")
    numbers = DeltaNumbers(
        radius=geometry["R"][0],
        arms=np.array(geometry["L"]),
        angles=np.array(ANGLES) + [geometry[k][0] for k in "XYZ"],
        endstops=np.zeros(3),
    )
    common = geometry["H"][0] + carriage_over_tool(numbers)
    carriages = common + np.array([adjust[k][0] for k in "XYZ"])
    return delta_joints(numbers, carriages, compensation)


controller = ControllerFormat(
    name="rrf",
    about="RepRapFirmware's M665 and M666 of a delta printer, four decimals",
    source="RepRapFirmware, src/Movement/Kinematics/LinearDeltaKinematics.cpp",
    write=write,
    joints=joints,
    unfit=not_a_delta,
)
