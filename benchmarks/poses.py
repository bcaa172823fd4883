"""Poses, readings and slopes, beside vectorised NumPy written by hand.

    python benchmarks/poses.py

The alternatives (`numpy_poses`) are written for one machine each. Poses of the hexapod
have parameters of their own. Those of the A3 head are of 31 poses, ball-bar readings on
two circles and the taught cup, at each of several parameter vectors. Both sides start
at the nominal poses and stop after a step below 1e-8. Times are processor seconds on
one thread: medians of pairs, one after the other.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import statistics
import time
from collections.abc import Callable, Iterator

import numpy as np

from numpy_poses import a3_poses, a3_readings, hexapod_poses
from oed.mechanism.kinematics import Kinematics
from pkm_models.machines.hexapod import machine
from readings import plan

COUNTS, PAIRS = (100, 1000, 10_000), 7
NO_TOOL = np.zeros(3)

Work = Callable[[], np.ndarray]
#: what is computed, number of poses, this project's way, the alternative
Case = tuple[str, int, Work, Work]


def hexapod_cases() -> Iterator[Case]:
    """Poses of the hexapod, each with parameters of its own."""
    kinematics, rng = Kinematics(machine), np.random.default_rng(0)
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    tolerance = np.array([p.tolerance for p in machine.parameters])
    for count in COUNTS:
        x, q = kinematics.inverse(rng.uniform(lower, upper, (count, 6)))
        p = tolerance * rng.standard_normal((count, len(tolerance)))
        rotation, point, _ = kinematics.frames(x, NO_TOOL)

        def ours(q: np.ndarray = q, p: np.ndarray = p, x: np.ndarray = x) -> np.ndarray:
            return kinematics.forward_per_pose(q, p, x)

        def by_numpy(
            q: np.ndarray = q,
            p: np.ndarray = p,
            start: tuple[np.ndarray, np.ndarray] = (point, rotation),
        ) -> np.ndarray:
            return hexapod_poses(q, p, start)[0]

        yield "hexapod, poses", count, ours, by_numpy


def a3_cases() -> Iterator[Case]:
    """Poses, readings and slopes of the A3 head."""
    measurement, series = plan()
    kinematics, n = measurement.kinematics, len(series.q)
    rotation, point, _ = kinematics.frames(series.start, NO_TOOL)
    start, rng = (point, rotation), np.random.default_rng(0)
    for count in COUNTS:
        vectors = -(-count // n)
        spread = measurement.tolerance * rng.standard_normal(
            (vectors, len(measurement.nominal))
        )
        theta = measurement.nominal + spread
        p, q = theta[:, :24], series.q
        tiled = np.tile(point, (vectors, 1)), np.tile(rotation, (vectors, 1, 1))
        every = np.tile(q, (vectors, 1)), np.repeat(p, n, axis=0), tiled

        def poses(p: np.ndarray = p) -> np.ndarray:
            return kinematics.forward(series.q, p, series.start).reshape(-1, 6)

        def by_numpy(every: tuple = every) -> np.ndarray:
            return a3_poses(*every)[0]

        yield "A3 head, poses", vectors * n, poses, by_numpy

        def readings(theta: np.ndarray = theta) -> np.ndarray:
            return measurement.readings([series], theta)

        def readings_by_numpy(theta: np.ndarray = theta) -> np.ndarray:
            return a3_readings(series.q, theta, start, slopes=False)[0]

        yield "A3 head, readings", vectors * n, readings, readings_by_numpy

        def slopes(theta: np.ndarray = theta) -> np.ndarray:
            return measurement.jacobian([series], theta)

        def slopes_by_numpy(theta: np.ndarray = theta) -> np.ndarray:
            return a3_readings(series.q, theta, start, slopes=True)[1]

        yield "A3 head, slopes", vectors * n, slopes, slopes_by_numpy


def seconds(work: Work) -> float:
    """Processor time of one call."""
    start = time.process_time()
    work()
    return time.process_time() - start


def difference(ours: np.ndarray, others: np.ndarray) -> float:
    """Largest difference; of poses, that of their tool points."""
    return float(np.abs(ours[..., : others.shape[-1]] - others).max())


def main() -> None:
    """Print one row a case: times a pose, their ratio, the difference."""
    print("| computed | poses | this project, us | NumPy, us | ratio | difference |")
    print("| --- | --: | --: | --: | --: | --: |")
    for name, count, ours, others in (*hexapod_cases(), *a3_cases()):
        error = difference(ours(), others())
        pairs = [(seconds(ours), seconds(others)) for _ in range(PAIRS)]
        ratio = statistics.median(b / a for a, b in pairs if a)
        a, b = (
            1e6 * statistics.median(times) / count for times in zip(*pairs, strict=True)
        )
        print(f"| {name} | {count} | {a:.1f} | {b:.1f} | {ratio:.2f} | {error:.0e} |")


if __name__ == "__main__":
    main()
