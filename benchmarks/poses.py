"""Poses, readings and slopes in a loop, beside vectorised NumPy written by hand.

    python benchmarks/poses.py

The first column is this project as it comes, in a loop as a notebook's: its functions are
compiled beside the first calls, or found from an earlier run. The second has no compiler.
The alternatives (`numpy_poses`) are written for one machine each. Poses have parameters of
their own. Those of the A3 head are of 31 poses, ball-bar readings on two circles and the
taught cup, at each of several parameter vectors. All but the delta's closed form start at
the nominal poses and stop after a step below 1e-8. Times are processor seconds on one
thread: medians of rounds in which each takes its turn.
"""

from __future__ import annotations

import os

from oed.mechanism import Kinematics

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import statistics
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import numpy as np

from numpy_poses import a3_poses, a3_readings, delta_poses, hexapod_poses
from oed.measurement import Measurement, Series
from oed.model import Machine
from pkm_models.machines import delta, hexapod
from readings import plan

COUNTS, ROUNDS = (1, 10, 100, 1000, 10_000, 100_000), 11
#: processor time of a round, s
ROUND_SECONDS = 0.01
#: time after which a function is compiled, in a loop of calls, s
LOOP_SECONDS = 4.0
CORES = "OMP_NUM_THREADS"
#: when functions are compiled: never, or as it comes
VARIABLE = "OED_COMPILE"
NEVER = "0"
BY_DEFAULT = ""
NO_TOOL = np.zeros(3)

Work = Callable[[], np.ndarray]
Result = TypeVar("Result")


class Case(NamedTuple):
    """What is computed, at how many poses, and the ways: default, no compiler, NumPy."""

    name: str
    count: int
    ways: tuple[Work, Work, Work]


def pose_cases(machine: Machine, by_hand: Callable[..., np.ndarray]) -> Iterator[Case]:
    """Poses of a machine, each with parameters of its own.

    by_hand  of joints, parameters, and points and rotations to start from
    """
    rng = np.random.default_rng(0)
    kinematics = as_set(BY_DEFAULT, lambda: Kinematics(machine))
    plain = as_set(NEVER, lambda: Kinematics(machine))
    lower = np.array([c.lower for c in machine.command])
    upper = np.array([c.upper for c in machine.command])
    tolerance = np.array([p.tolerance for p in machine.parameters])
    for count in COUNTS:
        x, q = plain.inverse(rng.uniform(lower, upper, (count, len(lower))))
        p = machine.nominal + tolerance * rng.standard_normal((count, len(tolerance)))
        rotation, point, _ = plain.frames(x, NO_TOOL)

        def poses(
            kinematics: Kinematics,
            q: np.ndarray = q,
            p: np.ndarray = p,
            x: np.ndarray = x,
        ) -> np.ndarray:
            return kinematics.forward_per_pose(q, p, x)

        def by_numpy(
            q: np.ndarray = q,
            p: np.ndarray = p,
            start: tuple[np.ndarray, np.ndarray] = (point, rotation),
        ) -> np.ndarray:
            return by_hand(q, p, start)

        ways = (
            ready(BY_DEFAULT, lambda f=poses: f(kinematics)),
            ready(NEVER, lambda f=poses: f(plain)),
            by_numpy,
        )
        yield Case(f"{machine.name}, poses", count, ways)


def a3_cases() -> Iterator[Case]:
    """Poses, readings and slopes of the A3 head."""
    plain, series = as_set(NEVER, plan)
    default, _ = as_set(BY_DEFAULT, plan)
    n, rng = len(series.q), np.random.default_rng(0)
    rotation, point, _ = plain.kinematics.frames(series.start, NO_TOOL)
    for count in COUNTS[2:]:
        vectors = -(-count // n)
        spread = plain.tolerance * rng.standard_normal((vectors, len(plain.nominal)))
        theta = plain.nominal + spread
        by_numpy = a3_by_numpy(series, theta, (point, rotation))
        for name, by_project in a3_by_project(series, theta).items():
            ways = (
                ready(BY_DEFAULT, lambda f=by_project: f(default)),
                ready(NEVER, lambda f=by_project: f(plain)),
                by_numpy[name],
            )
            yield Case(f"A3 head, {name}", vectors * n, ways)


def a3_by_project(
    series: Series, theta: np.ndarray
) -> dict[str, Callable[[Measurement], np.ndarray]]:
    """What is computed of the A3 head at parameters theta (m, 27)."""

    def poses(measurement: Measurement) -> np.ndarray:
        kinematics = measurement.kinematics
        return kinematics.forward(series.q, theta[:, :24], series.start).reshape(-1, 6)

    return {
        "poses": poses,
        "readings": lambda measurement: measurement.readings([series], theta),
        "slopes": lambda measurement: measurement.jacobian([series], theta),
    }


def a3_by_numpy(
    series: Series, theta: np.ndarray, start: tuple[np.ndarray, np.ndarray]
) -> dict[str, Work]:
    """The same by hand, from points (n, 3) and rotations (n, 3, 3)."""
    m, (n, _) = len(theta), series.q.shape
    q, p = np.tile(series.q, (m, 1)), np.repeat(theta[:, :24], n, axis=0)
    tiled = np.tile(start[0], (m, 1)), np.tile(start[1], (m, 1, 1))
    return {
        "poses": lambda: a3_poses(q, p, tiled)[0],
        "readings": lambda: a3_readings(series.q, theta, start, slopes=False)[0],
        "slopes": lambda: a3_readings(series.q, theta, start, slopes=True)[1],
    }


def as_set(setting: str, build: Callable[[], Result]) -> Result:
    """What is built with the compiler at work or not: its functions keep the setting."""
    os.environ[VARIABLE] = setting
    try:
        return build()
    finally:
        del os.environ[VARIABLE]


def ready(setting: str, work: Work) -> Work:
    """The work, with the functions that a loop of it makes."""
    end = time.monotonic() + (LOOP_SECONDS if setting == BY_DEFAULT else 0.0)
    as_set(setting, work)
    while time.monotonic() < end:
        work()
    return work


def seconds(work: Work) -> float:
    """Processor time of one call."""
    start, calls = time.process_time(), 0
    while calls == 0 or time.process_time() - start < ROUND_SECONDS:
        work()
        calls += 1
    return (time.process_time() - start) / calls


def difference(ours: np.ndarray, others: np.ndarray) -> float:
    """Largest difference; of poses, that of their tool points."""
    return float(np.abs(ours[..., : others.shape[-1]] - others).max())


def main() -> None:
    """Print one row a case: times a pose, ratios to NumPy, differences from it."""
    os.environ[CORES] = "1"
    cases = [
        *pose_cases(hexapod.machine, lambda q, p, start: hexapod_poses(q, p, start)[0]),
        *pose_cases(delta.machine, lambda q, p, _: delta_poses(q, p)),
        *a3_cases(),
    ]
    print(
        "| computed | poses | default, us | no compiler, us | NumPy, us |"
        " NumPy / default | NumPy / no compiler | differences |"
    )
    print("| --- | --: | --: | --: | --: | --: | --: | --: |")
    for case in cases:
        print(row(case), flush=True)


def row(case: Case) -> str:
    """Processor time of the three ways on one thread."""
    *ours, others = [work() for work in case.ways]
    errors = ", ".join(f"{difference(values, others):.0e}" for values in ours)
    rounds = [[seconds(work) for work in case.ways] for _ in range(ROUNDS)]
    by_way = [
        1e6 * statistics.median(times) / case.count
        for times in zip(*rounds, strict=True)
    ]
    ratios = [
        statistics.median(times[2] / times[k] for times in rounds) for k in (0, 1)
    ]
    cells = [f"{t:.2f}" for t in by_way] + [f"{ratio:.1f}" for ratio in ratios]
    return f"| {case.name} | {case.count} | {' | '.join(cells)} | {errors} |"


if __name__ == "__main__":
    main()
