"""A delta as it is built: six rods, an effector that tilts, a bed that leans, a probe beside.

Each carriage has an axis with two joints, the effector a side with two joints for each
tower; a rod joins each pair. The pose of the effector solves the six lengths. Nothing of
the toolkit's model enters: neither its closure nor a tilt to first order.
"""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from oracles.firmware.geometry import BASE, Firmware

#: mm: half the spacing of a pair of rods, from the middle of the effector to its sides,
#: from their plane down to the nozzle
HALF, SIDE, DOWN = 25.0, 30.0, 20.0


def _turned(angles) -> tuple[np.ndarray, np.ndarray]:
    """Directions (3, 3) outward at angles, and tangential; deg."""
    a = np.radians(angles)
    zero = np.zeros_like(a)
    outward = np.column_stack([np.cos(a), np.sin(a), zero])
    return outward, np.column_stack([-np.sin(a), np.cos(a), zero])


@dataclasses.dataclass
class SixRods:
    """Numbers by tower (3,); mm, deg."""

    radius: float  #: of a delta firmware: to the carriages' joints, less the effector's
    arm: float
    angles: np.ndarray
    #: height of the nozzle at each switch, of a printer without tilts
    endstops: np.ndarray
    turns: np.ndarray  #: of the carriages' axes about z, rad
    pairs: np.ndarray  #: by how much the first rod of a pair is longer than the second
    lean: np.ndarray  #: (2,) rise of the bed along x and y

    def poses(self, travels) -> tuple[np.ndarray, Rotation]:
        """Nozzles (n, 3) and orientations (n,) of the effector at travels (n, 3)."""
        travels = np.atleast_2d(travels)
        outward, _ = _turned(self.angles)
        _, axes = _turned(BASE + np.degrees(self.turns))
        sides, edges = _turned(BASE)
        top = self.endstops + DOWN + np.sqrt(self.arm**2 - self.radius**2)
        middle = (self.radius + SIDE) * outward + top[:, None] * [0.0, 0.0, 1.0]
        middle = middle - travels[:, :, None] * [0.0, 0.0, 1.0]
        carriage = np.concatenate([middle + HALF * axes, middle - HALF * axes], axis=1)
        effector = np.concatenate(
            [SIDE * sides + HALF * edges, SIDE * sides - HALF * edges]
        )
        lengths = self.arm + np.concatenate([self.pairs, -self.pairs]) / 2.0
        pose = np.zeros((len(travels), 6))
        # the nozzle is about where the lowest carriage has it over the middle
        pose[:, 2] = (top - travels).min(axis=1) - np.sqrt(self.arm**2 - self.radius**2)
        for _ in range(60):
            rods = (
                pose[:, None, :3]
                + np.einsum(
                    "nij,kj->nki",
                    Rotation.from_rotvec(pose[:, 3:]).as_matrix(),
                    effector,
                )
                - carriage
            )
            misses = np.linalg.norm(rods, axis=2) - lengths
            along = rods / np.linalg.norm(rods, axis=2, keepdims=True)
            arms = np.einsum(
                "nij,kj->nki", Rotation.from_rotvec(pose[:, 3:]).as_matrix(), effector
            )
            slopes = np.concatenate([along, np.cross(arms, along)], axis=2)
            step = np.linalg.solve(slopes, misses[..., None])[..., 0]
            turn = Rotation.from_rotvec(-step[:, 3:]) * Rotation.from_rotvec(
                pose[:, 3:]
            )
            pose[:, :3] -= step[:, :3]
            pose[:, 3:] = turn.as_rotvec()
            if np.abs(step).max() < 1e-12:
                break
        rotation = Rotation.from_rotvec(pose[:, 3:])
        return pose[:, :3] + rotation.apply([0.0, 0.0, -DOWN]), rotation

    def over_bed(self, points: np.ndarray) -> np.ndarray:
        """Heights (n,) of points (n, 3) over the bed."""
        return points[:, 2] - points[:, :2] @ self.lean

    def tip(self, travels, probe: np.ndarray) -> np.ndarray:
        """Where the tip (n, 3) of a probe at (3,) of the nozzle is."""
        nozzle, rotation = self.poses(travels)
        return nozzle + rotation.apply(probe)

    def contacts(self, firmware: Firmware, probe: np.ndarray, places) -> np.ndarray:
        """Heights (n,) that a firmware believes in where the probe touches the bed.

        places  (n, 2) of the nozzle, as commanded
        """
        places = np.atleast_2d(np.asarray(places, float))
        z = np.full(len(places), -probe[2])
        for _ in range(30):
            travels = firmware.travel(np.column_stack([places, z]))
            gap = self.over_bed(self.tip(travels, probe))
            z = z - gap
            if np.abs(gap).max() < 1e-11:
                break
        return z

    def trigger_height(self, firmware: Firmware, probe: np.ndarray) -> float:
        """What a user measures in the middle: contact of the probe less that of the nozzle."""
        middle = np.zeros((1, 2))
        touched = self.contacts(firmware, np.zeros(3), middle)[0]
        return float(self.contacts(firmware, probe, middle)[0] - touched)
