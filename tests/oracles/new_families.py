"""Oracle of machines with cranks and glides: poses at joints and named errors, by NumPy
and SciPy alone, from the machines' descriptions with their default sizes.

Errors of limb i: `b1x`.. of crank centre or guide point, `zero1` of the crank's angle, `r1`
of the crank, `l1` of the strut, `a1x`.. of the platform joint, and `turn1x`.. of the axis or
guide as a rotation vector. It must never import the toolkit.
"""

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray
from scipy import optimize
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Errors = Mapping[str, float]


def _vector(errors: Errors, stem: str) -> Array:
    return np.array([errors.get(f"{stem}{k}", 0.0) for k in "xyz"])


def _ring(radius: float, degrees: list[float]) -> Array:
    a = np.deg2rad(degrees)
    return radius * np.column_stack([np.cos(a), np.sin(a), 0.0 * a])


def _knee(
    errors: Errors, i: int, q: float, centre: Array, axis: Array, first: Array, r: float
) -> Array:
    """Knee (3,): the crank, turned about its axis from its direction at angle 0.

    The direction at angle 0 is that of the true axis' plane nearest to the nominal one.
    """
    axis = Rotation.from_rotvec(_vector(errors, f"turn{i}")).apply(axis)
    flat = first - axis * (first @ axis)
    angle = q + errors.get(f"zero{i}", 0.0)
    arm = Rotation.from_rotvec(angle * axis).apply(flat / np.linalg.norm(flat))
    return centre + _vector(errors, f"b{i}") + (r + errors.get(f"r{i}", 0.0)) * arm


def _rotary_delta(x: Array, q: Array, e: Errors) -> Array:
    out = _ring(1.0, [270.0, 150.0, 30.0])
    rows = []
    for k in range(3):
        axis = np.cross(out[k], [0.0, 0.0, -1.0])
        knee = _knee(e, k + 1, q[k], 0.155 * out[k], axis, out[k], 0.35)
        rows.append(np.linalg.norm(x - knee) - 0.8 - e.get(f"l{k + 1}", 0.0))
    return np.array(rows)


def _hexapod_rus(x: Array, q: Array, e: Errors) -> Array:
    centre = _ring(0.25, [-15, 15, 105, 135, 225, 255])
    platform = _ring(0.2, [-45, 45, 75, 165, 195, 285])
    turn = Rotation.from_rotvec([x[3], x[4], 0.0]) * Rotation.from_rotvec([0, 0, x[5]])
    rows = []
    for k in range(6):
        out = centre[k] / 0.25
        axis = np.cross(out, [0.0, 0.0, 1.0])
        knee = _knee(e, k + 1, q[k], centre[k], axis, out, 0.12)
        end = x[:3] + turn.apply(platform[k] + _vector(e, f"a{k + 1}"))
        rows.append(np.linalg.norm(end - knee) - 0.37 - e.get(f"l{k + 1}", 0.0))
    return np.array(rows)


def _five_bar(x: Array, q: Array, e: Errors) -> Array:
    rows = []
    for k, sign in enumerate((-1.0, 1.0)):
        centre = [sign * 0.1 + e.get(f"b{k + 1}x", 0.0), e.get(f"b{k + 1}y", 0.0)]
        r, angle = 0.2 + e.get(f"r{k + 1}", 0.0), q[k] + e.get(f"zero{k + 1}", 0.0)
        knee = centre + r * np.array([np.cos(angle), np.sin(angle)])
        rows.append(np.linalg.norm(x - knee) - 0.3 - e.get(f"l{k + 1}", 0.0))
    return np.array(rows)


def _orthoglide(x: Array, q: Array, e: Errors) -> Array:
    rows = []
    for k in range(3):
        guide = Rotation.from_rotvec(_vector(e, f"turn{k + 1}")).apply(np.eye(3)[k])
        carriage = _vector(e, f"b{k + 1}") + q[k] * guide
        rows.append(np.linalg.norm(x - carriage) - 0.31 - e.get(f"l{k + 1}", 0.0))
    return np.array(rows)


def _pentapod(x: Array, q: Array, e: Errors) -> Array:
    upper, lower = _ring(0.8, [90, 210, 330]), _ring(0.9, [45, 135])
    base = np.vstack([np.add(upper, [0, 0, 1.2]), np.add(lower, [0, 0, 0.2])])
    tool = Rotation.from_rotvec([x[3], x[4], 0.0])
    rows = []
    for k in range(5):
        at = tool.inv().apply(base[k] + _vector(e, f"b{k + 1}") - x[:3])
        height = (0.7 if k < 3 else 0.1) + e.get(f"h{k + 1}", 0.0)
        radius = 0.08 + e.get(f"r{k + 1}", 0.0)
        length = np.hypot(at[2] - height, np.hypot(at[0], at[1]) - radius)
        rows.append(length - e.get(f"l{k + 1}", 0.0) - q[k])
    return np.array(rows)


def _tripod_upr_spr(x: Array, q: Array, e: Errors) -> Array:
    base = np.array([[-0.35, 0.0, 0.0], [0.35, 0.0, 0.0], [0.0, 0.5, 0.0]])
    joint = np.array([[-0.12, 0.0, 0.3], [0.12, 0.0, 0.3], [0.0, 0.15, 0.3]])
    turn = Rotation.from_rotvec([x[3], x[4], 0.0]) * Rotation.from_rotvec([0, 0, x[5]])
    rows = []
    for k in range(3):
        foot = base[k] + _vector(e, f"b{k + 1}")
        end = joint[k] + _vector(e, f"a{k + 1}")
        leg = turn.inv().apply(foot - x[:3]) - end
        axis = Rotation.from_rotvec(_vector(e, f"turn{k + 1}")).apply(
            np.eye(3)[0 if k == 2 else 1]
        )
        length = np.linalg.norm(leg)
        from_square = np.arcsin(-leg @ axis / length) - e.get(f"hinge{k + 1}", 0.0)
        rows += [length - e.get(f"l{k + 1}", 0.0) - q[k], from_square]
    return np.array(rows)


def _tripod_wrist(x: Array, q: Array, e: Errors) -> Array:
    """Tool on two wrist axes on a tripod whose passive leg runs through a pivot."""
    base, joint = _ring(0.4, [90, 210, 330]), _ring(0.2, [90, 210, 330])
    tool = Rotation.from_rotvec([x[3], x[4], 0.0]) * Rotation.from_rotvec([0, 0, x[5]])
    place, turn = np.zeros(3), Rotation.identity()
    for i, axis in ((5, [1.0, 0.0, 0.0]), (4, [0.0, 0.0, 1.0])):
        axis = Rotation.from_rotvec(_vector(e, f"turn{i}")).apply(axis)
        centre = np.array([0.0, 0.0, 0.25]) + _vector(e, f"c{i}")
        step = Rotation.from_rotvec((q[i - 1] + e.get(f"zero{i}", 0.0)) * axis)
        place, turn = centre + step.apply(place - centre), step * turn
    head = tool * turn.inv()
    origin = x[:3] - head.apply(place)
    rows = []
    for k in range(3):
        end = origin + head.apply(joint[k] + [0.0, 0.0, 0.3] + _vector(e, f"a{k + 1}"))
        length = np.linalg.norm(end - base[k] - _vector(e, f"b{k + 1}"))
        rows.append(length - e.get(f"l{k + 1}", 0.0) - q[k])
    pivot = head.inv().apply(_vector(e, "pivot_") - origin)
    for k, n in enumerate("xy"):
        line = e.get(f"leg_{n}", 0.0) + e.get(f"lean_{n}", 0.0) * pivot[2]
        rows.append(pivot[k] - line)
    first = np.array([1.0, e.get("axis_turn", 0.0), e.get("axis_rise", 0.0)])
    square = first @ head.apply([0.0, 1.0, 0.0]) / np.linalg.norm(first)
    return np.array([*rows, square - e.get("square", 0.0)])


CLOSURES: dict[str, Callable[[Array, Array, Errors], Array]] = {
    "rotary_delta": _rotary_delta, "hexapod_rus": _hexapod_rus, "five_bar": _five_bar,
    "orthoglide": _orthoglide, "pentapod": _pentapod, "tripod_upr_spr": _tripod_upr_spr,
    "tripod_wrist": _tripod_wrist,
}  # fmt: skip


def pose(name: str, q: Array, errors: Errors, start: Array) -> Array:
    """Pose near a start at joints, with errors."""
    found = optimize.root(CLOSURES[name], start, (q, errors), tol=1e-14)
    return np.asarray(found.x)


def slopes(name: str, q: Array, x: Array, names: list[str]) -> Array:
    """Slopes (nx, n) of the pose over errors, by central differences of the closure."""
    h, closure = 1e-6, CLOSURES[name]
    by_x = np.empty((len(x), len(x)))
    for k in range(len(x)):
        step = h * np.eye(len(x))[k]
        by_x[:, k] = (closure(x + step, q, {}) - closure(x - step, q, {})) / (2 * h)
    by_error = [
        (closure(x, q, {n: h}) - closure(x, q, {n: -h})) / (2 * h) for n in names
    ]
    return np.asarray(-np.linalg.solve(by_x, np.column_stack(by_error)))
