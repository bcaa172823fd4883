"""LinuxCNC: HAL of genhexkins (hexapod), tripodkins, pentakins, lineardeltakins and
rotarydeltakins, and homes for the INI file.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.compensate import compensated_joints
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

MODULES = {6: "genhexkins", 3: "tripodkins"}  #: kinematics module by number of struts
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
    """Struts (n) of a platform, mm."""

    base: Array  #: (n, 3) joints in the base frame
    platform: Array  #: (n, 3) joints in the platform's frame, from the tool point
    zero: Array  #: (n,) length of a strut less its joint's reading


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
    if is_pentapod(machine):
        return write_pentapod, pentapod_joints
    if delta_module(machine) is not None:
        return write_delta, delta_joints
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
    homes = ini_homes(head, struts.zero.tolist(), nominal.zero.tolist())
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
    zero = stated_zeros(texts[".ini"])
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


# LinuxCNC's pentapod: HAL of pentakins, and homes for the INI file.

PENTAPOD_LEGS = (1, 2, 3, 4, 5)
#: pins of a leg and the parameters that they hold
PENTAPOD_PINS = {
    "base.{}.x": "b{}x",
    "base.{}.y": "b{}y",
    "base.{}.z": "b{}z",
    "effector.{}.r": "r{}",
    "effector.{}.z": "h{}",
}
PENTAPOD_SETP = re.compile(r"^setp pentakins\.(\S+) (\S+)", re.MULTILINE)
STRUT_ZERO = re.compile(r"^# STRUT_ZERO = (\S+)", re.MULTILINE)


def is_pentapod(machine: Machine) -> bool:
    """Whether a machine has the numbers of a pentapod with collars."""
    names = {p.name for p in machine.parameters}
    wanted = {name.format(i) for i in PENTAPOD_LEGS for name in PENTAPOD_PINS.values()}
    return names == wanted | {f"l{i}" for i in PENTAPOD_LEGS}


def write_pentapod(compensation: Compensation) -> Texts:
    """HAL pins of the module; strut lengths at a joint of 0 for the INI file."""
    head = [f"# {sentence}" for sentence in compensation.comments]
    hal = [*head, "# the tool axis is that of roll and pitch (A, B); tool-offset is 0"]
    for k, i in enumerate(PENTAPOD_LEGS):
        for pin, name in PENTAPOD_PINS.items():
            value = units.number(compensation.parameter(name.format(i)), "mm")
            hal.append(f"setp pentakins.{pin.format(k)} {value:.6f}")
    zeros = [units.number(compensation.parameter(f"l{i}"), "mm") for i in PENTAPOD_LEGS]
    indices = [compensation.machine.index(f"l{i}") for i in PENTAPOD_LEGS]
    nominal = units.from_si(compensation.machine.nominal[indices], "mm").tolist()
    return {".hal": "\n".join([*hal, ""]), ".ini": ini_homes(head, zeros, nominal)}


def ini_homes(
    head: Sequence[str], zeros: Sequence[float], nominal: Sequence[float]
) -> str:
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
    return np.array([float(value) for value in STRUT_ZERO.findall(ini)])


def pentapod_joints(texts: Texts, compensation: Compensation) -> Array:
    """Joint readings of a controller with these pins and homes."""
    pins = {name: float(value) for name, value in PENTAPOD_SETP.findall(texts[".hal"])}
    zero = stated_zeros(texts[".ini"])
    legs = range(len(PENTAPOD_LEGS))
    base = np.array([[pins[f"base.{k}.{a}"] for a in "xyz"] for k in legs])
    radius, height = (np.array([pins[f"effector.{k}.{a}"] for k in legs]) for a in "rz")
    poses, _ = compensation.kinematics.inverse(compensation.command)
    rotation, point, _ = compensation.kinematics.frames(poses, np.zeros(3))
    offset = base - units.from_si(point, "mm")[:, None]
    along = np.einsum("nki,ni->nk", offset, rotation[:, :, 2])
    across = np.sqrt(np.sum(offset**2, axis=2) - along**2)
    lengths = np.hypot(along - height, across - radius)
    return units.to_si(lengths - zero, "mm")


# LinuxCNC's deltas: HAL of lineardeltakins and rotarydeltakins, and homes for the INI file.

#: limbs of the study may be this far, in degrees, from those of the module
LIMB_TOLERANCE_DEG = 10.0
SEARCH_STEPS = 20
DELTA_LIMBS = (1, 2, 3)
AT_ZERO = re.compile(r"^# JOINT_AT_ZERO = (\S+)", re.MULTILINE)
DELTA_SETP = re.compile(r"^setp \w+\.(\w+) (\S+)", re.MULTILINE)
Z_OFFSET = re.compile(r"^# Z_OFFSET = (\S+)", re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class DeltaModule:
    """A kinematics module."""

    name: str  #: of the module
    pins: tuple[str, ...]  #: its numbers
    degrees: tuple[float, float, float]  #: (3,) angles of its joints 0, 1 and 2
    unit: str  #: of its joints
    sense: float  #: 1 where its joints count as those of the study, -1 where against
    #: (pins, points (n, 3)) its joints (n, 3), points in mm
    travels: Callable[[Array, Array], Array]


def _tower_heights(pins: Array, points: Array) -> Array:
    """Heights of the carriages: R is the radius, L the rods' length."""
    radius, rod = pins
    towers = radius * _circle(LINEAR_DEGREES)
    across = np.sum((points[:, None, :2] - towers) ** 2, axis=2)
    return np.asarray(points[:, 2:] + np.sqrt(rod**2 - across))


def _crank_angles(pins: Array, points: Array) -> Array:
    """Angles of the thighs, 0 outward, growing downward, degrees."""
    radius, thigh, shin = pins
    outward = _circle(ROTARY_DEGREES)
    along = points[:, :2] @ outward.T - radius
    sideways = points[:, :2] @ np.column_stack([-outward[:, 1], outward[:, 0]]).T
    down = -points[:, 2:]
    distance = np.hypot(along, down)
    reach = distance**2 + sideways**2 + thigh**2 - shin**2
    turn = np.arccos(reach / (2.0 * thigh * distance))
    return np.asarray(np.degrees(np.arctan2(down, along) - turn))


def _circle(degrees: tuple[float, float, float]) -> Array:
    angle = np.radians(degrees)
    return np.column_stack([np.cos(angle), np.sin(angle)])


LINEAR_DEGREES = (90.0, 210.0, 330.0)
ROTARY_DEGREES = (270.0, 150.0, 30.0)
LINEAR = DeltaModule(
    "lineardeltakins", ("R", "L"), LINEAR_DEGREES, "mm", -1.0, _tower_heights
)
ROTARY = DeltaModule(
    "rotarydeltakins",
    ("platformradius", "thighlength", "shinlength"),
    ROTARY_DEGREES,
    "deg",
    1.0,
    _crank_angles,
)


def delta_module(machine: Machine) -> DeltaModule | None:
    """The module for a delta; None where its limbs are elsewhere, or it is none."""
    names = {p.name for p in machine.parameters}
    if {"arm1", "angle1", "endstop1"} <= names:
        module = LINEAR
    elif {"b1x", "zero1", "r1"} <= names and len(machine.pose) == len(DELTA_LIMBS):
        module = ROTARY
    else:
        return None
    apart = _apart(module, machine)
    order = np.argmin(apart, axis=1)
    near = apart[np.arange(3), order].max() < LIMB_TOLERANCE_DEG
    return module if near and len(set(order.tolist())) == len(DELTA_LIMBS) else None


def _apart(module: DeltaModule, machine: Machine) -> Array:
    """How far (3, 3), in degrees, each joint of the module is from each limb."""
    nominal = {p.name: p.nominal for p in machine.parameters}
    if module is LINEAR:
        angles = np.array([nominal[f"angle{i}"] for i in DELTA_LIMBS])
    else:
        places = np.array([[nominal[f"b{i}{k}"] for k in "xy"] for i in DELTA_LIMBS])
        angles = np.arctan2(places[:, 1], places[:, 0])
    difference = np.array(module.degrees)[:, None] - np.degrees(angles)
    return np.asarray(np.abs((difference + 180.0) % 360.0 - 180.0))


def _limb_order(module: DeltaModule, machine: Machine) -> Index:
    """Limb of the study, from 0, of each joint of the module."""
    return np.asarray(np.argmin(_apart(module, machine), axis=1))


@dataclasses.dataclass(frozen=True)
class DeltaSetting:
    """Numbers of a module: pins, z of its origin (mm), and joints at zero (3,)."""

    pins: Array
    z: float
    at_zero: Array

    def joints(self, module: DeltaModule, order: Index, points: Array) -> Array:
        """Joints (n, 3) of the study, in the module's unit, at points (n, 3), mm."""
        travels = module.travels(self.pins, points - [0.0, 0.0, self.z])
        joints = np.empty_like(travels)
        joints[:, order] = module.sense * (travels - self.at_zero)
        return joints


def _fitted_delta(
    module: DeltaModule, content: Compensation, values: Array
) -> DeltaSetting:
    """The setting whose joints are nearest to the exact ones, by Gauss-Newton steps."""
    points = units.from_si(content.command, "mm")
    exact = compensated_joints(content.kinematics, content.command, values)
    wanted = units.from_si(exact, module.unit)
    order, vector = (
        _limb_order(module, content.machine),
        _delta_start(module, content, values),
    )
    for _ in range(SEARCH_STEPS):
        missed = _delta_setting(module, vector).joints(module, order, points) - wanted
        slopes = []
        for k in range(len(vector)):
            moved = vector + 1e-4 * np.eye(len(vector))[k]
            there = _delta_setting(module, moved).joints(module, order, points)
            slopes.append(((there - wanted) - missed).ravel() / 1e-4)
        step = np.linalg.lstsq(np.column_stack(slopes), missed.ravel(), rcond=1e-7)[0]
        vector = vector - step
        if np.abs(step).max() < 1e-9:
            break
    return _delta_setting(module, vector)


def _delta_setting(module: DeltaModule, vector: Array) -> DeltaSetting:
    """A setting from pins, joints at zero and, for cranks, the height of the shoulders."""
    count = len(module.pins)
    z = 0.0 if module is LINEAR else float(vector[-1])
    return DeltaSetting(vector[:count], z, vector[count : count + len(DELTA_LIMBS)])


def _delta_start(module: DeltaModule, content: Compensation, values: Array) -> Array:
    machine = content.machine

    def mean(stem: str, end: str = "") -> float:
        names = [f"{stem}{i}{end}" for i in DELTA_LIMBS]
        mm = units.from_si([values[machine.index(n)] for n in names], "mm")
        return float(np.mean(mm))

    if module is ROTARY:
        places = [
            [values[machine.index(f"b{i}{k}")] for k in "xy"] for i in DELTA_LIMBS
        ]
        radius = units.number(float(np.linalg.norm(places, axis=1).mean()), "mm")
        return np.array([radius, mean("r"), mean("l"), 0.0, 0.0, 0.0, mean("b", "z")])
    single = "radius" in {p.name for p in machine.parameters}
    radius = (
        mean("radius")
        if not single
        else units.number(float(values[machine.index("radius")]), "mm")
    )
    rod = mean("arm")
    top = mean("endstop") + (rod**2 - radius**2) ** 0.5
    return np.array([radius, rod, top, top, top])


def write_delta(compensation: Compensation) -> Texts:
    """HAL pins of the module; homes for the INI file."""
    machine = compensation.machine
    module = delta_module(machine)
    assert module is not None
    fitted = _fitted_delta(module, compensation, compensation.identified.values)
    nominal = _fitted_delta(module, compensation, machine.nominal)
    head = [f"# {sentence}" for sentence in compensation.comments]
    hal = [*head, f"# {module.name}: numbers fitted to the exact joints"]
    for name, value in zip(module.pins, fitted.pins, strict=True):
        hal.append(f"setp {module.name}.{name} {value:.6f}")
    if module is ROTARY:
        hal.append(f"setp {module.name}.footradius 0.000000")
        hal.append("# only platformradius less footradius counts")
    hal += ["# mm; z of the study is that of LinuxCNC plus this:"]
    hal += [f"# Z_OFFSET = {fitted.z:.6f}"]
    ini = [*head, f"# {module.unit} that a joint reads where that of the study is 0,"]
    ini.append("# and its change by calibration: add that to HOME_OFFSET of the joint")
    order = _limb_order(module, machine)
    changes = fitted.at_zero - nominal.at_zero
    for k, (zero, change) in enumerate(zip(fitted.at_zero, changes, strict=True)):
        ini += [f"[JOINT_{k}]", f"# {machine.joints[order[k]].name} of the study"]
        ini += [
            f"# JOINT_AT_ZERO = {zero:.6f}",
            f"# HOME_OFFSET_CHANGE = {change:+.6f}",
        ]
    return {".hal": "\n".join([*hal, ""]), ".ini": "\n".join([*ini, ""])}


def delta_joints(texts: Texts, compensation: Compensation) -> Array:
    """Joints of a controller with these pins and homes."""
    module = delta_module(compensation.machine)
    assert module is not None
    pins = {name: float(value) for name, value in DELTA_SETP.findall(texts[".hal"])}
    at_zero = [float(value) for value in AT_ZERO.findall(texts[".ini"])]
    z = float(Z_OFFSET.findall(texts[".hal"])[0])
    setting = DeltaSetting(
        np.array([pins[n] for n in module.pins]), z, np.array(at_zero)
    )
    points = units.from_si(compensation.command, "mm")
    order = _limb_order(module, compensation.machine)
    return units.to_si(setting.joints(module, order, points), module.unit)
