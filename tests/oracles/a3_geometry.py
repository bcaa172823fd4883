"""Oracle for the A3 head (3-RPS; Tian et al., Mech. Mach. Theory 102 (2016) 167-178),
SI units (m, rad).

The forward solver works on three limb swing angles and three triangle sides, not on a
platform pose: it shares neither code nor formulation with the toolkit, which must never
be imported here.

A machine is its error vector `p` (..., 24): dq (3), db (9, limb by limb xyz), da0 (9,
same), beta (3, rad). Poses are nominal coordinates: z (height of the tool point above
the base), psi, theta; `tool` moves the tool point to (0, 0, tool) in the platform
frame. All leading shapes broadcast, so poses and machines vectorise. Everything down to
`ball_bar_reading` accepts complex input, hence complex-step derivatives.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

A, B, C, D = 0.250, 0.250, 0.526, 0.540  # paper, Table 1
VARPHI = 2 * np.pi * np.arange(3) / 3 - np.pi / 2
_COS, _SIN, _0 = np.cos(VARPHI), np.sin(VARPHI), np.zeros(3)
RADIAL = np.stack([_COS, _SIN, _0], -1)  # (limb, xyz), from the centre towards B_i
S1 = np.stack([-_SIN, _COS, _0], -1)  # (limb, xyz), revolute axes
B_NOM = B * RADIAL
A0_NOM = A * RADIAL - np.array([0, 0, C])  # P -> A_i in the platform frame
UP = np.array([0.0, 0.0, 1.0])
PAIRS = ((0, 1), (1, 2), (2, 0))
SL_Q, SL_B, SL_A, SL_BETA = slice(0, 3), slice(3, 12), slice(12, 21), slice(21, 24)
# the 18 parameters left by Eqs. (16)-(17)
EQ17 = np.array([0, 1, 2, 4, 6, 9, *range(12, 24)])
Z_TEACH = D + C + 0.220  # height of the fixed ball that reproduces Table 2
BAR = 0.300
# p = SCALE * (dq, db, da0, D beta): Eq. (6), all in m
SCALE = np.r_[np.ones(21), np.full(3, 1 / D)]
Array = NDArray

# Table 2: stroke s (m) -> (smallest, largest) theta over a circle (rad); z = D + C + s.
TABLE2 = {
    0.080: tuple(np.deg2rad((28.41, 32.85))),
    0.200: tuple(np.deg2rad((32.18, 38.34))),
}

# Table 3: errors identified in the fine calibration (m, rad); what the table leaves
# blank is zero.
TABLE3 = {
    "dq": 1e-3 * np.array([-1.0104, -1.4540, -0.7043]),
    "db": 1e-3 * np.array([[0, -0.8735, 0], [-0.7453, 0, 0], [-0.0949, 0, 0]]),
    "da0": 1e-3 * np.array([[0, 1.0215, 0.7907], [0.0833, 1.0750, 1.5004], [0.1023, 0.9646, -0.4216]]),
    "beta": np.deg2rad([-0.4485, -0.7084, -0.5500]),
    "ds": 1e-3 * np.array([0.0144, -0.0104, -0.0097]),
}  # fmt: skip


class Forward(NamedTuple):
    """tip (..., 3) m: tool point; R (..., 3, 3): platform to base; gamma (..., 3) rad:
    swing angles.
    """

    tip: Array
    R: Array
    gamma: Array


class Compensator(NamedTuple):
    """dq (..., 3, 24): Eq. (24), dq_m = dq @ p; dc (..., 3, 24): Eq. (25), (dx, dy,
    dphi) = dc @ p.
    """

    dq: Array
    dc: Array


def errors(
    dq: ArrayLike = 0.0,
    db: ArrayLike = 0.0,
    da0: ArrayLike = 0.0,
    beta: ArrayLike = 0.0,
) -> Array:
    """Pack dq (3,), db (3, 3), da0 (3, 3) in m and beta (3,) in rad into p (24,)."""
    parts = (
        np.broadcast_to(dq, 3),
        np.broadcast_to(db, (3, 3)),
        np.broadcast_to(da0, (3, 3)),
    )
    return np.concatenate([np.ravel(v) for v in (*parts, np.broadcast_to(beta, 3))])


def _norm(v: Array) -> Array:
    """Euclidean norm over the last axis, without conjugation, so that the complex step
    passes through.
    """
    return np.sqrt((v * v).sum(-1))


def _frame(pts: Array) -> Array:
    """Right-handed frame (..., 3, 3), in columns, carried by three points (..., 3, 3)."""
    e1 = pts[..., 1, :] - pts[..., 0, :]
    e1 = e1 / _norm(e1)[..., None]
    e3 = np.cross(e1, pts[..., 2, :] - pts[..., 0, :])
    e3 = e3 / _norm(e3)[..., None]
    return np.stack([e1, np.cross(e3, e1), e3], -1)


def rotation(psi: ArrayLike, theta: ArrayLike, phi: ArrayLike) -> Array:
    """R = Rz(psi) Rx(theta) Rz(phi), (..., 3, 3); the matrix under Eq. (1)."""
    psi, theta, phi = np.broadcast_arrays(psi, theta, phi)

    def rz(t: Array) -> Array:
        c, s, o, i = np.cos(t), np.sin(t), 0 * t, 0 * t + 1
        return np.stack(
            [
                np.stack([c, -s, o], -1),
                np.stack([s, c, o], -1),
                np.stack([o, o, i], -1),
            ],
            -2,
        )

    cycle = np.ix_([2, 0, 1], [2, 0, 1])  # Rx is Rz with the axes renamed
    return rz(psi) @ rz(theta)[(..., *cycle)] @ rz(phi)


def euler(R: Array) -> tuple[Array, Array, Array]:
    """psi, theta, phi (...) of z-x-z from R (..., 3, 3), theta >= 0; where theta = 0,
    psi = 0, phi = spin.
    """
    theta = np.arctan2(np.hypot(R[..., 0, 2], R[..., 1, 2]), R[..., 2, 2])
    flat = theta < 1e-12
    psi = np.where(flat, 0.0, np.arctan2(R[..., 0, 2], -R[..., 1, 2]))
    phi = np.where(
        flat,
        np.arctan2(R[..., 1, 0], R[..., 0, 0]),
        np.arctan2(R[..., 2, 0], R[..., 2, 1]),
    )
    return psi, theta, phi


def forward(p: ArrayLike, q: ArrayLike, tool: ArrayLike = 0.0) -> Forward:
    """True tool point and orientation of machine p (..., 24) at commanded joints q
    (..., 3) m.

    A_i(gamma_i) = b_i + db_i + (q_i + dq_i) (cos beta_i s2_i + sin beta_i s1_i), with
    s2_i perpendicular to s1_i at swing angle gamma_i from the vertical; Newton on |A_i
    - A_j|^2 = |a0_i - a0_j|^2; then the pose that carries the platform's triangle into
    A_1 A_2 A_3. Raises ArithmeticError where it does not converge.
    """
    p, q, tool = np.asarray(p), np.asarray(q), np.asarray(tool)
    shape = np.broadcast_shapes(p.shape[:-1], q.shape[:-1], tool.shape)
    length, beta = q + p[..., SL_Q], p[..., SL_BETA]
    base = B_NOM + p[..., SL_B].reshape(*p.shape[:-1], 3, 3)
    plat = A0_NOM + p[..., SL_A].reshape(*p.shape[:-1], 3, 3)
    side2 = np.stack(
        [((plat[..., i, :] - plat[..., j, :]) ** 2).sum(-1) for i, j in PAIRS], -1
    )
    reach = (length * np.cos(beta))[..., None]
    lateral = (length * np.sin(beta))[..., None] * S1
    gamma = np.zeros((*shape, 3), np.result_type(p, q, tool, float))
    polish = 2  # once the lengths agree: rounding, and the imaginary part, which lags one step behind
    for _ in range(60):
        c, s = np.cos(gamma)[..., None], np.sin(gamma)[..., None]
        joints = base + lateral + reach * (c * UP + s * RADIAL)
        slope = reach * (c * RADIAL - s * UP)  # d joints_i / d gamma_i
        f, jac = np.empty_like(gamma), np.zeros((*shape, 3, 3), gamma.dtype)
        for k, (i, j) in enumerate(PAIRS):
            gap = joints[..., i, :] - joints[..., j, :]
            f[..., k] = (gap * gap).sum(-1) - side2[..., k]
            jac[..., k, i] = 2 * (gap * slope[..., i, :]).sum(-1)
            jac[..., k, j] = -2 * (gap * slope[..., j, :]).sum(-1)
        good = np.abs(f) < 2e-14 * np.sqrt(np.abs(side2))  # side lengths to 1e-14 m
        if good.all():
            if polish == 0:
                break
            polish -= 1
        step = np.linalg.solve(jac, f[..., None])[..., 0]
        gamma = gamma - step / np.maximum(
            1, np.abs(step).max(-1, keepdims=True, initial=0) / 0.3
        )
    else:
        raise ArithmeticError(f"forward: Newton stopped at {np.abs(f).max():.1e} m^2")
    R = _frame(joints) @ np.swapaxes(_frame(plat), -1, -2)
    tcp = joints.mean(-2) - (R @ plat.mean(-2)[..., None])[..., 0]
    return Forward(tcp + tool[..., None] * R[..., :, 2], R, gamma)


def nominal_pose(
    z: ArrayLike, psi: ArrayLike, theta: ArrayLike, tool: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """Nominal tool point (..., 3) m and R (..., 3, 3) by Eq. (2); z is the height of
    the tool point.
    """
    z, psi, theta, tool = np.broadcast_arrays(z, psi, theta, tool)
    lean, sin = A / 2 * (1 - np.cos(theta)), np.sin(theta)
    x = lean * np.sin(2 * psi) + (C + tool) * np.sin(psi) * sin
    y = lean * np.cos(2 * psi) - (C + tool) * np.cos(psi) * sin
    return np.stack([x, y, z], -1), rotation(psi, theta, -psi)


def inverse_nominal(
    z: ArrayLike, psi: ArrayLike, theta: ArrayLike, tool: ArrayLike = 0.0
) -> Array:
    """Nominal joint lengths q (..., 3) m by Eqs. (1)-(3); z is the height of the tool point."""
    tip, R = nominal_pose(z, psi, theta, tool)
    tcp = tip - np.asarray(tool)[..., None] * R[..., :, 2]
    return _norm(tcp[..., None, :] - B_NOM + A0_NOM @ np.swapaxes(R, -1, -2))


def taught_cup(
    p: ArrayLike, offset: ArrayLike = 0.0, z: ArrayLike = Z_TEACH, tool: ArrayLike = 0.0
) -> Array:
    """Fixed cup (..., 3) m: true tool point of p at the joints of psi = theta = 0,
    height z, plus offset.
    """
    return forward(p, inverse_nominal(z, 0.0, 0.0, tool), tool).tip + offset


def ball_bar_reading(
    machine_errors: ArrayLike, q: ArrayLike, cup: ArrayLike, tool: ArrayLike = 0.0
) -> Array:
    """Length (...) m between the true tool point at joints q (..., 3) and the cup (...,
    3); Eq. (8).
    """
    return _norm(forward(machine_errors, q, tool).tip - np.asarray(cup))


def circle_theta(
    z: ArrayLike,
    psi: ArrayLike,
    cup: ArrayLike,
    length: ArrayLike = BAR,
    tool: ArrayLike = 0.0,
) -> Array:
    """Theta (...) rad in 0..70 deg where the nominal tool point is `length` from the
    cup; bisection.
    """
    cup = np.asarray(cup)
    z, psi, length, tool, _ = np.broadcast_arrays(z, psi, length, tool, cup[..., 0])

    def excess(theta: Array) -> Array:
        return _norm(nominal_pose(z, psi, theta, tool)[0] - cup) - length

    low, high = np.zeros(z.shape), np.full(z.shape, np.deg2rad(70.0))
    if not ((excess(low) < 0) & (excess(high) > 0)).all():
        raise ValueError("circle_theta: the bar does not reach this circle")
    for _ in range(60):
        mid = (low + high) / 2
        far = excess(mid) > 0
        low, high = np.where(far, low, mid), np.where(far, mid, high)
    return (low + high) / 2


def _wrench(
    z: ArrayLike, psi: ArrayLike, theta: ArrayLike, tool: ArrayLike = 0.0
) -> tuple[Array, Array]:
    """W^T (..., 6, 6) and B (..., 6, 24) of Eq. (5) about the tool point; beta's column is q_i."""
    tip, R = nominal_pose(z, psi, theta, tool)
    tool_vec = np.zeros((*tip.shape[:-1], 3))
    tool_vec[..., 2] = tool
    # a_i: tool point -> A_i, base frame
    arm = (A0_NOM - tool_vec[..., None, :]) @ np.swapaxes(R, -1, -2)
    leg = tip[..., None, :] - B_NOM + arm
    q = _norm(leg)
    s2, s1 = leg / q[..., None], np.broadcast_to(S1, leg.shape)
    wt, b = np.empty((*q.shape[:-1], 6, 6)), np.zeros((*q.shape[:-1], 6, 24))
    for row, s in ((0, s2), (3, s1)):
        wt[..., row : row + 3, :3], wt[..., row : row + 3, 3:] = s, np.cross(arm, s)
        for i in range(3):
            b[..., row + i, 3 + 3 * i : 6 + 3 * i] = s[..., i, :]
            b[..., row + i, 12 + 3 * i : 15 + 3 * i] = -(s[..., i, None, :] @ R)[
                ..., 0, :
            ]
    for i in range(3):
        b[..., i, i], b[..., 3 + i, 21 + i] = 1.0, q[..., i]
    return wt, b


def linear_model(
    z: ArrayLike, psi: ArrayLike, theta: ArrayLike, tool: ArrayLike = 0.0
) -> Array:
    """A = W^-T B (..., 6, 24) of Eq. (6): (dr, dalpha) of the tool point, m and rad,
    per unit of p.
    """
    return np.linalg.solve(*_wrench(z, psi, theta, tool))


def bar_rows(
    z: ArrayLike,
    psi: ArrayLike,
    theta: ArrayLike,
    cup: ArrayLike,
    tool: ArrayLike = 0.0,
    taught: bool = True,
) -> Array:
    """Rows (..., 27) of Eq. (12): d length / d (p, cup offset), with the cup nominally
    at (..., 3).

    taught: the machine itself taught the cup at psi = theta = 0, Eq. (11), and the
    offset is from there; otherwise the offset is the cup's displacement in the base
    frame. Exact for a bar of any length.
    """
    cup = np.asarray(cup)
    bar = nominal_pose(z, psi, theta, tool)[0] - cup
    n = bar / _norm(bar)[..., None]
    a = linear_model(z, psi, theta, tool)[..., :3, :]
    if taught:
        a = a - linear_model(cup[..., 2], 0.0, 0.0, tool)[..., :3, :]
    return np.concatenate([(n[..., None, :] @ a)[..., 0, :], -n], -1)


def home_rows() -> Array:
    """Rows (6, 27) of Eq. (13): d (dr, dalpha) / d (p, cup offset) at home, m and rad."""
    return np.hstack([linear_model(D + C, 0.0, 0.0), np.zeros((6, 3))])


def approach_1(strokes: ArrayLike, points: int) -> Array:
    """H (6 + m n, 27) of Eq. (14): home rows, then m circles of n points, cup taught.

    Parameters are (dq, db, da0, D beta, ds), all in m; rows in m, home orientation in
    rad.
    """
    stroke = np.repeat(strokes, points)
    psi = np.tile(2 * np.pi * np.arange(points) / points, len(stroke) // points)
    cup = np.array([0.0, 0.0, Z_TEACH])
    theta = circle_theta(D + C + stroke, psi, cup)
    bar = bar_rows(D + C + stroke, psi, theta, cup)
    return np.vstack([home_rows(), bar]) * np.r_[SCALE, 1, 1, 1]


def level_and_edge(p: ArrayLike, q: ArrayLike) -> Array:
    """Readings (..., 3) rad of the platform of machine p at joints q (..., 3).

    Slopes of the platform's v and u axes over the horizontal, as tilts about x and y,
    and the direction of u in plan; all positive as right-handed rotations.
    """
    u, v = np.moveaxis(forward(p, q).R, -1, 0)[:2]
    tilt_x = np.arctan2(v[..., 2], np.hypot(v[..., 0], v[..., 1]))
    tilt_y = -np.arctan2(u[..., 2], np.hypot(u[..., 0], u[..., 1]))
    return np.stack([tilt_x, tilt_y, np.arctan2(u[..., 1], u[..., 0])], -1)


def compensator(z: ArrayLike, psi: ArrayLike, theta: ArrayLike) -> Compensator:
    """Eqs. (19)-(25): joint corrections and the errors (dx, dy, dphi) left over; theta
    must not be 0.
    """
    wt, b = _wrench(z, psi, theta)
    psi, theta = np.broadcast_arrays(psi, theta)
    # Eq. (19): (dr, dalpha) = g (dr, dpsi, dtheta, dphi)
    g = np.zeros((*wt.shape[:-2], 6, 6))
    g[..., [0, 1, 2], [0, 1, 2]], g[..., 5, 3] = 1.0, 1.0
    g[..., 3, 4], g[..., 3, 5] = np.cos(psi), np.sin(psi) * np.sin(theta)
    g[..., 4, 4], g[..., 4, 5] = np.sin(psi), -np.cos(psi) * np.sin(theta)
    g[..., 5, 5] = np.cos(theta)
    t = np.linalg.inv(wt @ g)  # Eq. (20): rows x, y, z, psi, theta, phi
    ta, tc = t[..., [2, 3, 4], :], t[..., [0, 1, 5], :]
    dq = -np.linalg.solve(ta[..., :3], ta @ b)
    return Compensator(dq, tc @ b + tc[..., :3] @ dq)
