"""LinuxCNC: HAL of genhexkins (hexapod), tripodkins, pentakins, lineardeltakins and
rotarydeltakins, and homes for the INI file.
"""

import dataclasses
from collections.abc import Callable

import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.compensation.formats import linuxcnc_deltas, linuxcnc_pentapod

#: kinematics module by number of struts
MODULES = {6: "genhexkins", 3: "tripodkins"}
#: m; ends and lengths that differ less between two poses do not move
MOTION_TOLERANCE = 1e-9

Write = Callable[[Compensation], Texts]
Joints = Callable[[Texts, Compensation], Array]
#: what the modules can take
NEEDS = (
    "genhexkins and tripodkins need 6 or 3 struts between fixed points, pentakins a"
    " pentapod, the deltas' modules limbs 120 degrees apart, the first of them at 90 or"
    " 270 degrees from x"
)


@dataclasses.dataclass(frozen=True)
class Struts:
    """Struts (n) of a platform, mm.

    base      (n, 3) joints in the base frame
    platform  (n, 3) joints in the platform's frame, from the tool point
    zero      (n,) length of a strut less its joint's reading
    """

    base: Array
    platform: Array
    zero: Array


def struts_of(kinematics: Kinematics, parameters: Array) -> Struts:
    """Struts that lengthen between fixed points. Raises LookupError for other ones."""
    struts = _fixed_struts(kinematics, parameters)
    if struts is None:
        raise LookupError(NEEDS)
    return struts


def _fixed_struts(kinematics: Kinematics, parameters: Array) -> Struts | None:
    machine = kinematics.machine
    if machine.struts is None or len(machine.joints) not in MODULES:
        return None
    if len(machine.pose) != len(machine.joints):
        return None
    home = machine.home_command
    shift = 0.1 * np.array([c.upper - c.lower for c in machine.command])
    poses, joints = kinematics.inverse(np.array([home, home + shift]), parameters)
    base, platform, _ = kinematics.struts(poses, joints, parameters)
    rotation, point, _ = kinematics.frames(poses, np.zeros(3))
    local = np.einsum("nji,nkj->nki", rotation, platform - point[:, None])
    zero = np.linalg.norm(platform - base, axis=2) - joints
    moving = [np.ptp(values, axis=0).max() for values in (base, local, zero)]
    if max(moving) > MOTION_TOLERANCE:
        return None
    return Struts(*(units.from_si(v[0], "mm") for v in (base, local, zero)))


def _formats_of(machine: Machine) -> tuple[Write, Joints] | None:
    """Writer and formula of a machine with a module of its own; None for other ones."""
    if linuxcnc_pentapod.is_pentapod(machine):
        return linuxcnc_pentapod.write, linuxcnc_pentapod.joints
    if linuxcnc_deltas.module_of(machine) is not None:
        return linuxcnc_deltas.write, linuxcnc_deltas.joints
    return None


def unfit(machine: Machine) -> str | None:
    """Hexapods and tripods with struts between fixed points, deltas and pentapods."""
    if _formats_of(machine) is not None:
        return None
    if _fixed_struts(Kinematics(machine), machine.nominal) is None:
        return NEEDS
    return None


def write(compensation: Compensation) -> Texts:
    """HAL pins of the kinematics module; home offsets for the INI file."""
    other = _formats_of(compensation.machine)
    if other is not None:
        return other[0](compensation)
    struts = struts_of(compensation.kinematics, compensation.identified.values)
    nominal = struts_of(compensation.kinematics, compensation.machine.nominal)
    head = [f"# {sentence}" for sentence in compensation.comments]
    pins = _hexapod(struts) if len(struts.zero) == 6 else _tripod(struts)
    homes = linuxcnc_pentapod.homes(head, struts.zero.tolist(), nominal.zero.tolist())
    return {".hal": "\n".join([*head, *pins, ""]), ".ini": homes}


def _hexapod(struts: Struts) -> list[str]:
    """Joints of base and platform; A, B, C are roll, pitch and yaw there."""
    lines = ["# genhexkins turns the platform by roll, pitch and yaw (A, B, C)"]
    for body, points in (("base", struts.base), ("platform", struts.platform)):
        for k, point in enumerate(points):
            for axis, value in zip("xyz", point, strict=True):
                lines.append(f"setp genhexkins.{body}.{k}.{axis} {value:.6f}")
    return lines


def _tripod(struts: Struts) -> list[str]:
    """Bx, Cx, Cy of the base points, reduced by the platform's, in their own frame."""
    origin, axes = tripod_frame(struts)
    _, b, c = (struts.base - struts.platform - origin) @ axes.T
    places = ", ".join(f"{v:.6f}" for v in origin)
    rows = "; ".join(" ".join(f"{v:.9f}" for v in row) for row in axes)
    return [
        f"# tripodkins' frame: origin at {places} mm of the machine's frame,",
        f"# axes (rows) {rows}; point = axes (machine's point - origin)",
        f"setp tripodkins.Bx {b[0]:.6f}",
        f"setp tripodkins.Cx {c[0]:.6f}",
        f"setp tripodkins.Cy {c[1]:.6f}",
    ]


def tripod_frame(struts: Struts) -> tuple[Array, Array]:
    """Origin (3,) at the first reduced base point, and axes (3, 3) as rows."""
    a, b, c = struts.base - struts.platform
    first = (b - a) / np.linalg.norm(b - a)
    third = np.cross(first, c - a)
    third /= np.linalg.norm(third)
    return a, np.array([first, np.cross(third, first), third])


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joint readings of a controller with these pins and homes."""
    other = _formats_of(compensation.machine)
    if other is not None:
        return other[1](texts, compensation)
    zero = linuxcnc_pentapod.stated_zeros(texts[".ini"])
    pins = dict(
        line.split()[1:] for line in texts[".hal"].splitlines() if line[:5] == "setp "
    )
    lengths = (_hexapod_lengths if len(zero) == 6 else _tripod_lengths)(
        pins, compensation
    )
    return units.to_si(lengths - zero, "mm")


def _hexapod_lengths(pins: dict[str, str], compensation: Compensation) -> Array:
    base, platform = (
        np.array(
            [[float(pins[f"genhexkins.{b}.{k}.{a}"]) for a in "xyz"] for k in range(6)]
        )
        for b in ("base", "platform")
    )
    poses, _ = compensation.kinematics.inverse(compensation.command)
    rotation, point, _ = compensation.kinematics.frames(poses, np.zeros(3))
    ends = units.from_si(point, "mm")[:, None] + platform @ rotation.swapaxes(1, 2)
    return np.asarray(np.linalg.norm(ends - base, axis=2))


def _tripod_lengths(pins: dict[str, str], compensation: Compensation) -> Array:
    struts = struts_of(compensation.kinematics, compensation.identified.values)
    origin, axes = tripod_frame(struts)
    bx, cx, cy = (float(pins[f"tripodkins.{n}"]) for n in ("Bx", "Cx", "Cy"))
    base = np.array([[0.0, 0.0, 0.0], [bx, 0.0, 0.0], [cx, cy, 0.0]])
    point = (units.from_si(compensation.command, "mm") - origin) @ axes.T
    return np.asarray(np.linalg.norm(point[:, None] - base, axis=2))


controller = ControllerFormat(
    name="linuxcnc",
    about="HAL and INI of hexapods, pentapods, tripods, linear and rotary deltas",
    source="LinuxCNC, src/emc/kinematics/genhexkins.c, tripodkins.c and others",
    write=write,
    joints=joints,
    unfit=unfit,
)
