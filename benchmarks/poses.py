"""Poses and readings in a loop, beside NumPy written by hand and beside solvers.

    python -m benchmarks.poses

The first column is this project as it comes, in a loop as a notebook's: its functions are
compiled beside the first calls, or found from an earlier run. The second has no compiler.
The alternatives (`numpy_poses`) are written for one machine each. Poses have parameters of
their own. Readings of the A3 head are those of a ball bar on two circles of fifteen points
and the taught cup, at each of several parameter vectors. All but the delta's closed form
start at the nominal poses and stop after a step below 1e-8. Times are processor seconds on
one thread: medians of rounds in which each takes its turn.

The second table has solvers that take one pose of the A3 head after the other, as a script
would: `casadi.rootfinder` and `scipy.optimize.root` with the exact Jacobian.
"""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeVar

import casadi as ca
import numpy as np
from scipy import optimize

from benchmarks.harness.tables import head, row
from benchmarks.numpy_poses import a3_readings, delta_poses, hexapod_poses
from oed.instrument import mount
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.mechanism import Kinematics, symbols
from oed.model import Machine
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head, delta, hexapod

COUNTS, ROUNDS = (1, 10, 100, 1000, 10_000, 100_000), 11
ROUND_SECONDS = 0.01  #: processor time of a round, s
LOOP_SECONDS = 4.0  #: time after which a function is compiled, in a loop of calls, s
VARIABLE = "OED_COMPILE"  #: when functions are compiled: never, or as it comes
NEVER = "0"
BY_DEFAULT = ""
NO_TOOL = np.zeros(3)
#: parameter vectors of a solver's loop, and of this project beside it
LOOP_VECTORS, VECTORS = 20, 1000

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
        given, start = (q, p, x), (point, rotation)
        ways = (
            ready(BY_DEFAULT, lambda a=given: kinematics.forward_per_pose(*a)),
            ready(NEVER, lambda a=given: plain.forward_per_pose(*a)),
            lambda a=given, start=start: by_hand(*a[:2], start),
        )
        yield Case(f"{machine.name}, poses", count, ways)


def a3_plan() -> tuple[Measurement, Series]:
    """The A3 head on two circles of fifteen points."""
    cup = mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))
    measurement = Measurement(a3_head.machine, [cup])
    angles = 2.0 * np.pi * np.arange(15) / 15
    command = np.array([[z, psi, 0.0] for z in (1.146, 1.266) for psi in angles])
    command, _ = commands_at_fixed_reading(measurement, "cup", command, "theta")
    return measurement, measurement.series("cup", command)


def a3_cases() -> Iterator[Case]:
    """Readings of the A3 head."""
    plain, series = as_set(NEVER, a3_plan)
    default, _ = as_set(BY_DEFAULT, a3_plan)
    n, rng = len(series.q), np.random.default_rng(0)
    rotation, point, _ = plain.kinematics.frames(series.start, NO_TOOL)
    for count in COUNTS[2:]:
        vectors = -(-count // n)
        spread = plain.tolerance * rng.standard_normal((vectors, len(plain.nominal)))
        theta = plain.nominal + spread
        ways = (
            ready(BY_DEFAULT, lambda theta=theta: default.readings([series], theta)),
            ready(NEVER, lambda theta=theta: plain.readings([series], theta)),
            lambda theta=theta: a3_readings(series.q, theta, (point, rotation)),
        )
        yield Case("A3 head, readings", vectors * n, ways)


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


def line(case: Case) -> str:
    """A line of the first table."""
    *ours, others = [work() for work in case.ways]
    errors = ", ".join(f"{difference(values, others):.0e}" for values in ours)
    rounds = [[seconds(work) for work in case.ways] for _ in range(ROUNDS)]
    medians = [statistics.median(times) for times in zip(*rounds, strict=True)]
    times = [f"{1e6 * median / case.count:.2f}" for median in medians]
    return row(case.name, case.count, *times, errors)


# -- solvers in a loop -----------------------------------------------------------------
def solvers() -> dict[str, Callable[..., np.ndarray]]:
    """Functions of start, joints and parameters that solve one pose of the A3 head."""
    x, xs = symbols("x", a3_head.machine.pose)
    q, qs = symbols("q", a3_head.machine.joints)
    p, ps = symbols("p", a3_head.machine.parameters)
    phi = ca.vertcat(*a3_head.machine.closure(xs, qs, ps))
    problem = {"x": x, "p": ca.vertcat(q, p), "g": phi}
    finder = ca.rootfinder("finder", "newton", problem, {"abstol": 1e-14})
    value = ca.Function("value", [x, q, p], [phi])
    slope = ca.Function("slope", [x, q, p], [ca.densify(ca.jacobian(phi, x))])

    def by_casadi(start: np.ndarray, *given: np.ndarray) -> np.ndarray:
        return np.asarray(finder(start, np.concatenate(given))).ravel()

    def by_scipy(start: np.ndarray, *given: np.ndarray) -> np.ndarray:
        return optimize.root(
            lambda z: np.asarray(value(z, *given)).ravel(),
            start,
            jac=lambda z: np.asarray(slope(z, *given)),
            tol=1e-13,
        ).x

    return {"casadi.rootfinder": by_casadi, "scipy.optimize.root": by_scipy}


def solver_lines() -> Iterator[str]:
    """Lines of the second table."""
    measurement, series = a3_plan()
    rng = np.random.default_rng(0)
    size = (VECTORS, len(measurement.nominal))
    spread = 0.3 * measurement.tolerance * rng.standard_normal(size)
    theta = (measurement.nominal + spread)[:, : len(a3_head.machine.parameters)]

    def ours() -> np.ndarray:
        return measurement.kinematics.forward(series.q, theta, series.start)

    poses = ours()
    yield row(
        "this project", f"{1e6 * seconds(ours) / (VECTORS * len(series.q)):.2f}", "-"
    )
    for name, solver in solvers().items():

        def loop(solver: Callable[..., np.ndarray] = solver) -> np.ndarray:
            pairs = list(zip(series.start, series.q, strict=True))
            few = theta[:LOOP_VECTORS]
            return np.array([[solver(s, q, p) for s, q in pairs] for p in few])

        error = np.abs(loop() - poses[:LOOP_VECTORS]).max()
        time_a_pose = 1e6 * seconds(loop) / (LOOP_VECTORS * len(series.q))
        yield row(name, f"{time_a_pose:.2f}", f"{error:.0e}")


def main() -> None:
    """Print both tables: times a pose, and differences."""
    os.environ["OMP_NUM_THREADS"] = "1"
    ways = ("default, us", "no compiler, us", "NumPy, us")
    print(head("computed", "poses", *ways, "differences"))
    cases = (
        pose_cases(hexapod.machine, lambda q, p, start: hexapod_poses(q, p, start)[0]),
        pose_cases(delta.machine, lambda q, p, _: delta_poses(q, p)),
        a3_cases(),
    )
    for some in cases:
        for case in some:
            print(line(case), flush=True)
    print("\n" + head("solver, in a loop", "us a pose", "difference, m"))
    for text in solver_lines():
        print(text, flush=True)


if __name__ == "__main__":
    main()
