"""An A3 head under a controller, in plain numpy: sessions of several rounds.

The joints of a command are those of the controller's own parameters, or nominal ones
with a table of corrections; the head is that of `oracles.a3_geometry`.
"""

from __future__ import annotations

import csv
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from oracles import a3_geometry as a3
from scipy.interpolate import RegularGridInterpolator

Array = NDArray[np.float64]
Joints = Callable[[Array, float], Array]
#: names in the study of the oracle's parameters, in its order
NAMES = (
    [f"dq{i}" for i in (1, 2, 3)]
    + [f"db{i}{k}" for i in (1, 2, 3) for k in "xyz"]
    + [f"da{i}{k}" for i in (1, 2, 3) for k in "xyz"]
    + [f"beta{i}" for i in (1, 2, 3)]
)
UNIT = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "rad": 1.0, "mrad": 1e-3, "deg": np.pi / 180}
STEPS, SMALL = 60, 1e-13  # m or rad
ARCSEC = np.pi / 180 / 3600
HOME = np.array([[a3.D + a3.C, 0.0, 0.0]])


def held(p: Array, q: Array, tool: float) -> Array:
    """What a controller holds of head p at joints q (n, 3): z, and the tilt's vector."""
    pose = a3.forward(p, q, tool)
    psi, theta, _ = a3.euler(pose.R)
    return np.stack([pose.tip[..., 2], theta * np.cos(psi), theta * np.sin(psi)], -1)


def target(command: Array) -> Array:
    z, psi, theta = command.T
    return np.stack([z, theta * np.cos(psi), theta * np.sin(psi)], -1)


def of_parameters(p: Array) -> Joints:
    """A controller that computes with parameters p (24,): chord steps on its head."""

    def joints(command: Array, tool: float) -> Array:
        q = a3.inverse_nominal(*command.T, tool)
        step = 1e-6
        slopes = np.stack(
            [
                (held(p, q + step * e, tool) - held(p, q - step * e, tool))
                for e in np.eye(3)
            ],
            -1,
        ) / (2 * step)
        for _ in range(STEPS):
            miss = target(command) - held(p, q, tool)
            change = np.linalg.solve(slopes, miss[..., None])[..., 0]
            q = q + change
            if np.abs(change).max() < SMALL:
                return q
        raise ArithmeticError("the controller does not converge")

    return joints


def of_json(path: Path) -> Joints:
    """The controller that computes with the parameters of a compensation.json."""
    rows = json.loads(path.read_text())["parameters"]
    p = [rows[n]["value"] * UNIT[rows[n]["unit"]] if n in rows else 0.0 for n in NAMES]
    return of_parameters(np.array(p))


def of_table(path: Path) -> Joints:
    """The controller that adds the corrections of a compensation.csv to nominal joints."""
    with path.open() as lines:
        rows = list(csv.DictReader(lines))
    with path.with_name(f"{path.stem}_grid.csv").open() as lines:
        axes = list(csv.DictReader(lines))
    factors = [UNIT[a["coordinate"].rpartition("_")[2]] for a in axes]
    knots = [
        np.linspace(float(a["first"]), float(a["last"]), int(a["count"])) * f
        for a, f in zip(axes, factors, strict=True)
    ]
    added = np.array(
        [[float(r[f"correction_q{i}_mm"]) for i in (1, 2, 3)] for r in rows]
    )
    table = RegularGridInterpolator(
        knots,
        1e-3 * added.reshape(*map(len, knots), 3),
        bounds_error=False,
        fill_value=None,
    )

    def joints(command: Array, tool: float) -> Array:
        assert tool == 0.0
        turned = command.copy()
        turned[:, 1] = knots[1][0] + np.mod(command[:, 1] - knots[1][0], 2 * np.pi)
        return a3.inverse_nominal(*command.T) + table(turned)

    return joints


def errors(
    truth: Array, joints: Joints, command: Array, *, home: bool = False
) -> Array:
    """Errors (n, 3) of z (m), psi and theta (rad) of head `truth` at commands.

    With `home`, zeroed at home: place in the base frame, orientation about the head.
    """
    pose = a3.forward(truth, joints(command, 0.0))
    z, turned = pose.tip[:, 2], pose.R
    if home:
        at_home = a3.forward(truth, joints(HOME, 0.0))
        z = z - at_home.tip[0, 2] + HOME[0, 0]
        turned = turned @ at_home.R[0].T
    psi, theta, _ = a3.euler(turned)
    turn = np.mod(psi - command[:, 1] + np.pi, 2 * np.pi) - np.pi
    return np.stack([z - command[:, 0], turn, theta - command[:, 2]], -1)


@dataclasses.dataclass(frozen=True)
class Session:
    """Positions read at commands (n, 3) with two tools, noise in m."""

    command: Array
    tools: dict[str, float]
    sigma: float

    def write(self, path: Path, truth: Array, joints: Joints, seed: int) -> Path:
        """Readings of head `truth` under a controller."""
        rng = np.random.default_rng(seed)
        rows = ["setup,run,order,z_mm,psi_deg,theta_deg,read_x_mm,read_y_mm,read_z_mm"]
        for setup, tool in self.tools.items():
            command = self.command + np.array([tool, 0.0, 0.0])
            tip = a3.forward(truth, joints(command, tool), tool).tip
            tip = tip + self.sigma * rng.standard_normal(tip.shape)
            shown = np.hstack([command * [1e3, 180 / np.pi, 180 / np.pi], 1e3 * tip])
            for k, values in enumerate(shown, 1):
                rows.append(f"{setup},all,{k}," + ",".join(f"{v:.9f}" for v in values))
        path.write_text("\n".join(rows) + "\n")
        return path
