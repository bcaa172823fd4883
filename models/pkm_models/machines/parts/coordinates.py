"""Coordinates and pose errors with what they mean: frame, order, sense.

Every machine states its columns with these, so that one name means one thing.
"""

from collections.abc import Sequence

import numpy as np

from oed.base import Orientation
from oed.model import Component, Coordinate

#: orientation of a platform that tilts and spins, and direction of its tool axis
POSE_ORIENTATION = Orientation.tilt_and_spin("rx", "ry", "spin")
TILT_DIRECTION = Orientation.tilt("rx", "ry")
ANGLES = {
    "rx": "x of the tilt's rotation vector in the base frame, right-handed",
    "ry": "y of the tilt's rotation vector in the base frame, right-handed",
    "spin": "rotation about z of the platform, right-handed",
}


def point(name: str, lower: float = -np.inf, upper: float = np.inf) -> Coordinate:
    """A coordinate of the tool point, m."""
    about = f"{name} of the tool point in the base frame"
    return Coordinate(name, "m", lower, upper, about)


def points(names: str = "xyz") -> tuple[Coordinate, ...]:
    """Coordinates of the tool point without ranges, m."""
    return tuple(point(name) for name in names)


def points_about(home: Sequence[float], reach: float) -> tuple[Coordinate, ...]:
    """Coordinates of the tool point within `reach` of home (2,) or (3,), m."""
    pairs = zip("xyz", home, strict=False)
    return tuple(point(name, v - reach, v + reach) for name, v in pairs)


def angle(
    name: str,
    lower: float = -np.inf,
    upper: float = np.inf,
    *,
    of: Orientation = POSE_ORIENTATION,
) -> Coordinate:
    """`rx`, `ry` or `spin`, rad, of an orientation."""
    return Coordinate(name, "rad", lower, upper, f"{ANGLES[name]}; {of.formula}")


def angles(names: tuple[str, ...] = tuple(ANGLES)) -> tuple[Coordinate, ...]:
    """`rx`, `ry` and `spin` without ranges, rad."""
    return tuple(angle(name) for name in names)


def joint(name: str, unit: str, lower: float, upper: float, about: str) -> Coordinate:
    """A joint with the sense of its scale; `about` may hold its number as `{}`."""
    return Coordinate(name, unit, lower, upper, about.format(name.lstrip("q")))


def point_error(name: str, *, driven: bool = True) -> Component:
    """An error of the tool point, m."""
    about = f"{name} of the tool point, actual less wanted, in the base frame"
    return Component(name, "m", driven, about)


def point_errors(names: str = "xyz") -> tuple[Component, ...]:
    """Errors of the tool point that the joints correct, m."""
    return tuple(point_error(name) for name in names)


def turn_error(name: str, *, driven: bool = True) -> Component:
    """An error of the orientation, `ax`, `ay` or `az`, rad."""
    about = (
        f"{name[-1]} of the rotation vector from the wanted to the actual orientation,"
        " in the base frame, right-handed"
    )
    return Component(name, "rad", driven, about)
