"""Oracle of the families of machines: drawn geometries of 0.1 to 10 m, and whether a
pose with its joints is assembled, and in which mode, by NumPy and SciPy alone.

It must never import the toolkit.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
Geometry = dict[str, Any]
#: length errors (n, limbs), m, and the mask (n,) of mirrored poses
Verdict = tuple[Array, NDArray[np.bool_]]


def drawn_size(rng: np.random.Generator) -> float:
    """0.1 to 10 m, evenly over the decades."""
    return float(10.0 ** rng.uniform(-1.0, 1.0))


def _ring(
    rng: np.random.Generator, radius: float, degrees: list[float], z: float
) -> Array:
    """A circle whose points were drawn 3 % of the radius and 4 degrees off."""
    angles = np.deg2rad(degrees) + rng.normal(0.0, 0.07, len(degrees))
    at = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))])
    place = np.array([0.0, 0.0, z])
    return radius * at + place + 0.03 * radius * rng.normal(size=at.shape)


def _pairs(middle: float, half: float) -> list[float]:
    centres = (middle, middle + 120.0, middle + 240.0)
    return [c + s * half for c in centres for s in (-1.0, 1.0)]


def rotations(x: Array) -> Array:
    """Rotations (n, 3, 3) of poses x, y, z, rx, ry, spin: spin, then the tilt vector."""
    tilt = np.column_stack([x[:, 3], x[:, 4], np.zeros(len(x))])
    spin = np.column_stack([np.zeros((len(x), 2)), x[:, 5]])
    turned = Rotation.from_rotvec(tilt) * Rotation.from_rotvec(spin)
    return np.asarray(turned.as_matrix())


def _joints(geometry: Geometry, x: Array) -> Array:
    """Platform joints (n, limbs, 3) in the base frame."""
    turned = np.einsum("nij,kj->nki", rotations(x), geometry["platform"])
    return np.asarray(x[:, None, :3] + turned)


def _upright(x: Array) -> NDArray[np.bool_]:
    """Which poses have the tool axis and the spin the wrong way round."""
    r = rotations(x)
    return np.asarray((r[:, 2, 2] < 0.0) | (np.cos(x[:, 5]) < 0.0))


# -- hexapods and tripods --------------------------------------------------------------
def hexapod_ups(rng: np.random.Generator) -> Geometry:
    """Base and platform with six joints in pairs."""
    size = drawn_size(rng)
    base = _ring(rng, 0.6 * size, _pairs(0.0, 15.0), 0.0)
    platform = _ring(rng, 0.4 * size, _pairs(0.0, 45.0), rng.uniform(0, 0.3) * size)
    home = np.array([0.0, 0.0, rng.uniform(0.7, 1.1) * size])
    shape = {"base": base, "platform": platform, "home": home}
    return shape | {"reach": 0.15 * size, "tilt": 0.2}


def hexapod_pus(rng: np.random.Generator) -> Geometry:
    """Nearly vertical guides, with the carriages above or below the platform."""
    size, side = drawn_size(rng), rng.choice([-1.0, 1.0])
    guide = _ring(rng, 0.7 * size, _pairs(0.0, 15.0), 0.0)
    platform = _ring(rng, 0.4 * size, _pairs(0.0, 45.0), 0.0)
    direction = [0.0, 0.0, 1.0] + 0.05 * rng.normal(size=(6, 3))
    shape = {"guide": guide, "platform": platform, "direction": direction}
    shape |= {"strut": size * rng.uniform(1.0, 1.1, 6), "side": np.full(6, side)}
    return shape | {"home": np.zeros(3), "reach": 0.1 * size, "tilt": 0.15}


def _tripod(rng: np.random.Generator, size: float) -> Geometry:
    degrees = [-90.0, 30.0, 150.0]
    axis = _ring(rng, 1.0, [d + 90.0 for d in degrees], 0.0)
    drop = rng.uniform(-0.6, 0.6) * size
    platform = _ring(rng, 0.4 * size, degrees, drop)
    return {"axis": axis, "platform": platform, "reach": 0.15 * size, "tilt": 0.3}


def tripod_rps(rng: np.random.Generator) -> Geometry:
    """Three hinged legs that point up or down to the platform."""
    size = drawn_size(rng)
    shape = _tripod(rng, size)
    shape["base"] = _ring(rng, 0.45 * size, [-90.0, 30.0, 150.0], 0.0)
    height = rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 1.2) * size
    platform_height = shape["platform"][:, 2].mean()
    return shape | {"home": np.array([0.0, 0.0, height - platform_height])}


def tripod_prs(rng: np.random.Generator) -> Geometry:
    """Three hinged struts on carriages above or below the platform."""
    size, side = drawn_size(rng), rng.choice([-1.0, 1.0])
    shape = _tripod(rng, size)
    shape["guide"] = _ring(rng, 0.7 * size, [-90.0, 30.0, 150.0], 0.0)
    shape["direction"] = [0.0, 0.0, 1.0] + 0.03 * rng.normal(size=(3, 3))
    shape |= {"strut": size * rng.uniform(1.2, 1.4, 3), "side": np.full(3, side)}
    return shape | {"home": np.zeros(3)}


def tripod_passive_leg(rng: np.random.Generator) -> Geometry:
    """A tripod with a passive leg, hanging or standing."""
    size, way = drawn_size(rng), rng.choice([-1.0, 1.0])
    degrees = [90.0, 210.0, 330.0]
    shape = {"base": _ring(rng, 0.4 * size, degrees, 0.0)}
    shape["platform"] = _ring(rng, 0.2 * size, degrees, -way * 0.3 * size)
    shape["home"] = np.array([0.0, 0.0, way * rng.uniform(1.1, 1.4) * size])
    shape["pivot"] = 0.02 * size * rng.normal(size=3)
    return shape | {"reach": 0.25 * size, "first_axis": rng.uniform(-np.pi, np.pi)}


def tripod_upr_spr(rng: np.random.Generator) -> Geometry:
    """Two legs over a line along x and a third beside it, hanging or standing."""
    size, way = drawn_size(rng), rng.choice([-1.0, 1.0])
    third = rng.choice([-1.0, 1.0]) * np.array([0.0, rng.uniform(0.4, 0.6), 0.0])
    half, offset = rng.uniform(0.3, 0.5), np.array([0.1 * rng.normal(), 0.0, 0.0])
    base = np.array([[-half, 0.0, 0.0], [half, 0.0, 0.0], third + offset])
    platform = 0.3 * base - way * np.array([0.0, 0.0, 0.3])
    platform[:2] += 0.05 * rng.normal(size=(2, 3)) * [1.0, 0.0, 1.0]
    home = np.array([0.0, 0.0, way * rng.uniform(1.3, 1.6)])
    shape = {"base": base, "platform": platform, "home": home, "reach": 0.25}
    return {name: size * np.asarray(value) for name, value in shape.items()}


def cables_planar(rng: np.random.Generator) -> Geometry:
    """Four or five anchors around a point."""
    size, count = drawn_size(rng), int(rng.integers(4, 6))
    degrees = list(45.0 + 360.0 / count * np.arange(count))
    return {"anchor": _ring(rng, size, degrees, 0.0)[:, :2], "reach": 0.4 * size}


def cables_spatial(rng: np.random.Generator) -> Geometry:
    """Six anchors, above and below a point."""
    size = drawn_size(rng)
    above = _ring(rng, size, [0.0, 120.0, 240.0], 0.5 * size)
    below = _ring(rng, size, [60.0, 180.0, 300.0], -0.5 * size)
    anchor = np.vstack([above, below])
    return {"anchor": anchor, "home": np.zeros(3), "reach": 0.3 * size}


def delta(rng: np.random.Generator) -> Geometry:
    """A delta whose towers differ in all that a tower has."""
    size = drawn_size(rng)
    angles = np.deg2rad([210.0, 330.0, 90.0]) + rng.uniform(-0.2, 0.2, 3)
    shape = {
        "angle": angles[:: rng.choice([-1, 1])],
        "arm": size * rng.uniform(0.95, 1.05, 3),
    }
    shape["radius"] = size * rng.uniform(0.3, 0.5) * rng.uniform(0.9, 1.1, 3)
    shape |= {n: rng.uniform(-0.05, 0.05, 3) for n in ("lean", "tip")}
    return shape | {"endstop": size * rng.uniform(1.0, 1.2, 3)}


# -- cranks and glides -----------------------------------------------------------------
def rotary_delta(rng: np.random.Generator) -> Geometry:
    """A rotary delta whose limbs differ in all that a limb has."""
    size = drawn_size(rng)
    angles = np.deg2rad([0.0, 120.0, 240.0]) + rng.uniform(-0.1, 0.1, 3)
    shape = {"angle": angles, "radius": size * rng.uniform(0.1, 0.3, 3)}
    shape["upper"] = size * rng.uniform(0.45, 0.55, 3)
    shape["lower"] = size * rng.uniform(1.0, 1.2, 3)
    shape["height"] = size * rng.uniform(-0.03, 0.03, 3)
    return shape | {"home": np.array([0.0, 0.0, -size]), "reach": 0.15 * size}


def hexapod_rus(rng: np.random.Generator) -> Geometry:
    """Cranks that swing outward in nearly upright planes."""
    size = drawn_size(rng)
    centre = _ring(rng, 0.7 * size, _pairs(0.0, 15.0), 0.0)
    platform = _ring(rng, 0.5 * size, _pairs(0.0, 45.0), 0.0)
    first = centre + 0.03 * size * rng.normal(size=(6, 3))
    axis = np.cross(first, [0.0, 0.0, 1.0]) + 0.03 * size * rng.normal(size=(6, 3))
    shape = {"centre": centre, "axis": axis, "first": first, "platform": platform}
    shape |= {"crank": 0.35 * size * np.ones(6), "side": -np.ones(6)}
    shape |= {"strut": size * rng.uniform(1.1, 1.2, 6), "tilt": 0.08}
    return shape | {"home": np.array([0.0, 0.0, 1.05 * size]), "reach": 0.06 * size}


def five_bar(rng: np.random.Generator) -> Geometry:
    """A five-bar linkage with both knees out or both to one side."""
    size = drawn_size(rng)
    centre = size * np.array([[-0.3, 0.0], [0.3, 0.0]])
    centre = centre + 0.03 * size * rng.normal(size=(2, 2))
    sides = np.array([1.0, -1.0]) if rng.random() < 0.5 else np.array([1.0, 1.0])
    shape = {"centre": centre, "crank": size * rng.uniform(0.55, 0.7, 2), "side": sides}
    shape["strut"] = size * rng.uniform(0.8, 0.95, 2)
    return shape | {"home": np.array([0.0, 0.95 * size]), "reach": 0.15 * size}


def orthoglide(rng: np.random.Generator) -> Geometry:
    """Nearly square guides, carriages ahead or behind."""
    size, side = drawn_size(rng), rng.choice([-1.0, 1.0])
    shape = {"guide": 0.05 * size * rng.normal(size=(3, 3))}
    shape["direction"] = np.eye(3) + 0.05 * rng.normal(size=(3, 3))
    shape |= {"strut": size * rng.uniform(0.95, 1.05, 3), "side": np.full(3, side)}
    return shape | {"home": np.zeros(3), "reach": 0.2 * size}


def pentapod(rng: np.random.Generator) -> Geometry:
    """Three legs from above, two from the sides."""
    size = drawn_size(rng)
    upper = _ring(rng, 0.8 * size, [90.0, 210.0, 330.0], 1.2 * size)
    lower = _ring(rng, 0.9 * size, [45.0, 135.0], 0.2 * size)
    height = size * np.array([0.7, 0.7, 0.7, 0.1, 0.1]) * rng.uniform(0.95, 1.05, 5)
    shape = {"base": np.vstack([upper, lower]), "height": height}
    shape |= {"radius": size * rng.uniform(0.06, 0.1, 5), "home": np.zeros(3)}
    return shape | {"reach": 0.08 * size, "tilt": 0.2}


# -- verdicts --------------------------------------------------------------------------
def _legs(geometry: Geometry, x: Array, q: Array) -> Verdict:
    v = _joints(geometry, x) - geometry["base"]
    return np.linalg.norm(v, axis=2) - q, _upright(x)


def _carriages(geometry: Geometry, x: Array, q: Array) -> tuple[Array, Array]:
    """Struts (n, limbs, 3) and directions (limbs, 3)."""
    u = np.asarray(geometry["direction"], dtype=float)
    u = u / np.linalg.norm(u, axis=1)[:, None]
    carriage = geometry["guide"] + q[:, :, None] * u
    return _joints(geometry, x) - carriage, u


def _sliders(geometry: Geometry, x: Array, q: Array) -> Verdict:
    v, u = _carriages(geometry, x, q)
    behind = -np.einsum("nki,ki->nk", v, u) * geometry["side"] < 0.0
    error = np.linalg.norm(v, axis=2) - geometry["strut"]
    return error, behind.any(axis=1) | _upright(x)


def _hinge_errors(geometry: Geometry, v: Array) -> Array:
    axis = geometry["axis"]
    axis = axis / np.linalg.norm(axis, axis=1)[:, None]
    return np.asarray(np.einsum("nki,ki->nk", v, axis))


def _rps(geometry: Geometry, x: Array, q: Array) -> Verdict:
    error, mirrored = _legs(geometry, x, q)
    v = _joints(geometry, x) - geometry["base"]
    return np.hstack([error, _hinge_errors(geometry, v)]), mirrored


def _prs(geometry: Geometry, x: Array, q: Array) -> Verdict:
    error, mirrored = _sliders(geometry, x, q)
    v, _ = _carriages(geometry, x, q)
    return np.hstack([error, _hinge_errors(geometry, v)]), mirrored


def passive_leg(geometry: Geometry, x: Array, q: Array) -> Verdict:
    error, mirrored = _legs(geometry, x, q)
    r, offset = rotations(x), geometry["pivot"] - x[:, :3]
    distance = np.linalg.norm(offset, axis=1)
    way = np.sign(geometry["pivot"][2] - geometry["home"][2])
    astray = offset - way * distance[:, None] * r[:, :, 2]
    angle = geometry["first_axis"]
    first = np.array([np.cos(angle), np.sin(angle), 0.0])
    second = np.array([-np.sin(angle), np.cos(angle), 0.0])
    square = distance * np.einsum("i,nij,j->n", first, r, second)
    return np.hstack([error, astray, square[:, None]]), mirrored


def _upr_spr(geometry: Geometry, x: Array, q: Array) -> Verdict:
    """All five constraints: planes of the three legs, axes of two universal joints."""
    error, mirrored = _legs(geometry, x, q)
    r = rotations(x)
    axes = np.stack([r[:, :, 1], r[:, :, 1], r[:, :, 0]], axis=1)
    planes = np.einsum("nki,nki->nk", _joints(geometry, x) - geometry["base"], axes)
    square = r[:, :1, 1] * np.abs(geometry["base"]).max()
    return np.hstack([error, planes, square]), mirrored


def _cables(geometry: Geometry, x: Array, q: Array) -> Verdict:
    v = x[:, None] - geometry["anchor"]
    return np.linalg.norm(v, axis=2) - q, np.zeros(len(x), dtype=bool)


def _delta(geometry: Geometry, x: Array, q: Array) -> Verdict:
    carriages = []
    for k in range(3):
        turn = Rotation.from_euler("z", geometry["angle"][k]).as_matrix()
        axis = turn @ [geometry["lean"][k], geometry["tip"][k], 1.0]
        radius, arm = geometry["radius"][k], geometry["arm"][k]
        travel = geometry["endstop"][k] + np.sqrt(arm**2 - radius**2) - q[:, k]
        foot = turn @ [radius, 0.0, 0.0]
        carriages.append(foot + travel[:, None] * axis / np.linalg.norm(axis))
    v = x[:, None] - np.stack(carriages, axis=1)
    below = (v[:, :, 2] < 0.0).all(axis=1)
    return np.linalg.norm(v, axis=2) - geometry["arm"], ~below


def _knees(
    x: Array, q: Array, centre: Array, axis: Array, first: Array, crank: Array
) -> tuple[Array, Array]:
    """Knees (n, limbs, 3) by turning the crank from its place at angle 0, and the axes."""
    axis = axis / np.linalg.norm(axis, axis=1)[:, None]
    flat = first - np.sum(first * axis, axis=1)[:, None] * axis
    flat *= (crank / np.linalg.norm(flat, axis=1))[:, None]
    knees = np.empty((*q.shape, 3))
    for k in range(q.shape[1]):
        turned = Rotation.from_rotvec(q[:, k, None] * axis[k]).apply(flat[k])
        knees[:, k] = centre[k] + turned
    return knees, axis


def _crank_verdict(
    ends: Array, knees: Array, axis: Array, centre: Array, strut: Array, side: Array
) -> Verdict:
    """Ahead is where the turn from the line to the platform joint is the crank's own."""
    turn = np.cross(ends - centre, knees - centre)
    ahead = np.einsum("nki,ki->nk", turn, axis) * side
    error = np.linalg.norm(ends - knees, axis=2) - strut
    return error, (ahead < 0.0).any(axis=1)


def _rotary_delta(geometry: Geometry, x: Array, q: Array) -> Verdict:
    angle = geometry["angle"]
    out = np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])
    radius, height = geometry["radius"], geometry["height"]
    along = radius + geometry["upper"] * np.cos(q)
    down = height - geometry["upper"] * np.sin(q)
    knees = along[:, :, None] * out + down[:, :, None] * [0.0, 0.0, 1.0]
    shoulder = radius[:, None] * out + height[:, None] * [0.0, 0.0, 1.0]
    # outward of the line from the shoulder to the tool, in the plane of the limb
    arm, line = knees - shoulder, x[:, None] - shoulder
    arm_out, line_out = (np.einsum("nki,ki->nk", v, out) for v in (arm, line))
    inward = arm_out * line[:, :, 2] - line_out * arm[:, :, 2] > 0.0
    error = np.linalg.norm(x[:, None] - knees, axis=2) - geometry["lower"]
    return error, inward.any(axis=1)


def _hexapod_rus(geometry: Geometry, x: Array, q: Array) -> Verdict:
    shape = [geometry[n] for n in ("centre", "axis", "first", "crank")]
    knees, axis = _knees(x, q, *shape)
    ends, centre = _joints(geometry, x), geometry["centre"]
    error, other = _crank_verdict(
        ends, knees, axis, centre, geometry["strut"], geometry["side"]
    )
    return error, other | _upright(x)


def _five_bar(geometry: Geometry, x: Array, q: Array) -> Verdict:
    arm = np.stack([np.cos(q), np.sin(q)], axis=2) * geometry["crank"][:, None]
    line = x[:, None] - geometry["centre"]
    error = np.linalg.norm(line - arm, axis=2) - geometry["strut"]
    turn = line[:, :, 0] * arm[:, :, 1] - line[:, :, 1] * arm[:, :, 0]
    return error, (turn * geometry["side"] < 0.0).any(axis=1)


def _orthoglide(geometry: Geometry, x: Array, q: Array) -> Verdict:
    u = geometry["direction"]
    u = u / np.linalg.norm(u, axis=1)[:, None]
    v = x[:, None] - geometry["guide"] - q[:, :, None] * u
    behind = -np.einsum("nki,ki->nk", v, u) * geometry["side"] < 0.0
    return np.linalg.norm(v, axis=2) - geometry["strut"], behind.any(axis=1)


def _pentapod(geometry: Geometry, x: Array, q: Array) -> Verdict:
    tilt = Rotation.from_rotvec(np.column_stack([x[:, 3:5], np.zeros(len(x))]))
    axis = tilt.as_matrix()[:, :, 2]
    offset = geometry["base"] - x[:, None, :3]
    along = np.einsum("nki,ni->nk", offset, axis)
    across = np.linalg.norm(np.cross(offset, axis[:, None]), axis=2)
    length = np.hypot(along - geometry["height"], across - geometry["radius"])
    return length - q, axis[:, 2] < 0.0


FAMILIES: dict[str, tuple[Callable[[np.random.Generator], Geometry], Any]] = {
    "delta": (delta, _delta), "hexapod_ups": (hexapod_ups, _legs),
    "hexapod_pus": (hexapod_pus, _sliders), "tripod_rps": (tripod_rps, _rps),
    "tripod_prs": (tripod_prs, _prs),
    "tripod_passive_leg": (tripod_passive_leg, passive_leg),
    "tripod_upr_spr": (tripod_upr_spr, _upr_spr),
    "cables_planar": (cables_planar, _cables),
    "cables_spatial": (cables_spatial, _cables),
    "rotary_delta": (rotary_delta, _rotary_delta),
    "hexapod_rus": (hexapod_rus, _hexapod_rus), "five_bar": (five_bar, _five_bar),
    "orthoglide": (orthoglide, _orthoglide), "pentapod": (pentapod, _pentapod),
}  # fmt: skip
