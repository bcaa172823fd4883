"""The five machines of the benchmark, their legs, and poses by the exact closure."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.generator import a3, delta, hexaglide, hexapod, planar
from benchmarks.blind.generator.a3 import A3
from benchmarks.blind.generator.delta import DELTA
from benchmarks.blind.generator.hexaglide import HEXAGLIDE
from benchmarks.blind.generator.hexapod import HEXAPOD
from benchmarks.blind.generator.machine import Array, Machine, Pose, norm, slope
from benchmarks.blind.generator.planar import PLANAR

MACHINES = {m.name: m for m in (A3, PLANAR, DELTA, HEXAPOD, HEXAGLIDE)}
LEG_VECTORS = {
    "a3": a3.leg_vectors,
    "planar": planar.leg_vectors,
    "delta": delta.leg_vectors,
    "hexapod": hexapod.leg_vectors,
    "hexaglide": hexaglide.leg_vectors,
}


def joint_columns(machine: Machine, leg: int) -> tuple[list[int], list[int]]:
    """Columns of p that place a leg's base joint (or carriage) and platform joint.

    Empty where none do.
    """
    if machine.name == "a3":
        return [3 + 3 * leg + k for k in range(3)], [12 + 3 * leg + k for k in range(3)]
    if machine.name == "hexapod":
        return [3 * leg + k for k in range(3)], [18 + 3 * leg + k for k in range(3)]
    if machine.name == "hexaglide":
        return [leg, 6 + 2 * leg, 7 + 2 * leg], [18 + 3 * leg + k for k in range(3)]
    if machine.name == "planar":
        return [7 + leg, 1 + leg], []
    return [10 + leg, 13 + leg, 7 + leg], []


def leg_direction(machine: Machine, pose: Pose) -> Array:
    """Unit vectors (n, legs, 3) of the nominal machine's legs towards the platform."""
    v = LEG_VECTORS[machine.name](pose)
    return v / norm(v)[..., None]


def settle(
    machine: Machine, start: Array, R0: Array, q: Array, p: Array
) -> tuple[Array, Array]:
    """Pose x (n, nx) that closes the machine, by Newton.

    The second result is the inverse (n, nx, nx) of the last slope. Raises ArithmeticError where it does not converge.
    """
    x = start
    for _ in range(12):
        inverse = np.linalg.inv(slope(lambda v: machine.closure(v, R0, q, p), x))
        step = np.einsum("nij,nj->ni", inverse, machine.closure(x, R0, q, p))
        x = x - step
        if np.abs(step).max() < 1e-9:
            last = machine.closure(x, R0, q, p)
            return x - np.einsum("nij,nj->ni", inverse, last), inverse
    raise ArithmeticError(
        f"{machine.name}: the pose does not settle ({np.abs(step).max():.1e})"
    )


def nearby(
    machine: Machine, start: Array, inverse: Array, R0: Array, q: Array, p: Array
) -> Array:
    """As `settle`, for small changes of q and p, with a fixed slope.

    Raises ArithmeticError.
    """
    x = start
    for _ in range(40):
        step = np.einsum("nij,nj->ni", inverse, machine.closure(x, R0, q, p))
        x = x - step
        if np.abs(step).max() < 1e-13:
            return x
    raise ArithmeticError(
        f"{machine.name}: the disturbed pose does not settle ({np.abs(step).max():.1e})"
    )
