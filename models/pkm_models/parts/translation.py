"""What machines share whose platform only translates, held by parallelograms or a point."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import casadi as ca

from oed.base.arrays import Array
from oed.model.machine import Coordinate, Dimension, Expr, Machine, Values
from pkm_models.parts import coordinates, families


def ranges_dimensions(home: Sequence[float], reach: float) -> tuple[Dimension, ...]:
    """Home of the tool point, how far the workspace reaches about it, the tolerance."""
    return (
        Dimension("home", "m", (len(home),), tuple(home), "tool point at home"),
        Dimension("reach", "m", (), reach, "half the workspace's width about home"),
        families.tolerance_dimension(),
    )


def command(home: Array, reach: float) -> tuple[Coordinate, ...]:
    """Tool point within `reach` (m) of home (2,) or (3,) along each axis."""
    return tuple(
        coordinates.point(name, middle - reach, middle + reach)
        for name, middle in zip("xyz", home.tolist(), strict=False)
    )


def tool_point(x: Values) -> Expr:
    """Tool point (3,); z is 0 where a machine moves in x and y alone."""
    return ca.vertcat(x["x"], x["y"], x.get("z", 0.0))


def machine(home: Array, reach: float, **fields: Any) -> Machine:
    """A machine whose tool point moves in as many axes as home (2,) or (3,) has."""
    axes = "xyz"[: len(home)]
    return Machine(
        pose=coordinates.points(axes),
        command=command(home, reach),
        components=coordinates.point_errors(axes),
        home=dict(zip(axes, home.tolist(), strict=True)),
        platform=lambda x: (ca.SX.eye(3), tool_point(x)),
        commanded=lambda x, tip: [tip[k] for k in range(len(axes))],
        target=lambda c: [c[n] for n in axes],
        read_error=lambda c, twist: list(twist[: len(axes)]),
        **fields,
    )
