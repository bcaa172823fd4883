"""LinuxCNC's deltas: HAL of lineardeltakins and rotarydeltakins, and homes for the INI file.

Both modules have limbs alike and 120 degrees apart. Their few numbers are fitted to the
exact joints over the workspace, by least squares.
"""

import dataclasses
import re
from collections.abc import Callable

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.compensate import compensated_joints
from oed.model import Machine
from pkm_studies.catalogue import Compensation, Texts

#: limbs of the study may be this far, in degrees, from those of the module
LIMB_TOLERANCE_DEG = 10.0
SEARCH_STEPS = 20
LIMBS = (1, 2, 3)
AT_ZERO = re.compile(r"^# JOINT_AT_ZERO = (\S+)", re.MULTILINE)
SETP = re.compile(r"^setp \w+\.(\w+) (\S+)", re.MULTILINE)
Z_OFFSET = re.compile(r"^# Z_OFFSET = (\S+)", re.MULTILINE)


@dataclasses.dataclass(frozen=True)
class DeltaModule:
    """A kinematics module.

    name     of the module
    pins     its numbers
    degrees  (3,) angles of its joints 0, 1 and 2
    unit     of its joints
    sense    1 where its joints count as those of the study, -1 where against
    travels  (pins, points (n, 3)) its joints (n, 3), points in mm
    """

    name: str
    pins: tuple[str, ...]
    degrees: tuple[float, float, float]
    unit: str
    sense: float
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


def module_of(machine: Machine) -> DeltaModule | None:
    """The module for a delta; None where its limbs are elsewhere, or it is none."""
    names = {p.name for p in machine.parameters}
    if {"arm1", "angle1", "endstop1"} <= names:
        module = LINEAR
    elif {"b1x", "zero1", "r1"} <= names and len(machine.pose) == len(LIMBS):
        module = ROTARY
    else:
        return None
    apart = _apart(module, machine)
    order = np.argmin(apart, axis=1)
    near = apart[np.arange(3), order].max() < LIMB_TOLERANCE_DEG
    return module if near and len(set(order.tolist())) == len(LIMBS) else None


def _apart(module: DeltaModule, machine: Machine) -> Array:
    """How far (3, 3), in degrees, each joint of the module is from each limb."""
    nominal = {p.name: p.nominal for p in machine.parameters}
    if module is LINEAR:
        angles = np.array([nominal[f"angle{i}"] for i in LIMBS])
    else:
        places = np.array([[nominal[f"b{i}{k}"] for k in "xy"] for i in LIMBS])
        angles = np.arctan2(places[:, 1], places[:, 0])
    difference = np.array(module.degrees)[:, None] - np.degrees(angles)
    return np.asarray(np.abs((difference + 180.0) % 360.0 - 180.0))


def _order(module: DeltaModule, machine: Machine) -> Index:
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


def _fitted(module: DeltaModule, content: Compensation, values: Array) -> DeltaSetting:
    """The setting whose joints are nearest to the exact ones, by Gauss-Newton steps."""
    points = units.from_si(content.command, "mm")
    exact = compensated_joints(content.kinematics, content.command, values)
    wanted = units.from_si(exact, module.unit)
    order, vector = _order(module, content.machine), _start(module, content, values)
    for _ in range(SEARCH_STEPS):
        missed = _setting(module, vector).joints(module, order, points) - wanted
        slopes = []
        for k in range(len(vector)):
            moved = vector + 1e-4 * np.eye(len(vector))[k]
            there = _setting(module, moved).joints(module, order, points)
            slopes.append(((there - wanted) - missed).ravel() / 1e-4)
        step = np.linalg.lstsq(np.column_stack(slopes), missed.ravel(), rcond=1e-7)[0]
        vector = vector - step
        if np.abs(step).max() < 1e-9:
            break
    return _setting(module, vector)


def _setting(module: DeltaModule, vector: Array) -> DeltaSetting:
    """A setting from pins, joints at zero and, for cranks, the height of the shoulders."""
    count = len(module.pins)
    z = 0.0 if module is LINEAR else float(vector[-1])
    return DeltaSetting(vector[:count], z, vector[count : count + len(LIMBS)])


def _start(module: DeltaModule, content: Compensation, values: Array) -> Array:
    machine = content.machine

    def mean(stem: str, end: str = "") -> float:
        names = [f"{stem}{i}{end}" for i in LIMBS]
        mm = units.from_si([values[machine.index(n)] for n in names], "mm")
        return float(np.mean(mm))

    if module is ROTARY:
        places = [[values[machine.index(f"b{i}{k}")] for k in "xy"] for i in LIMBS]
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


def write(compensation: Compensation) -> Texts:
    """HAL pins of the module; homes for the INI file."""
    machine = compensation.machine
    module = module_of(machine)
    assert module is not None
    fitted = _fitted(module, compensation, compensation.identified.values)
    nominal = _fitted(module, compensation, machine.nominal)
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
    order = _order(module, machine)
    changes = fitted.at_zero - nominal.at_zero
    for k, (zero, change) in enumerate(zip(fitted.at_zero, changes, strict=True)):
        ini += [f"[JOINT_{k}]", f"# {machine.joints[order[k]].name} of the study"]
        ini += [
            f"# JOINT_AT_ZERO = {zero:.6f}",
            f"# HOME_OFFSET_CHANGE = {change:+.6f}",
        ]
    return {".hal": "\n".join([*hal, ""]), ".ini": "\n".join([*ini, ""])}


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joints of a controller with these pins and homes."""
    module = module_of(compensation.machine)
    assert module is not None
    pins = {name: float(value) for name, value in SETP.findall(texts[".hal"])}
    at_zero = [float(value) for value in AT_ZERO.findall(texts[".ini"])]
    z = float(Z_OFFSET.findall(texts[".hal"])[0])
    setting = DeltaSetting(
        np.array([pins[n] for n in module.pins]), z, np.array(at_zero)
    )
    points = units.from_si(compensation.command, "mm")
    order = _order(module, compensation.machine)
    return units.to_si(setting.joints(module, order, points), module.unit)
