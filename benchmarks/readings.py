"""Readings of many parameter vectors at once, against a Python loop over poses. Ratios,
from one run.

    python benchmarks/readings.py

The named alternatives solve the same closure to the same tolerance, one pose after the
other: `casadi.rootfinder` (its own Newton) and `scipy.optimize.root` with the exact
Jacobian, both called in a loop, as a script would. Times are processor seconds on one
thread.
"""

from __future__ import annotations

import os

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # before NumPy is loaded

import statistics
import time
from collections.abc import Callable

import casadi as ca
import numpy as np
from scipy import optimize

from oed.instrument import mount
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.mechanism import symbols
from pkm_models.instruments import ball_bar
from pkm_models.machines.a3_head import machine

VECTORS, SLICE, REPEATS = 1000, 20, 3


def plan() -> tuple[Measurement, Series]:
    """The A3 head on two circles of fifteen points."""
    measurement = Measurement(
        machine, [mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))]
    )
    angles = 2.0 * np.pi * np.arange(15) / 15
    command = np.array([[z, psi, 0.0] for z in (1.146, 1.266) for psi in angles])
    command, _ = commands_at_fixed_reading(measurement, "cup", command, "theta")
    return measurement, measurement.series("cup", command)


def loop_casadi(series: Series, parameters: np.ndarray) -> np.ndarray:
    """Poses by casadi.rootfinder, one call a pose."""
    x, q, p, phi = _closure()
    finder = ca.rootfinder(
        "finder", "newton", {"x": x, "p": ca.vertcat(q, p), "g": phi}, {"abstol": 1e-14}
    )
    starts = list(zip(series.start, series.q, strict=True))
    return np.array(
        [
            [
                np.asarray(finder(s, np.concatenate([joints, row]))).ravel()
                for s, joints in starts
            ]
            for row in parameters
        ]
    )


def loop_scipy(series: Series, parameters: np.ndarray) -> np.ndarray:
    """Poses by scipy.optimize.root with the exact Jacobian, one call a pose."""
    x, q, p, phi = _closure()
    value = ca.Function("value", [x, q, p], [phi])
    slope = ca.Function("slope", [x, q, p], [ca.densify(ca.jacobian(phi, x))])

    def pose(start: np.ndarray, joints: np.ndarray, row: np.ndarray) -> np.ndarray:
        return optimize.root(
            lambda z: np.asarray(value(z, joints, row)).ravel(),
            start,
            jac=lambda z: np.asarray(slope(z, joints, row)),
            tol=1e-13,
        ).x

    starts = list(zip(series.start, series.q, strict=True))
    return np.array(
        [[pose(s, joints, row) for s, joints in starts] for row in parameters]
    )


def _closure() -> tuple[ca.SX, ca.SX, ca.SX, ca.SX]:
    x, xs = symbols("x", machine.pose)
    q, qs = symbols("q", machine.joints)
    p, ps = symbols("p", machine.parameters)
    return x, q, p, ca.vertcat(*machine.closure(xs, qs, ps))


def seconds(work: Callable[[], object]) -> float:
    """Median processor time of a few runs after a warm-up."""
    work()
    times = []
    for _ in range(REPEATS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return statistics.median(times)


def main() -> None:
    """Print one row an alternative: microseconds a pose, and the ratio to ours."""
    measurement, series = plan()
    rng = np.random.default_rng(0)
    theta = measurement.nominal + 0.3 * measurement.tolerance * rng.standard_normal(
        (VECTORS, len(measurement.nominal))
    )
    parameters = theta[:, : len(machine.parameters)]
    ours = measurement.kinematics.forward(series.q, parameters, series.start)
    poses = VECTORS * len(series.q)
    own = (
        seconds(
            lambda: measurement.kinematics.forward(series.q, parameters, series.start)
        )
        / poses
    )
    print(f"{'this kernel, batched':34s} {own * 1e6:9.2f} us a pose")
    for name, loop in (
        ("casadi.rootfinder in a loop", loop_casadi),
        ("scipy.optimize.root in a loop", loop_scipy),
    ):
        few = parameters[:SLICE]
        error = np.abs(loop(series, few) - ours[:SLICE]).max()
        other = seconds(lambda few=few, loop=loop: loop(series, few)) / (
            SLICE * len(series.q)
        )
        print(
            f"{name:34s} {other * 1e6:9.2f} us a pose, {other / own:6.1f} times ours,"
            f" differs by {error:.0e} m"
        )


if __name__ == "__main__":
    main()
