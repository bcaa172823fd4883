"""Poses of a hexapod for many parameter vectors, beside a vectorised NumPy Newton.

    python benchmarks/poses.py

The alternative is written by hand for this machine: legs as arrays, exact slopes over a
twist of the platform, all poses in one call of `numpy.linalg.solve`, rotations updated
by Rodrigues' formula. Both start at the nominal poses and stop after a step below 1e-8.
Times are processor seconds on one thread: medians of pairs, one after the other.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import statistics
import time
from collections.abc import Callable

import numpy as np

from oed import newton
from oed.kinematics import Kinematics
from pkm_models.machines.hexapod import A, B, machine

COUNTS, PAIRS = (100, 1000, 10_000), 7
BASE_JOINTS = np.array(list(B.values()))
PLATFORM_JOINTS = np.array(list(A.values()))


def turn(rotation: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """Rotations (n, 3, 3) turned by rotation vectors (n, 3), by Rodrigues' formula."""
    angle = np.maximum(np.linalg.norm(vector, axis=1), 1e-300)[:, None, None]
    cross = np.zeros_like(rotation)
    cross[:, 0, 1], cross[:, 0, 2] = -vector[:, 2], vector[:, 1]
    cross[:, 1, 0], cross[:, 1, 2] = vector[:, 2], -vector[:, 0]
    cross[:, 2, 0], cross[:, 2, 1] = -vector[:, 1], vector[:, 0]
    square = cross @ cross
    change = np.sin(angle) / angle * cross + (1.0 - np.cos(angle)) / angle**2 * square
    return rotation + change @ rotation


def solve(
    point: np.ndarray, rotation: np.ndarray, q: np.ndarray, p: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Tool point (n, 3) and rotation (n, 3, 3) at joints (n, 6), parameters (n, 42)."""
    count = len(q)
    base = BASE_JOINTS + p[:, :18].reshape(count, 6, 3)
    platform = PLATFORM_JOINTS + p[:, 18:36].reshape(count, 6, 3)
    length = q + p[:, 36:]
    for _ in range(newton.MAX_ITERATIONS):
        arms = platform @ rotation.transpose(0, 2, 1)
        legs = point[:, None, :] + arms - base
        actual = np.sqrt(np.einsum("nik,nik->ni", legs, legs))
        unit = legs / actual[:, :, None]
        slopes = np.concatenate([unit, np.cross(arms, unit)], axis=2)
        step = np.linalg.solve(slopes, (length - actual)[:, :, None])[:, :, 0]
        point, rotation = point + step[:, :3], turn(rotation, step[:, 3:])
        if np.abs(step).max() < newton.STEP_TOLERANCE:
            break
    return point, rotation


def seconds(work: Callable[[], object]) -> float:
    """Processor time of one call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def main() -> None:
    """Print one row a number of poses: times a pose, their ratio, the difference."""
    kinematics, rng = Kinematics(machine), np.random.default_rng(0)
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    tolerance = np.array([p.tolerance for p in machine.parameters])
    print("| poses | this project, us | NumPy Newton, us | ratio | difference, m |")
    print("| --: | --: | --: | --: | --: |")
    for count in COUNTS:
        x, q = kinematics.inverse(rng.uniform(lower, upper, (count, 6)))
        p = tolerance * rng.standard_normal((count, len(tolerance)))
        rotation, point, _ = kinematics.frames(x, np.zeros(3))

        def ours(q: np.ndarray = q, p: np.ndarray = p, x: np.ndarray = x) -> np.ndarray:
            return kinematics.forward_per_pose(q, p, x)

        def by_numpy(
            point: np.ndarray = point,
            rotation: np.ndarray = rotation,
            q: np.ndarray = q,
            p: np.ndarray = p,
        ) -> tuple[np.ndarray, np.ndarray]:
            return solve(point, rotation, q, p)

        difference = np.abs(kinematics.frames(ours(), np.zeros(3))[1] - by_numpy()[0])
        pairs = [(seconds(ours), seconds(by_numpy)) for _ in range(PAIRS)]
        ratio = statistics.median(b / a for a, b in pairs if a)
        a, b = (
            1e6 * statistics.median(times) / count for times in zip(*pairs, strict=True)
        )
        print(f"| {count} | {a:.1f} | {b:.1f} | {ratio:.2f} | {difference.max():.0e} |")


if __name__ == "__main__":
    main()
