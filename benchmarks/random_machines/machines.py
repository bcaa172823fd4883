"""Random machines: their tables of a study, and where their tool stands in truth.

Five kinds are plain closures too, solved by Newton's method in NumPy. Nothing of these is
shared with the toolkit but the names of the parameters. A machine reads its joints from
the controller, which believes in the drawing, and stands where the true closure holds.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oed.mechanism import Kinematics
from oed.model import Machine

Array = np.ndarray
#: least and largest size of a machine of a family, m
SIZES = (0.1, 10.0)
#: what places depart by from those of the family's own machine, of its size
SHIFT = 0.05
#: parameter errors are normal, cut off at so many tolerances
CUT = 2.5
#: size, m, of each family's own machine
FAMILIES = {
    "cables_planar": 1.3,
    "cables_spatial": 2.5,
    "delta": 0.345,
    "hexapod_pus": 0.5,
    "hexapod_ups": 0.6,
    "tripod_passive_leg": 1.2,
    "tripod_prs": 0.8,
    "tripod_rps": 0.6,
}
#: size, m, of the machines that are what they are
FIXED = {
    "a3_head": 0.6,
    "cable_robot": 1.5,
    "hexaglide": 0.8,
    "hexapod": 0.6,
    "linear_delta": 0.345,
    "micro_cmm": 0.2,
    "planar_2dof": 3.35,
    "prs_spindle": 0.7,
    "prs_spindle_struts": 0.7,
}
MODELS = tuple(sorted([*FAMILIES, *FIXED]))
#: entries of geometry that are points of joints: these are where a builder puts them
POINTS = ("base", "platform", "guide", "anchor", "attach")


@dataclasses.dataclass(frozen=True)
class Drawn:
    """A machine to be read.

    model    name in the catalogue
    size     m
    table    `[machine]` of its study
    """

    model: str
    size: float
    table: Mapping[str, Any]


def draw(model: str, own: Machine, rng: np.random.Generator) -> Drawn:
    """A random machine of a model; `own` is the model's own machine."""
    if model in FIXED:
        return Drawn(model, FIXED[model], {"model": model})
    size = math.exp(rng.uniform(*np.log(SIZES)))
    scale = size / FAMILIES[model]
    geometry = _delta(scale, rng) if model == "delta" else _scaled(own, scale, rng)
    return Drawn(model, size, {"model": model, "geometry": geometry})


def _delta(scale: float, rng: np.random.Generator) -> dict[str, Any]:
    arm = 345.0 * scale
    return {
        "arm_mm": arm,
        "radius_mm": arm * rng.uniform(0.35, 0.6),
        "angle_deg": [d + rng.uniform(-5.0, 5.0) for d in (210.0, 330.0, 90.0)],
    }


def _scaled(own: Machine, scale: float, rng: np.random.Generator) -> dict[str, Any]:
    """Geometry of a family's own machine in another size, with its joints elsewhere."""
    assert own.family is not None
    size = FAMILIES[own.family.name]
    geometry = {}
    for dimension in own.family.dimensions:
        if dimension.default is None or dimension.unit != "m":
            continue
        value = np.asarray(dimension.default, dtype=float)
        if dimension.name in POINTS:
            moved = SHIFT * size * rng.uniform(-1.0, 1.0, value.shape)
            if dimension.name in ("platform", "attach"):
                moved *= 0.5
            value = value + moved
        geometry[f"{dimension.name}_mm"] = (1e3 * scale * value).tolist()
    return geometry


def parameter_errors(
    tolerance: Array, rng: np.random.Generator, share: float = 1.0
) -> Array:
    """Errors (n,) of parameters within their tolerances (n,)."""
    normal = np.clip(rng.standard_normal(len(tolerance)), -CUT, CUT)
    return np.asarray(share * tolerance * normal)


# -- plain closures -----------------------------------------------------------------------

Numbers = Mapping[str, float]
#: closure rows (n, k) at poses (n, k) and joints (n, k)
Closure = Callable[[Array, Array, Numbers], Array]
#: joints (n, k) that hold poses (n, k)
Inverse = Callable[[Array, Numbers], Array]
#: steps of Newton's method, and of its differences as a share of the machine's size
STEPS, DIFFERENCE = 30, 1e-6


@dataclasses.dataclass(frozen=True)
class PlainMachine:
    """A machine whose pose is its command.

    closure, inverse    as above
    turns               whether the pose has three turns, rad, after x, y, z
    planar              whether the pose is y and z
    """

    closure: Closure
    inverse: Inverse
    turns: bool = False
    planar: bool = False

    def tool(
        self, command: Array, nominal: Numbers, true: Numbers
    ) -> tuple[Array, Array]:
        """Tool points (n, 3) and rotations (n, 3, 3) of the true machine at commands."""
        joints = self.inverse(command, nominal)
        pose = _solve(lambda x: self.closure(x, joints, true), command)
        point = pose[:, :3]
        if self.planar:
            point = np.column_stack([np.zeros(len(pose)), pose])
        turns = pose[:, 3:] if self.turns else np.zeros((len(pose), 3))
        return point, rotations(turns)


def rotations(turns: Array) -> Array:
    """Rotations (n, 3, 3): a spin about the tool's axis, then a tilt (rx, ry, 0)."""
    tilt = np.column_stack([turns[:, :2], np.zeros(len(turns))])
    spin = Rotation.from_rotvec(turns[:, 2:] * np.array([[0.0, 0.0, 1.0]]))
    return (Rotation.from_rotvec(tilt) * spin).as_matrix()


def _solve(residual: Callable[[Array], Array], start: Array) -> Array:
    """Poses (n, k) where the residual (n, k) is zero, from a start. Raises ValueError."""
    pose = start.copy()
    for _ in range(STEPS):
        value = residual(pose)
        columns = []
        for k in range(pose.shape[1]):
            step = np.zeros(pose.shape[1])
            step[k] = DIFFERENCE
            ahead, behind = residual(pose + step), residual(pose - step)
            columns.append((ahead - behind) / (2.0 * DIFFERENCE))
        slope = np.stack(columns, axis=2)
        change = np.linalg.solve(slope, value[:, :, None])[:, :, 0]
        pose = pose - change
        if np.abs(change).max() < 1e-13 * max(1.0, float(np.abs(pose).max())):
            return pose
    raise ValueError("Newton's method does not converge")


def _each(p: Numbers, stem: str, count: int) -> Array:
    return np.array([p[f"{stem}{i + 1}"] for i in range(count)])


def _points(p: Numbers, stem: str, count: int) -> Array:
    return np.array([[p[f"{stem}{i + 1}{k}"] for k in "xyz"] for i in range(count)])


# -- deltas ----------------------------------------------------------------------------


def _towers(p: Numbers) -> tuple[Array, Array, Array, Array]:
    """Feet (3, 3), directions (3, 3), heights at travel 0 (3,), and arms (3,)."""
    angle, arm = _each(p, "angle", 3), _each(p, "arm", 3)
    radius = np.full(3, p["radius"]) if "radius" in p else _each(p, "radius", 3)
    tilted = "lean1" in p
    lean = _each(p, "lean", 3) if tilted else np.zeros(3)
    tip = _each(p, "tip", 3) if tilted else np.zeros(3)
    out = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(3)])
    side = np.column_stack([-np.sin(angle), np.cos(angle), np.zeros(3)])
    axis = lean[:, None] * out + tip[:, None] * side + np.array([0.0, 0.0, 1.0])
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    top = _each(p, "endstop", 3) + np.sqrt(arm**2 - radius**2)
    return radius[:, None] * out, axis, top, arm


def _delta_closure(x: Array, q: Array, p: Numbers) -> Array:
    foot, axis, top, arm = _towers(p)
    carriage = foot + (top - q)[:, :, None] * axis
    return np.asarray(np.linalg.norm(x[:, None] - carriage, axis=2) - arm)


def _delta_inverse(x: Array, p: Numbers) -> Array:
    foot, axis, top, arm = _towers(p)
    offset = x[:, None] - foot
    along = np.einsum("nik,ik->ni", offset, axis)
    across = (offset**2).sum(axis=2) - along**2
    return np.asarray(top - along - np.sqrt(arm**2 - across))


# -- extensible legs -------------------------------------------------------------------


def _hexapod_lengths(x: Array, p: Numbers) -> Array:
    foot, joint = _points(p, "b", 6), _points(p, "a", 6)
    turned = np.einsum("nkl,il->nik", rotations(x[:, 3:]), joint)
    strut = x[:, None, :3] + turned - foot
    return np.asarray(np.linalg.norm(strut, axis=2) - _each(p, "l", 6))


def _cmm_lengths(x: Array, p: Numbers) -> Array:
    ends = []
    for part in "fp":
        radius, angle = _each(p, f"r{part}", 3), _each(p, f"theta{part}", 3)
        flat = [radius * np.cos(angle), radius * np.sin(angle), np.zeros(3)]
        ends.append(np.column_stack(flat))
    strut = x[:, None] + ends[1] - ends[0]
    return np.asarray(np.linalg.norm(strut, axis=2) - _each(p, "dl", 3))


# -- two sliders in a plane ------------------------------------------------------------


def _sliders_closure(x: Array, q: Array, p: Numbers) -> Array:
    travel, tilt = q + _each(p, "z", 2), _each(p, "beta", 2)
    side = np.array([-0.5, 0.5]) * p["D"]
    across = x[:, :1] - side + travel * np.sin(tilt)
    up = x[:, 1:] - travel * np.cos(tilt)
    return np.asarray(np.hypot(across, up) - _each(p, "l", 2))


def _sliders_inverse(x: Array, p: Numbers) -> Array:
    """Of the drawing, whose guides are upright and whose zeros are right."""
    across = x[:, :1] - np.array([-0.5, 0.5]) * p["D"]
    return np.asarray(x[:, 1:] + np.sqrt(_each(p, "l", 2) ** 2 - across**2))


PLAIN = {
    "delta": PlainMachine(_delta_closure, _delta_inverse),
    "linear_delta": PlainMachine(_delta_closure, _delta_inverse),
    "hexapod_ups": PlainMachine(
        lambda x, q, p: _hexapod_lengths(x, p) - q, _hexapod_lengths, turns=True
    ),
    "micro_cmm": PlainMachine(lambda x, q, p: _cmm_lengths(x, p) - q, _cmm_lengths),
    "planar_2dof": PlainMachine(_sliders_closure, _sliders_inverse, planar=True),
}


# -- the true machine ---------------------------------------------------------------------


class Truth:
    """Where the tool of the true machine stands: `true` (np,) are its parameters.

    Five models have closures of their own; the others use the toolkit's kinematics.
    """

    def __init__(self, model: str, machine: Machine, true: Array) -> None:
        self.machine, self.true = machine, true
        self._plain = PLAIN.get(model)
        self.kinematics = Kinematics(machine)

    def joints(self, command: Array) -> Array:
        """Joints (n, nq) that the controller sends. Raises AssemblyError."""
        return self.kinematics.inverse(command)[1]

    def nominal(self, command: Array) -> tuple[Array, Array]:
        """Tool points (n, 3) and rotations (n, 3, 3) where the drawing has them."""
        pose, _ = self.kinematics.inverse(command)
        rotation, point, _ = self.kinematics.frames(pose, np.zeros(3))
        return point, rotation

    def tool(self, command: Array) -> tuple[Array, Array]:
        """Tool points (n, 3) and rotations (n, 3, 3) of the true machine."""
        if self._plain is None:
            pose, joints = self.kinematics.inverse(command)
            pose = self.kinematics.forward(joints, self.true, pose)
            rotation, point, _ = self.kinematics.frames(pose, np.zeros(3))
            return point, rotation
        names = [p.name for p in self.machine.parameters]
        nominal = dict(zip(names, self.machine.nominal, strict=True))
        true = dict(zip(names, self.true, strict=True))
        return self._plain.tool(command, nominal, true)
