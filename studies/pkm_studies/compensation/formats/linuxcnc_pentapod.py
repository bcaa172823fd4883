"""LinuxCNC's pentapod: HAL of pentakins, and homes for the INI file."""

import re
from collections.abc import Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Machine
from pkm_studies.catalogue import Compensation, Texts

LEGS = (1, 2, 3, 4, 5)
#: pins of a leg and the parameters that they hold
PINS = {
    "base.{}.x": "b{}x",
    "base.{}.y": "b{}y",
    "base.{}.z": "b{}z",
    "effector.{}.r": "r{}",
    "effector.{}.z": "h{}",
}
SETP = re.compile(r"^setp pentakins\.(\S+) (\S+)", re.MULTILINE)
ZERO = re.compile(r"^# STRUT_ZERO = (\S+)", re.MULTILINE)


def is_pentapod(machine: Machine) -> bool:
    """Whether a machine has the numbers of a pentapod with collars."""
    names = {p.name for p in machine.parameters}
    wanted = {name.format(i) for i in LEGS for name in PINS.values()}
    return names == wanted | {f"l{i}" for i in LEGS}


def write(compensation: Compensation) -> Texts:
    """HAL pins of the module; strut lengths at a joint of 0 for the INI file."""
    head = [f"# {sentence}" for sentence in compensation.comments]
    hal = [*head, "# the tool axis is that of roll and pitch (A, B); tool-offset is 0"]
    for k, i in enumerate(LEGS):
        for pin, name in PINS.items():
            value = units.number(compensation.parameter(name.format(i)), "mm")
            hal.append(f"setp pentakins.{pin.format(k)} {value:.6f}")
    zeros = [units.number(compensation.parameter(f"l{i}"), "mm") for i in LEGS]
    indices = [compensation.machine.index(f"l{i}") for i in LEGS]
    nominal = units.from_si(compensation.machine.nominal[indices], "mm").tolist()
    return {".hal": "\n".join([*hal, ""]), ".ini": homes(head, zeros, nominal)}


def homes(head: Sequence[str], zeros: Sequence[float], nominal: Sequence[float]) -> str:
    """The INI file: strut lengths at a joint of 0, mm, identified and nominal."""
    lines = [
        *head,
        "# strut length less joint reading, mm, and its change by calibration:",
        "# add the change to HOME_OFFSET of each joint",
    ]
    for k, (zero, drawn) in enumerate(zip(zeros, nominal, strict=True)):
        lines += [f"[JOINT_{k}]", f"# STRUT_ZERO = {zero:.6f}"]
        lines.append(f"# HOME_OFFSET_CHANGE = {zero - drawn:+.6f}")
    return "\n".join([*lines, ""])


def stated_zeros(ini: str) -> Array:
    """Strut lengths at a joint of 0, mm, as an INI file has them."""
    return np.array([float(value) for value in ZERO.findall(ini)])


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joint readings of a controller with these pins and homes."""
    pins = {name: float(value) for name, value in SETP.findall(texts[".hal"])}
    zero = stated_zeros(texts[".ini"])
    legs = range(len(LEGS))
    base = np.array([[pins[f"base.{k}.{a}"] for a in "xyz"] for k in legs])
    radius, height = (np.array([pins[f"effector.{k}.{a}"] for k in legs]) for a in "rz")
    poses, _ = compensation.kinematics.inverse(compensation.command)
    rotation, point, _ = compensation.kinematics.frames(poses, np.zeros(3))
    offset = base - units.from_si(point, "mm")[:, None]
    along = np.einsum("nki,ni->nk", offset, rotation[:, :, 2])
    across = np.sqrt(np.sum(offset**2, axis=2) - along**2)
    lengths = np.hypot(along - height, across - radius)
    return units.to_si(lengths - zero, "mm")
