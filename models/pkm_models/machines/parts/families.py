"""What families of machines have in common: geometry by table, ranges, points."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Coordinate, Dimension, Expr, Parameter, PointGroup, Values
from pkm_models.machines.parts.coordinates import joint

Geometry = Mapping[str, Any]  #: a table of geometry, SI, by name
XYZ = "xyz"
#: standard deviation of places and lengths over the machine's size, where none is given
RELATIVE_TOLERANCE = 1e-3
#: share by which joints may exceed what their nominal geometry needs
JOINT_MARGIN = 0.5


def completed(dimensions: Sequence[Dimension], geometry: Geometry) -> dict[str, Any]:
    """The table with defaults in place of what is not given, None if derived."""
    return {d.name: geometry.get(d.name, d.default) for d in dimensions}


def array(table: Geometry, name: str) -> Array:
    """An entry as an array."""
    return np.asarray(table[name], dtype=float)


def number(table: Geometry, name: str) -> float:
    """An entry as a number."""
    return float(table[name])


def largest(points: Array) -> float:
    """Largest length of points or vectors (n, 3), m."""
    return float(np.linalg.norm(points, axis=1).max())


def by_name(coordinates: Sequence[Coordinate], values: Sequence[Expr]) -> Values:
    """Values by the names of their coordinates."""
    names = [c.name for c in coordinates]
    return dict(zip(names, values, strict=True))


def tolerance_dimension() -> Dimension:
    """The accuracy to which places and lengths are known before."""
    about = "standard deviation of places and lengths, a thousandth of the size"
    return Dimension("tolerance", "m", (), None, about)


def tolerance(table: Geometry, size: float) -> float:
    """Standard deviation of places and lengths, m."""
    stated = table["tolerance"]
    return RELATIVE_TOLERANCE * size if stated is None else float(stated)


def places(
    stem: str, points: Array, sd: float, about: str, axes: str = XYZ
) -> list[Parameter]:
    """Coordinates of points (n, len(axes)): `b1x`, `b1y`, ..."""
    return [
        Parameter(f"{stem}{i}{k}", float(v), sd, "m", f"{k} of {about} {i}")
        for i, point in enumerate(points, start=1)
        for k, v in zip(axes, point, strict=True)
    ]


def numbers(
    stem: str, values: Sequence[float], sd: float, unit: str, about: str
) -> list[Parameter]:
    """One parameter a limb: `l1`, `l2`, ..."""
    return [
        Parameter(f"{stem}{i}", float(v), sd, unit, f"{about} {i}")
        for i, v in enumerate(values, start=1)
    ]


def point_group(
    name: str, origin: str, stem: str, points_at: Sequence[tuple[float, float, float]]
) -> PointGroup:
    """Points of limbs 1, 2, ... that may shift and turn as one, `da1x`, `da1y`, ..."""
    numbered = enumerate(points_at, start=1)
    points = tuple(
        ((f"{stem}{i}x", f"{stem}{i}y", f"{stem}{i}z"), point_)
        for i, point_ in numbered
    )
    return PointGroup(name, origin, points)


def point(p: Values, stem: str, i: int) -> Expr:
    """Point (3,) of a limb."""
    return ca.vertcat(*[p[f"{stem}{i}{k}"] for k in XYZ])


def shifted(
    drawn: Sequence[float], p: Values, stem: str, axes: str = XYZ
) -> list[Expr]:
    """Coordinates of a point as drawn with its errors `da1x`, ... of a stem `da1`."""
    return [v + p[f"{stem}{k}"] for v, k in zip(drawn, axes, strict=True)]


def joint_ranges(
    lower: float, upper: float, count: int, about: str
) -> tuple[Coordinate, ...]:
    """Joints `q1`, `q2`, ... with one range, m, widened."""
    margin = JOINT_MARGIN * (upper - lower)
    low, high = lower - margin, upper + margin
    return tuple(joint(f"q{i + 1}", "m", low, high, about) for i in range(count))


def around(
    lengths: Array, change: float, count: int, about: str
) -> tuple[Coordinate, ...]:
    """Ranges of legs that change by so much from lengths at home, m; above 0."""
    shortest = float(lengths.min())
    low = max(shortest - change, 0.01 * shortest)
    high = float(lengths.max()) + change
    return tuple(joint(f"q{i + 1}", "m", low, high, about) for i in range(count))


def limb_rows(value: Any, count: int) -> Array:
    """One number for each limb (count,), from one for all or one each."""
    return np.broadcast_to(np.asarray(value, dtype=float), (count,)).copy()


def unit_vectors(value: Any, count: int) -> Array:
    """Directions (count, 3) of length one. Raises ValueError for a zero direction."""
    vectors = np.broadcast_to(np.asarray(value, dtype=float), (count, 3))
    lengths = np.linalg.norm(vectors, axis=1)
    if not (lengths > 0.0).all():
        raise ValueError("a direction is zero: give three numbers that are not all 0")
    return np.asarray(vectors / lengths[:, None])


def ring_points(
    radius: float, degrees: Sequence[float], height: float
) -> list[tuple[float, float, float]]:
    """Points on a horizontal circle."""
    angles = [math.radians(d) for d in degrees]
    return [(radius * math.cos(a), radius * math.sin(a), height) for a in angles]


def ring(radius: float, degrees: Sequence[float], height: float) -> Array:
    """Points (n, 3) on a horizontal circle."""
    return np.array(ring_points(radius, degrees, height))


def positive(table: Geometry, *names: str) -> None:
    """Refuse lengths that are not above 0. Raises ValueError."""
    for name in names:
        if table[name] is not None and not (np.asarray(table[name]) > 0.0).all():
            raise ValueError(f"{name} must be above 0")
