"""Random machines: their tables of a study, and where their tool stands in truth.

A machine reads its joints from the controller, which believes in the drawing, and stands
where the closure with its true parameters holds. Poses are by the toolkit's kinematics:
what is asked here is what noise and plans do to a diagnosis (`benchmarks.coverage` and
`benchmarks.blind` have closures of their own).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oed.mechanism import Kinematics
from oed.model import Machine

Array = np.ndarray
SIZES = (0.1, 10.0)  #: least and largest size of a machine of a family, m
#: what places depart by from those of the family's own machine, of its size
SHIFT = 0.05
CUT = 2.5  #: parameter errors are normal, cut off at so many tolerances
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
    """A machine to be read."""

    model: str  #: name in the catalogue
    size: float  #: m
    table: Mapping[str, Any]  #: `[machine]` of its study


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


def rotations(turns: Array) -> Array:
    """Rotations (n, 3, 3): a spin about the tool's axis, then a tilt (rx, ry, 0)."""
    tilt = np.column_stack([turns[:, :2], np.zeros(len(turns))])
    spin = Rotation.from_rotvec(turns[:, 2:] * np.array([[0.0, 0.0, 1.0]]))
    return (Rotation.from_rotvec(tilt) * spin).as_matrix()


# -- the true machine ---------------------------------------------------------------------
class Truth:
    """Where the tool of the true machine stands: `true` (np,) are its parameters."""

    def __init__(self, machine: Machine, true: Array) -> None:
        self.true = true
        self.kinematics = Kinematics(machine)

    def joints(self, command: Array) -> Array:
        """Joints (n, nq) that the controller sends. Raises AssemblyError."""
        return self.kinematics.inverse(command)[1]

    def nominal(self, command: Array) -> tuple[Array, Array]:
        """Tool points (n, 3) and rotations (n, 3, 3) where the drawing has them."""
        return self._frames(self.kinematics.inverse(command)[0])

    def tool(self, command: Array) -> tuple[Array, Array]:
        """Tool points (n, 3) and rotations (n, 3, 3) of the true machine."""
        pose, joints = self.kinematics.inverse(command)
        return self._frames(self.kinematics.forward(joints, self.true, pose))

    def _frames(self, pose: Array) -> tuple[Array, Array]:
        rotation, point, _ = self.kinematics.frames(pose, np.zeros(3))
        return point, rotation
