"""Rotations as CasADi expressions, smooth over the whole working range; directions across."""

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Expr


def tilt_torsion(rx: Expr, ry: Expr, spin: Expr) -> Expr:
    """Rotation (3 x 3): a spin about the tool axis, then a tilt by the rotation vector
    (rx, ry, 0).

    With precession psi and nutation theta, (rx, ry) = theta (cos psi, sin psi) and R
    equals the z-x-z Euler product Rz(psi) Rx(theta) Rz(phi) with phi = spin - psi.
    Unlike Euler angles it is regular at theta = 0.
    """
    square = rx**2 + ry**2
    small = square < 1e-6  # series there: exact to rounding, second derivatives too
    safe = ca.if_else(small, 1.0, square)
    angle = ca.sqrt(safe)
    a = ca.if_else(
        small, 1.0 - square / 6.0 * (1.0 - square / 20.0), ca.sin(angle) / angle
    )
    b = ca.if_else(
        small,
        0.5 - square / 24.0 * (1.0 - square / 30.0),
        2.0 * ca.sin(angle / 2.0) ** 2 / safe,
    )
    c = 1.0 - b * square
    tilt = ca.vertcat(
        ca.horzcat(c + b * rx * rx, b * rx * ry, a * ry),
        ca.horzcat(b * rx * ry, c + b * ry * ry, -a * rx),
        ca.horzcat(-a * ry, a * rx, c),
    )
    return tilt @ z_rotation(spin)


def z_rotation(angle: Expr) -> Expr:
    """Rotation (3 x 3) about z."""
    cos, sin = ca.cos(angle), ca.sin(angle)
    return ca.vertcat(
        ca.horzcat(cos, -sin, 0), ca.horzcat(sin, cos, 0), ca.horzcat(0, 0, 1)
    )


def across(directions: Array) -> Array:
    """Two unit vectors (n, 2, 3) across each direction (n, 3)."""
    pairs = []
    for u in directions:
        axis = np.eye(3)[int(np.argmin(np.abs(u)))]
        first = np.cross(u, axis)
        first /= np.linalg.norm(first)
        pairs.append((first, np.cross(u, first)))
    return np.array(pairs)
