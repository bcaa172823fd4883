"""Cable robots in the plane and in space, with any number of cables.

Cable i runs straight from the anchor A_i to the mover's point E_i, and its drum pays
out (1 + scale_i) q_i of it:

    |A_i - (x + R E_i)| = l_i + (1 + scale_i) q_i.

Without points E_i all cables end in the tool point and the mover is a point. Cables do
not sag; they stretch where readings record their tensions, see `oed.dataset.csv_input`.
More cables than coordinates are redundant: see `oed.mechanism.kinematics` for where such a
machine settles.
"""

import math
from collections.abc import Sequence
from typing import Any

import casadi as ca
import numpy as np

from oed.base import Orientation
from oed.model import Coordinate, Dimension, Expr, Start, Values
from pkm_models.machines.parts import coordinates, families
from pkm_models.machines.parts.coordinates import (
    POSE_ORIENTATION,
    angle,
    joint,
    point_error,
    turn_error,
)
from pkm_models.machines.parts.families import Geometry
from pkm_models.rotation import tilt_torsion, z_rotation

SCALE_SD = 0.5e-3  #: prior standard deviation of the drums' scales
ATTACH = "the cables' points on the mover, from the tool point; all 0 for a point"
STIFFNESS = "E A of each cable, which recorded tensions stretch; none: not known"
TURNS = {2: ("spin",), 3: ("rx", "ry", "spin")}
#: share of the smallest side of the anchors' box that a workspace amid them reaches
WORKSPACE_SHARE = 0.25
#: smallest side of that box over its largest from which anchors surround a mover; thinner,
#: as of a ceiling, it hangs from them
HANGING_SHARE = 0.25
#: sense of the joints, and of z of a mover that turns
PAID_OUT = "length of cable {} that its drum has paid out, less its zero"
TOOL_AXIS = "z of the frame of the cables' points on the mover"
ERRORS = {2: ("az",), 3: ("ax", "ay", "az")}


def dimensions(
    axes: int, anchors: Any, attach: Any, home: Sequence[float], reach: float
) -> tuple[Dimension, ...]:
    """The table of geometry in the plane (2) or in space (3), with the model's numbers."""
    return (
        Dimension("anchor", "m", (None, axes), anchors, "anchors, one for each cable"),
        Dimension("attach", "m", (None, axes), attach, ATTACH),
        Dimension("home", "m", (axes,), tuple(home), "tool point at home"),
        Dimension("reach", "m", (), reach, "half the workspace's width about home"),
        Dimension("turn", "rad", (), math.radians(10.0), "largest turn, either way"),
        Dimension("stiffness", "N", (None,), None, STIFFNESS),
        families.tolerance_dimension(),
    )


def completed(dimensions: Sequence[Dimension], geometry: Geometry) -> dict[str, Any]:
    """The table with defaults; home is amid anchors that surround a place without it."""
    table = families.completed(dimensions, geometry)
    anchors, home = families.array(table, "anchor"), families.array(table, "home")
    low, high = anchors.min(axis=0), anchors.max(axis=0)
    sides = high - low
    surround = sides.min() > HANGING_SHARE * sides.max()
    is_amid = ((low < home) & (home < high)).all()
    if "home" not in geometry and surround and not is_amid:
        reach = WORKSPACE_SHARE * float(sides.min())
        table |= {"home": anchors.mean(axis=0), "reach": reach, **geometry}
    return table


def build(name: str, source: str, table: Geometry, axes: int) -> dict[str, Any]:
    """Arguments of the `Machine` of this geometry. Raises ValueError."""
    anchors = np.asarray(table["anchor"], dtype=float)
    attach = table["attach"]
    body = attach is not None and bool(np.any(np.asarray(attach) != 0.0))
    count = len(anchors)
    turns = TURNS[axes] if body else ()
    if body and np.shape(attach) != anchors.shape:
        raise ValueError("attach must have one point for each anchor")
    if count < axes + len(turns):
        raise ValueError(
            f"{count} cables are fewer than the {axes + len(turns)} coordinates"
        )
    families.positive(table, "reach", "turn")
    home = [float(v) for v in table["home"]]
    names = "xyz"[:axes]
    span = families.largest(anchors - home)
    sd, reach = families.tolerance(table, span), float(table["reach"])
    mover = _Mover(names, turns, count)
    parameters = families.places("anchor", anchors, sd, "anchor", names)
    if body:
        parameters += families.places(
            "end", np.asarray(attach), sd, "end of cable", names
        )
    parameters += families.numbers("l", [0.0] * count, sd, "m", "zero of cable")
    about = "relative error of the drum's scale of cable"
    parameters += families.numbers("scale", [0.0] * count, SCALE_SD, "1", about)
    turn = float(table["turn"])
    orientation = _orientation(turns)
    command = [*coordinates.points_about(home, reach)]
    if orientation is not None:
        command += [angle(n, -turn, turn, of=orientation) for n in turns]
    errors = [point_error(n) for n in names]
    errors += [turn_error(n) for n in ERRORS[axes] if turns]
    return {
        "name": name,
        "source": source,
        "pose": tuple(Coordinate(c.name, c.unit, about=c.about) for c in command),
        "joints": tuple(
            joint(f"q{i}", "m", -span, 3.0 * (span + reach), PAID_OUT)
            for i in mover.cables
        ),
        "base_frame": "that of the anchors' coordinates",
        "tool_axis": TOOL_AXIS if turns else "",
        "orientation": orientation,
        "command_orientation": orientation,
        "command": tuple(command),
        "parameters": tuple(parameters),
        "components": tuple(errors),
        "home": dict(zip(names, home, strict=True)) | dict.fromkeys(turns, 0.0),
        "lever": families.largest(attach) if body else span,
        "closure": mover.closure,
        "platform": mover.platform,
        "commanded": mover.commanded,
        "target": mover.target,
        "guess": mover.guess,
        "read_error": mover.read_error,
        "cable_stiffness": _stiffness(table, count),
        "skeleton": lambda x, q, p: [list(mover.ends(x, p, i)) for i in mover.cables],
        "struts": lambda x, q, p: [mover.ends(x, p, i) for i in mover.cables],
    }


def _orientation(turns: Sequence[str]) -> Orientation | None:
    """How the mover's angles make its rotation; None where it does not turn."""
    if not turns:
        return None
    return Orientation.rotation(("z", "spin")) if len(turns) == 1 else POSE_ORIENTATION


def _stiffness(table: Geometry, count: int) -> tuple[float, ...]:
    """E A of each cable, N; inf where it is not known. Raises ValueError."""
    if table["stiffness"] is None:
        return (math.inf,) * count
    families.positive(table, "stiffness")
    if np.size(table["stiffness"]) not in (1, count):
        raise ValueError(
            "stiffness must have one number for each cable, or one for all"
        )
    return tuple(families.limb_rows(table["stiffness"], count).tolist())


class _Mover:
    """A point or a body on cables: axes `x`, `y`, ..., and the turns of a body."""

    def __init__(self, axes: str, turns: Sequence[str], count: int) -> None:
        self.axes = axes
        self.turns = tuple(turns)
        self.cables = range(1, count + 1)

    def platform(self, x: Values) -> tuple[Expr, Expr]:
        origin = ca.vertcat(*[x[n] if n in self.axes else 0.0 for n in "xyz"])
        if not self.turns:
            return ca.SX.eye(3), origin
        if len(self.turns) == 1:
            return z_rotation(x["spin"]), origin
        return tilt_torsion(x["rx"], x["ry"], x["spin"]), origin

    def ends(self, x: Values, p: Values, i: int) -> tuple[Expr, Expr]:
        """Anchor and mover's point (3,) of a cable."""
        rotation, origin = self.platform(x)
        anchor = self._point(p, "anchor", i)
        if not self.turns:
            return anchor, origin
        return anchor, origin + rotation @ self._point(p, "end", i)

    def _point(self, p: Values, stem: str, i: int) -> Expr:
        return ca.vertcat(
            *[p[f"{stem}{i}{k}"] if k in self.axes else 0.0 for k in "xyz"]
        )

    def length(self, x: Values, p: Values, i: int) -> Expr:
        """Length of a cable less its zero, m."""
        anchor, end = self.ends(x, p, i)
        return ca.norm_2(anchor - end) - p[f"l{i}"]

    def closure(self, x: Values, q: Values, p: Values) -> list[Expr]:
        """Cable lengths; m."""
        return [
            self.length(x, p, i) - (1.0 + p[f"scale{i}"]) * q[f"q{i}"]
            for i in self.cables
        ]

    def guess(self, c: Values, p: Values) -> Start:
        """The commanded pose and its cables."""
        joints = [self.length(c, p, i) / (1.0 + p[f"scale{i}"]) for i in self.cables]
        return self.target(c), joints

    def commanded(self, x: Values, tip: Expr) -> list[Expr]:
        return [tip[k] for k in range(len(self.axes))] + [x[n] for n in self.turns]

    def target(self, c: Values) -> list[Expr]:
        return [c[n] for n in (*self.axes, *self.turns)]

    def read_error(self, c: Values, twist: Sequence[Expr]) -> list[Expr]:
        rotation = list(twist[3:]) if len(self.turns) == 3 else [twist[5]]
        return [*twist[: len(self.axes)], *(rotation if self.turns else [])]
