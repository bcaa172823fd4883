"""Oracle for the 3-PRS spindle head (Wang and Fan, Int. J. Mach. Tools Manuf. 44 (2004)
1171-1178), SI (m, rad).

The inverse is the nominal machine's closed form: tan gamma = -sin alpha sin beta / (cos
alpha + cos beta), x and y from two of the three planes. The forward solver works on
three swing angles of the struts and three sides of the triangle of ball joints, and
never on a platform pose: it shares neither code nor formulation with the toolkit, which
it must never import.

A machine is p (..., 3, 6), limb by limb db_x, db_y, db_z, dR_X, dR_Y, dl: the rows of
Table 4. All leading shapes broadcast; complex input passes through `forward`, for
complex-step derivatives.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

R, r, H, L = 0.349, 0.200, 0.340722, 1.107  # Table 1, m
PHI = 2 * np.pi * np.arange(3) / 3
RADIAL = np.stack([np.cos(PHI), np.sin(PHI)], -1)  # (limb, xy)
TANGENT = np.stack([-np.sin(PHI), np.cos(PHI)], -1)
# platform frame, tool tip at the origin
BALLS = np.column_stack([r * RADIAL, np.full(3, H)])
PAIRS = ((0, 1), (1, 2), (2, 0))

#: Table 1: b_x, b_y, b_z, R_X, R_Y, l, mm
TABLE_1 = np.array(
    [
        [200, 0.00, 340.722, 349, 0.00, 1107],
        [-100, 173.205, 340.722, -174.5, 302.243, 1107],
        [-100, -173.205, 340.722, -174.5, -302.243, 1107],
    ]
)
#: Table 2: alpha, beta of the 22 poses, deg
TABLE_2 = np.array(
    [
        (0, 0), (0, 10), (0, 20), (0, 35), (0, -10), (0, -20), (0, -35), (10, 0), (20, 0), (35, 0), (-10, 0),
        (-20, 0), (-35, 0), (5, 10), (10, 25), (-5, -10), (-10, -25), (-5, 10), (-10, 25), (5, -10), (10, -25),
        (25, 10),
    ]
)  # fmt: skip
#: Table 3: the identified parameters, columns as Table 1, mm
TABLE_3 = np.array(
    [
        [199.96, 0.012, 341.100, 350.587, 1.186, 1107.59],
        [-99.98, 173.21, 340.630, -173.721, 303.594, 1107.66],
        [-99.95, -173.22, 340.890, -173.238, -302.730, 1107.52],
    ]
)
#: Table 4: the identified errors, columns as Table 1, mm
TABLE_4 = np.array(
    [
        [-0.034, 0.012, 0.378, 1.587, 1.186, 0.592],
        [0.019, 0.011, -0.092, 0.779, 1.351, 0.664],
        [0.043, -0.021, 0.168, 1.262, -0.487, 0.526],
    ]
)


class Forward(NamedTuple):
    """tip (..., 3) m: tool tip; rotation (..., 3, 3): platform to base; out (..., 3,
    3): ball joints, base frame.
    """

    tip: NDArray
    rotation: NDArray
    balls: NDArray


def rotation(alpha: ArrayLike, beta: ArrayLike, gamma: ArrayLike) -> NDArray:
    """Rx(alpha) Ry(beta) Rz(gamma), (..., 3, 3), written out."""
    a, b, g = np.broadcast_arrays(alpha, beta, gamma)
    ca = np.cos(a)
    sa = np.sin(a)
    cb = np.cos(b)
    sb = np.sin(b)
    cg = np.cos(g)
    sg = np.sin(g)
    rows = (
        (cb * cg, -cb * sg, sb),
        (ca * sg + sa * sb * cg, ca * cg - sa * sb * sg, -sa * cb),
        (sa * sg - ca * sb * cg, sa * cg + ca * sb * sg, ca * cb),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def angles(rot: ArrayLike) -> NDArray:
    """alpha, beta, gamma (..., 3) of rotations (..., 3, 3)."""
    m = np.asarray(rot)
    return np.stack(
        [
            np.arctan2(-m[..., 1, 2], m[..., 2, 2]),
            np.arcsin(m[..., 0, 2]),
            np.arctan2(-m[..., 0, 1], m[..., 0, 0]),
        ],
        -1,
    )


def nominal(
    z: ArrayLike, alpha: ArrayLike, beta: ArrayLike
) -> tuple[NDArray, NDArray, NDArray]:
    """Tip (..., 3), rotation (..., 3, 3) and slider heights (..., 3) of the machine as drawn."""
    z, a, b = np.broadcast_arrays(z, alpha, beta)
    rot = rotation(a, b, gamma_of(a, b))
    x = r / 2 * (rot[..., 0, 0] - rot[..., 1, 1]) - H * rot[..., 0, 2]
    y = -r * rot[..., 1, 0] - H * rot[..., 1, 2]
    tip = np.stack([x, y, z], -1)
    balls = tip[..., None, :] + np.einsum("...ij,kj->...ki", rot, BALLS)
    reach = np.sqrt(L**2 - ((balls[..., :2] - R * RADIAL) ** 2).sum(-1))
    return tip, rot, balls[..., 2] + reach


def _frame(points: NDArray) -> NDArray:
    """Right-handed frame (..., 3, 3), in columns, carried by three points (..., 3, 3);
    no conjugation.
    """
    u = points[..., 1, :] - points[..., 0, :]
    u = u / np.sqrt((u * u).sum(-1))[..., None]
    w = np.cross(u, points[..., 2, :] - points[..., 0, :])
    w = w / np.sqrt((w * w).sum(-1))[..., None]
    return np.stack([u, np.cross(w, u), w], -1)


def forward(q: ArrayLike, p: ArrayLike) -> Forward:
    """Pose at slider heights q (..., 3) of a machine with errors p (..., 3, 6): swing
    angles by Newton.
    """
    q, p = np.asarray(q), np.asarray(p)
    local = BALLS + p[..., :3]
    length = L + p[..., 5]
    foot = R * RADIAL + p[..., 3:5]
    shape = np.broadcast_shapes(q.shape, p.shape[:-1])
    swing = np.broadcast_to(np.arcsin((R - r) / L), shape).astype(
        np.result_type(q, p, float)
    )
    for _ in range(50):
        s, c = np.sin(swing), np.cos(swing)
        flat = foot - (length * s)[..., None] * RADIAL
        balls = np.concatenate([flat, (q - length * c)[..., None]], -1)
        # d ball / d swing
        move = np.concatenate(
            [-(length * c)[..., None] * RADIAL, (length * s)[..., None]], -1
        )
        gap, slope = [], np.zeros((*shape, 3), dtype=swing.dtype)
        for k, (i, j) in enumerate(PAIRS):
            d = balls[..., i, :] - balls[..., j, :]
            side = local[..., i, :] - local[..., j, :]
            gap.append((d * d).sum(-1) - (side * side).sum(-1))
            slope[..., k, i] = 2 * (d * move[..., i, :]).sum(-1)
            slope[..., k, j] = -2 * (d * move[..., j, :]).sum(-1)
        step = np.linalg.solve(slope, np.stack(gap, -1)[..., None])[..., 0]
        swing = swing - step
        if np.abs(step).max() < 1e-15:
            break
    rot = _frame(balls) @ np.swapaxes(
        _frame(np.broadcast_to(local, balls.shape)), -1, -2
    )
    tip = (
        balls[..., 0, :]
        - (rot @ np.broadcast_to(local, balls.shape)[..., 0, :, None])[..., 0]
    )
    return Forward(tip, rot, balls)


def struts(tip: NDArray, rot: NDArray, q: ArrayLike, p: ArrayLike) -> NDArray:
    """Strut vectors v_i (..., 3, 3), slider to ball joint, of a machine with errors p
    at a given pose.
    """
    q, p = np.asarray(q), np.asarray(p)
    balls = tip[..., None, :] + np.einsum("...ij,...kj->...ki", rot, BALLS + p[..., :3])
    foot = np.broadcast_to(R * RADIAL + p[..., 3:5], (*q.shape, 2))
    return balls - np.concatenate([foot, q[..., None]], -1)


def strut_rows(v: NDArray, rot: NDArray) -> NDArray:
    """The bracket of Eq. (11) over L_iZ (..., limb, 6) at struts v: slope of a slider's
    height at a measured pose.
    """
    return (
        np.concatenate([v @ rot, -v[..., :2], np.full((*v.shape[:-1], 1), -L)], -1)
        / v[..., 2:]
    )


def paper_fit(
    tip: NDArray, rot: NDArray, q: NDArray, cut: float, rounds: int = 30
) -> NDArray:
    """Errors p (3, 6) by the procedure of section 6 from n measured poses: Eq. (12)
    solved limb by limb and repeated.

    Least squares of the smallest norm, with singular values below `cut` of the largest
    left out.
    """
    p = np.zeros((3, 6))
    for _ in range(rounds):
        v = struts(tip, rot, q, p)
        flat = (v[..., :2] ** 2).sum(-1)
        # H^m less H^c is minus this
        gap = v[..., 2] + np.sqrt((L + p[:, 5]) ** 2 - flat)
        rows = strut_rows(v, rot)
        for i in range(3):
            p[i] += np.linalg.lstsq(rows[:, i], -gap[:, i], rcond=cut)[0]
    return p


def gamma_of(alpha: ArrayLike, beta: ArrayLike) -> NDArray:
    """The spin gamma (...) that goes with alpha and beta on the machine as drawn."""
    return np.arctan2(-np.sin(alpha) * np.sin(beta), np.cos(alpha) + np.cos(beta))


def spherical(point: ArrayLike, gimbal: ArrayLike) -> NDArray:
    """R, theta (elevation), phi (azimuth) (..., 3) of points seen from a gimbal."""
    d = np.asarray(point) - np.asarray(gimbal)
    flat = np.hypot(d[..., 0], d[..., 1])
    return np.stack(
        [
            np.hypot(flat, d[..., 2]),
            np.arctan2(d[..., 2], flat),
            np.arctan2(d[..., 1], d[..., 0]),
        ],
        -1,
    )


def cartesian(seen: ArrayLike, gimbal: ArrayLike) -> NDArray:
    """Points (..., 3) from R, theta, phi (..., 3)."""
    s = np.asarray(seen)
    flat = s[..., 0] * np.cos(s[..., 1])
    d = np.stack(
        [
            flat * np.cos(s[..., 2]),
            flat * np.sin(s[..., 2]),
            s[..., 0] * np.sin(s[..., 1]),
        ],
        -1,
    )
    return d + np.asarray(gimbal)


def laser_ball_bar(
    tip: NDArray,
    rot: NDArray,
    gimbal: ArrayLike,
    baseline: float,
    noise: NDArray | float = 0.0,
) -> NDArray:
    """x, y, z, alpha, beta (..., 5) as the laser ball bar tells them: section 5.1, Eq.
    (15).

    `noise` (..., 2, 3) is added to R, theta, phi at the points A and B of the standard
    bar, B away from the platform.
    """
    ends = np.stack([tip, tip - baseline * rot[..., :, 2]], -2)
    a, b = np.moveaxis(cartesian(spherical(ends, gimbal) + noise, gimbal), -2, 0)
    n = (a - b) / np.linalg.norm(a - b, axis=-1, keepdims=True)
    return np.concatenate(
        [
            a,
            np.arctan2(-n[..., 1], n[..., 2])[..., None],
            np.arcsin(n[..., 0])[..., None],
        ],
        -1,
    )
