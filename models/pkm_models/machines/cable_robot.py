"""Cable robot on lines from spools, by default the printer Hangprinter HP4 with one line
more than degrees of freedom (A, B, C below, D above).

Line i runs from the mover x over the anchor A_i to its spool, a_i-fold. At the origin
it is line_i long; the motor has turned by q_i since, and the spool by t = q_i / G_i. A
metre of line that leaves the spool lowers the square of its radius by b, so a_i dl = r
dt with r^2 = r_i^2 - b a_i l gives r = r_i - b t / 2 and

    |A_i - x| = line_i + (r_i t - b t^2 / 4) / a_i.

This is what the firmware's k0 (sqrt(r^2 + k2 l) - r), k2 = -a b, gives for the motor,
solved for the line's change l. Lines stretch where readings record their tensions. Four
equations, three unknowns: see `oed.mechanism.kinematics` for where a redundant machine
settles.

`[machine.geometry]` states anchors, folds and gears of other printers, and the build-up b.
With `zeroed = 1` all motors were 0 at one place o with the lines taut, as a firmware has it:
line_i is |A_i - o|, and o and b are identified.

Numbers: github.com/tobbelobb/auto-calibration-simulation-for-hangprinter, branch
hp_mark_adjusted at 790dca2, simulation.py: gear 255/20, folds 2, 2, 2, 4, build-up
0.06875 mm, spools of 75 mm, line lengths at the origin measured by hand (read to 0.5
mm; 1 mm), anchors as "rough approximations from manual measuring" (50 mm).
"""

import dataclasses
import math

import casadi as ca
import numpy as np

from oed.base import Array
from oed.model import Dimension, Expr, Family, Machine, Parameter, Start, Strut, Values
from pkm_models.machines.parts import families, translation
from pkm_models.machines.parts.coordinates import joint, point
from pkm_models.machines.parts.translation import tool_point

LINES = (1, 2, 3, 4)  # A, B, C, D
GEAR = 255.0 / 20.0
BUILDUP = 0.06875e-3  # m
FOLD = {1: 2.0, 2: 2.0, 3: 2.0, 4: 4.0}
SPOOL = 0.075  # m
LINE = {1: 1.597, 2: 1.795, 3: 1.5825, 4: 2.355}  # m
NAME = "cable_robot"
BUILDUP_SD = 0.02e-3  # m: of a build-up that nobody measured
ORIGIN_SD = 0.010  # m: where a mover was set down
MOTOR = "turn of motor {} since the origin, paying out"
STIFFNESS = "E A of each line, which recorded tensions stretch; none: not known"
ZEROED = "1 where all motors were 0 at one place, with the lines taut"
_AT = {
    1: (1.620, -90.0),
    2: (1.800, 45.0),
    3: (1.620, 150.0),
}  # m, degrees: distance from the origin's axis, bearing
ANCHOR = {
    i: (
        round(r * math.cos(math.radians(bearing)), 6),
        round(r * math.sin(math.radians(bearing)), 6),
        -0.150,
    )
    for i, (r, bearing) in _AT.items()
} | {4: (0.0, 0.0, 2.350)}


DIMENSIONS = (
    Dimension("buildup", "m", (), BUILDUP, "what a metre on a spool adds to the square of its radius, over a metre"),
    Dimension("anchor", "m", (None, 3), tuple(ANCHOR.values()), "anchors, one for each line"),
    Dimension("fold", "1", (None,), tuple(FOLD.values()), "how often each line runs to its anchor"),
    Dimension("gear", "1", (None,), GEAR, "turns of the motors over those of the spools"),
    Dimension("stiffness", "N", (None,), None, STIFFNESS),
    Dimension("zeroed", "1", (), 0.0, ZEROED),
)  # fmt: skip


@dataclasses.dataclass(frozen=True, eq=False)
class _Lines:
    """Lines 1 to n: folds and gears (n,), and a build-up where it is no parameter, m."""

    fold: Array
    gear: Array
    buildup: float
    zeroed: bool

    @property
    def numbers(self) -> range:
        """Numbers of the lines, from 1."""
        return range(1, len(self.fold) + 1)

    def ends(self, x: Values, p: Values) -> list[Strut]:
        """Anchors and mover (3,)."""
        return [(families.point(p, "anchor", i), tool_point(x)) for i in self.numbers]

    def changes(self, x: Values, p: Values) -> list[Expr]:
        """What each line has more than at the origin, m."""
        changes = []
        for i, (anchor, mover) in zip(self.numbers, self.ends(x, p), strict=True):
            at_origin = p.get(f"line{i}")
            if self.zeroed:
                origin = ca.vertcat(*[p[f"origin_{k}"] for k in "xyz"])
                at_origin = ca.norm_2(anchor - origin)
            changes.append(ca.norm_2(anchor - mover) - at_origin)
        return changes

    def closure(self, x: Values, q: Values, p: Values) -> list[Expr]:
        """Line lengths; m."""
        rows = []
        buildup = p["buildup"] if self.zeroed else self.buildup
        for k, change in enumerate(self.changes(x, p)):
            turned = q[f"q{k + 1}"] / self.gear[k]
            paid_out = p[f"radius{k + 1}"] * turned - buildup * turned**2 / 4.0
            rows.append(change - paid_out / self.fold[k])
        return rows

    def guess(self, c: Values, p: Values) -> Start:
        """The commanded point, and motor angles without build-up."""
        motors = [
            self.fold[k] * change / p[f"radius{k + 1}"] * self.gear[k]
            for k, change in enumerate(self.changes(c, p))
        ]
        return [c["x"], c["y"], c["z"]], motors


def build(geometry: families.Geometry) -> Machine:
    """The robot with other lines. Raises ValueError where they are none."""
    table = families.completed(DIMENSIONS, geometry)
    buildup, anchors = (
        families.number(table, "buildup"),
        families.array(table, "anchor"),
    )
    if buildup < 0.0:
        raise ValueError("buildup is below 0: a line on its spool adds to the radius")
    count = len(anchors)
    stated = math.inf if table["stiffness"] is None else table["stiffness"]
    fold, gear, stiffness = (
        families.limb_rows(values, count)
        for values in (table["fold"], table["gear"], stated)
    )
    if min(fold.min(), gear.min(), stiffness.min()) <= 0.0 or count < 3:
        raise ValueError("three lines or more, with folds, gears and stiffness above 0")
    lines = _Lines(fold, gear, buildup, bool(table["zeroed"]))
    return translation.machine(
        (0.0, 0.0, 0.0),
        (point("x", -0.400, 0.400), point("y", -0.400, 0.400), point("z", 0.0, 1.400)),
        name=NAME,
        source="Hangprinter HP4: github.com/tobbelobb/auto-calibration-simulation-for-hangprinter (MIT), at 790dca2",
        about="cable robot, four lines for three degrees of freedom: x, y, z driven, one line redundant",
        joints=tuple(joint(f"q{i}", "rad", -1200.0, 600.0, MOTOR) for i in lines.numbers),
        base_frame="origin where the mover was when the lines' lengths were read; z up; axes of the anchors'"
        " coordinates",
        parameters=(
            *families.places("anchor", anchors, 0.050, "anchor"),
            *families.numbers("radius", [SPOOL] * count, 1.0e-3, "m", "spool radius at the origin of line"),
            *_zeros(lines, anchors),
        ),
        lever=1.6,
        cable_stiffness=tuple(stiffness.tolist()),
        family=family,
        closure=lines.closure,
        guess=lines.guess,
        skeleton=lambda x, q, p: [list(line) for line in lines.ends(x, p)],
        struts=lambda x, q, p: lines.ends(x, p),
    )  # fmt: skip


def _zeros(lines: _Lines, anchors: Array) -> list[Parameter]:
    """What the lines count from: the origin, with the build-up; or lengths of their own."""
    if lines.zeroed:
        origin = "{} of the mover where the motors were 0"
        return [
            *(
                Parameter(f"origin_{k}", 0.0, ORIGIN_SD, "m", origin.format(k))
                for k in "xyz"
            ),
            Parameter(
                "buildup", lines.buildup, BUILDUP_SD, "m", "build-up of the spools"
            ),
        ]
    is_usual = np.array_equal(anchors, [*ANCHOR.values()])
    lengths = [*LINE.values()] if is_usual else np.linalg.norm(anchors, axis=1).tolist()
    return [
        Parameter(f"line{i}", v, 1.0e-3, "m", f"length of line {i} at the origin")
        for i, v in enumerate(lengths, start=1)
    ]


family = Family(NAME, DIMENSIONS, build)
machine = build({})
