"""The family and the geometry of a drawn machine, for a study."""

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_models.rotation import across
from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.drafts.bodies import xml_file
from pkm_studies.drafts.bodies.tree import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    BodyLoop,
    BodyTree,
    PlacedJoint,
    detached,
)
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import replace_nominal, unreachable
from pkm_studies.user_code import Origin

# Limbs of a tree of bodies: legs, carriages and cranks, and where their loops close.
#
# The file may draw its driven joints at other values than those at which the loops close,
# as URDF does. Gauss-Newton steps of the driven joints and the tool point close them; the
# platform keeps the orientation in which it is drawn.

LEG, CARRIAGE, CRANK = "leg", "carriage", "crank"
#: m or 1; what is off by less is in its place, as drawings are rounded
SAME_POINT = 1e-6
STEPS, CLOSED = 50, 1e-12
MAX_LOOPS = 100  #: loops of a file: more limbs than any machine has
KINDS = (
    "a limb is a leg (a universal or ball joint at the base, then a slide along it), or a"
    " strut with such a joint on a slide or on a hinge"
)


@dataclasses.dataclass
class DrawnLimb:
    """A limb as drawn, in the base frame; m, rad."""

    kind: str  #: `leg`, `carriage` or `crank`
    drive: PlacedJoint  #: its driven joint
    start: Array  #: (3,) of the strut
    end: Array  #: (3,) of the strut, at the platform
    local: Array  #: (3,) the same from the tool point
    #: of the driven joint, from the drawing to where the loops close
    motion: float = 0.0

    @property
    def strut(self) -> float:
        """Length of the strut as drawn."""
        return float(np.linalg.norm(self.end - self.start))

    @property
    def extension(self) -> float:
        """Length of a leg as drawn, along its slide; a drawing at a joint of 0 may have none."""
        return float((self.end - self.start) @ self.drive.axis)

    def end_at(self, motion: float) -> Array:
        """The strut's end (3,) after a motion of the driven joint alone."""
        axis, anchor = self.drive.axis, self.drive.at
        if self.kind == CRANK:
            turned = Rotation.from_rotvec(motion * axis).apply(self.end - anchor)
            return np.asarray(anchor + turned)
        return np.asarray(self.end + motion * axis)

    def slope(self, motion: float) -> Array:
        """Slope (3,) of the end over the motion."""
        axis, anchor = self.drive.axis, self.drive.at
        if self.kind == CRANK:
            return np.cross(axis, self.end_at(motion) - anchor)
        return axis


@dataclasses.dataclass(frozen=True)
class DrawnMachine:
    """Limbs, the axes along which the platform moves, and whether it turns."""

    limbs: tuple[DrawnLimb, ...]
    axes: Array
    turns: bool
    home: Array  #: (3,) tool point where the loops close


def drawn_machine(tree: BodyTree, location: Location) -> DrawnMachine:
    """The machine of a tree. Raises InputError where it is none of the kinds above."""
    platform = _platform(tree, location)
    axes, turns = _freedoms(tree.joints(platform), platform, location)
    tool = tree.point(platform, tree.tools.get(platform, np.zeros(3)))
    limbs = [_limb(tree, loop, platform, tool, location) for loop in tree.loops]
    home = _close(limbs, tool, axes, location)
    drives = {id(limb.drive.joint) for limb in limbs}
    if len(drives) < len(limbs):
        limbs, turns = _parallelograms(limbs, location), False
    return DrawnMachine(tuple(limbs), axes, turns, home)


def _parallelograms(limbs: list[DrawnLimb], location: Location) -> list[DrawnLimb]:
    """One limb for two parallel rods on a drive. Raises InputError for other pairs."""
    pairs: dict[int, list[DrawnLimb]] = {}
    for limb in limbs:
        pairs.setdefault(id(limb.drive.joint), []).append(limb)
    merged = []
    for pair in pairs.values():
        first, last = pair[0], pair[-1]
        skew = last.start - first.start - (last.local - first.local)
        if len(pair) != 2 or np.abs(skew).max() > SAME_POINT:
            raise location.error(
                f"{len(pair)} limbs on {first.drive.joint.name} are no two parallel rods",
                "give each limb a drive of its own, or each drive two parallel rods",
            )
        means = {
            name: 0.5 * (getattr(first, name) + getattr(last, name))
            for name in ("start", "end", "local")
        }
        merged.append(dataclasses.replace(first, **means))
    return merged


def _platform(tree: BodyTree, location: Location) -> str:
    shared = set.intersection(*({loop.first, loop.second} for loop in tree.loops))
    if len(shared) != 1 or not 2 <= len(tree.loops) <= MAX_LOOPS:
        raise location.error(
            f"its {len(tree.loops)} loops do not share one body, the platform",
            "close each limb by a connection to the platform",
        )
    return shared.pop()


def _freedoms(
    joints: list[PlacedJoint], platform: str, location: Location
) -> tuple[Array, bool]:
    """Directions (n, 3) in which a platform moves, and whether it turns."""
    kinds = [placed.joint.kind for placed in joints]
    axes = np.array([p.axis for p in joints if p.joint.kind == SLIDE]).reshape(-1, 3)
    square = np.abs(axes @ axes.T - np.eye(len(axes))).max(initial=0.0) < SAME_POINT
    turning = [k for k in kinds if k != SLIDE]
    if kinds == [FREE]:
        return np.eye(3), True
    if square and len(axes) == 3 and turning in ([BALL], [HINGE] * 3):
        return np.eye(3), True
    if square and len(axes) in (2, 3) and not turning:
        return axes, False
    raise location.error(
        f"body {platform} has the joints {', '.join(kinds) or 'none'}",
        "a platform is free, or has two or three square slides",
    )


def _limb(
    tree: BodyTree, loop: BodyLoop, platform: str, tool: Array, location: Location
) -> DrawnLimb:
    ends = [(loop.first, loop.on_first), (loop.second, loop.on_second)]
    if loop.first == platform:
        ends.reverse()
    (body, on_body), (_, on_platform) = ends
    end = tree.point(body, on_body)
    local = tree.point(platform, on_platform) - tool
    joints = tree.joints(body)
    kinds = [placed.joint.kind for placed in joints]
    if len(joints) >= 2 and kinds[-1] == SLIDE:
        kind, drive, passive = LEG, joints[-1], joints[:-1]
    elif len(joints) >= 2 and kinds[0] in (SLIDE, HINGE):
        kind = CARRIAGE if kinds[0] == SLIDE else CRANK
        drive, passive = joints[0], joints[1:]
    else:
        raise location.error(
            f"body {body} hangs on {', '.join(kinds) or 'nothing'}", KINDS
        )
    if any(p.joint.kind not in (HINGE, BALL) for p in passive):
        raise location.error(f"body {body} hangs on {', '.join(kinds)}", KINDS)
    start = _meeting_point(passive, end, body, location)
    limb = DrawnLimb(kind, drive, start, end, local)
    across = end - start - limb.extension * drive.axis
    if kind == LEG and np.linalg.norm(across) > SAME_POINT:
        raise _no_leg(limb, location)
    return limb


def _no_leg(limb: DrawnLimb, location: Location) -> InputError:
    return location.error(
        f"{limb.drive.joint.name} does not move along the leg from its base joint",
        "a leg's slide runs from the base joint to the platform joint, and grows",
    )


def _meeting_point(
    passive: list[PlacedJoint], end: Array, body: str, location: Location
) -> Array:
    """Where the axes of hinges meet, or a ball joint is; of one hinge, across the end."""
    balls = [p.at for p in passive if p.joint.kind == BALL]
    if balls and len(passive) == 1:
        return balls[0]
    if len(passive) == 1:
        only = passive[0]
        return np.asarray(only.at + (end - only.at) @ only.axis * only.axis)
    across = [np.eye(3) - np.outer(p.axis, p.axis) for p in passive]
    right = [a @ p.at for a, p in zip(across, passive, strict=True)]
    point = np.linalg.lstsq(np.vstack(across), np.concatenate(right), rcond=1e-9)[0]
    missed = [a @ (point - p.at) for a, p in zip(across, passive, strict=True)]
    size = max(1.0, float(np.abs(end).max()))
    if balls or np.abs(missed).max() > SAME_POINT * size:
        raise location.error(f"the passive joints of body {body} do not meet", KINDS)
    return np.asarray(point)


def _close(
    limbs: list[DrawnLimb], tool: Array, axes: Array, location: Location
) -> Array:
    """Move the driven joints until the loops close; the tool point (3,) there."""
    count, freedoms = len(limbs), len(axes)
    moves = np.zeros(freedoms + count)
    for _ in range(STEPS):
        rows, gaps = [], []
        for k, limb in enumerate(limbs):
            motion = moves[freedoms + k]
            point = tool + moves[:freedoms] @ axes
            gaps.append(point + limb.local - limb.end_at(motion))
            row = np.zeros((3, freedoms + count))
            row[:, :freedoms], row[:, freedoms + k] = axes.T, -limb.slope(motion)
            rows.append(row)
        if np.abs(gaps).max() < CLOSED:
            break
        moves -= np.linalg.lstsq(np.vstack(rows), np.concatenate(gaps), rcond=1e-12)[0]
    open_by = float(np.abs(gaps).max())
    if open_by > SAME_POINT:
        raise location.error(
            f"the loops are open by {open_by:.3g} m as they are drawn",
            "draw the passive joints as they are where the loops close",
        )
    for limb, motion in zip(limbs, moves[freedoms:], strict=True):
        limb.motion = float(motion)
        if limb.kind == LEG and limb.extension + limb.motion <= 0.0:
            raise _no_leg(limb, location)
    return np.asarray(tool + moves[:freedoms] @ axes)


SUFFIXES = (".xml", ".urdf")
REACH = 0.08  #: first half width of the workspace over the largest length
TILT = 0.08  #: largest tilt, rad
HALVINGS = 6  #: times that a workspace out of reach is halved, at most
TOLERANCE = 1e-9
STRAIGHT_ANGLE = 1e-6  #: rad; a knee that bends by less is drawn straight
MAX_SLOPE = 0.1  #: slope of a rotary delta's axes, at most
UPWARD = np.array([0.0, 0.0, 1.0])


@dataclasses.dataclass(frozen=True)
class Described:
    """A machine of a family: its geometry and numbers beside it, SI; sentences on both."""

    machine: Machine
    geometry: dict[str, Any]
    nominal: dict[str, float]
    sentences: tuple[str, ...]


def is_model_file(reference: str) -> bool:
    """Whether a machine is named by a file of bodies and joints."""
    return Path(reference).suffix.lower() in SUFFIXES


def described(path: Path, loops: Path | None) -> Described:
    """The machine of a file. Raises InputError for what it does not read."""
    location = Location(str(path))
    if path.suffix.lower() == ".urdf":
        tree = xml_file.read_urdf(path, loops)
    else:
        if loops is not None:
            raise location.error("MJCF holds its own loops", "leave out --loops")
        tree = detached(xml_file.read_mjcf(path))
    drawn = drawn_machine(tree, location)
    kinds = {limb.kind for limb in drawn.limbs}
    key = (kinds.pop() if len(kinds) == 1 else "", len(drawn.axes), drawn.turns)
    if key not in FAMILIES or len(drawn.limbs) != COUNTS[key]:
        listed = ", ".join(limb.kind for limb in drawn.limbs)
        freedoms = 6 if drawn.turns else len(drawn.axes)
        raise location.error(
            f"no family has a platform of {freedoms} freedoms on the limbs {listed}",
            "six legs, carriages or cranks hold a free platform, three carriages or cranks"
            " one with slides, two cranks one in the plane of x and y",
        )
    name, geometry_of = FAMILIES[key]
    family = catalogue.machine(name, Origin(), location).family
    geometry, nominal = geometry_of(drawn, location)
    machine, geometry = _reachable(family, geometry, nominal, location)
    joints = ", ".join(
        f"{j.name} is {limb.drive.joint.name}"
        for j, limb in zip(machine.joints, drawn.limbs, strict=True)
    )
    sentences = [f"{machine.name} of {path.name}: {joints}"]
    if drawn.turns:
        sentences.append("orientations count from that in which the platform is drawn")
    if tree.ignored:
        sentences.append(
            f"not read, for the geometry does not need it: {', '.join(tree.ignored)}"
        )
    return Described(machine, geometry, nominal, tuple(sentences))


def _reachable(
    family: Any, geometry: dict[str, Any], nominal: dict[str, float], location: Location
) -> tuple[Machine, dict[str, Any]]:
    """The machine with the largest workspace of a few that it reaches about home."""
    lengths = [geometry[k] for k in ("strut", "lower", "home") if k in geometry]
    size = float(np.abs(lengths[0]).max())
    problem: str | None = ""
    for step in range(HALVINGS):
        share = 0.5**step
        tried = geometry | {"reach": REACH * size * share}
        if any(d.name == "tilt" for d in family.dimensions):
            tried["tilt"] = TILT * share
        try:
            machine = replace_nominal(family.build(tried), nominal)
            problem = unreachable(Kinematics(machine))
        except ValueError as error:
            problem = str(error)
        if problem is None:
            return machine, tried
    raise location.error(
        f"the machine reaches nothing about home: {problem}", "check its joints"
    )


def study_tables(model: Described) -> str:
    """[machine.geometry] and [machine.nominal] of a study, to the last digit."""
    lines = ["[machine.geometry]"]
    family = model.machine.family
    for d in () if family is None else family.dimensions:
        if d.name in model.geometry:
            key = d.name if d.unit == "1" else column(d.name, d.unit)
            lines.append(
                f"{key} = {_exact(model.geometry[d.name], d.unit)}  # {d.about}"
            )
    if model.nominal:
        lines += ["", "[machine.nominal]"]
    si = {p.name: p.unit for p in model.machine.parameters}
    for name, value in model.nominal.items():
        lines.append(f"{column(name, si[name])} = {_exact(value, si[name])}")
    return "\n".join(lines) + "\n"


def _exact(value: Any, si: str) -> str:
    """An SI number, or nested lists of them, as TOML in the unit of its column."""
    if np.ndim(value):
        return f"[{', '.join(_exact(item, si) for item in value)}]"
    number = value if si == "1" else units.from_si(value, display_unit(si))
    return repr(float(number))


# -- one family each -------------------------------------------------------------------
Geometry = tuple[dict[str, Any], dict[str, float]]


def _legs(drawn: DrawnMachine, location: Location) -> Geometry:
    geometry = {
        "base": np.array([limb.start for limb in drawn.limbs]),
        "platform": np.array([limb.local for limb in drawn.limbs]),
        "home": drawn.home,
    }
    zeros = [limb.extension - limb.drive.joint.value for limb in drawn.limbs]
    return geometry, {f"l{k}": zero for k, zero in enumerate(zeros, start=1)}


def _guides(limbs: tuple[DrawnLimb, ...]) -> dict[str, Any]:
    """Guides with the zeros of their scales, struts and sides."""
    along = np.array([limb.drive.axis for limb in limbs])
    value = np.array([[limb.drive.joint.value] for limb in limbs])
    struts = np.array([limb.end - limb.start for limb in limbs])
    return {
        "guide": np.array([limb.start for limb in limbs]) - value * along,
        "direction": along,
        "strut": np.linalg.norm(struts, axis=1),
        "side": -np.sign(np.sum(struts * along, axis=1)),
    }


def _carriages(drawn: DrawnMachine, location: Location) -> Geometry:
    local = np.array([limb.local for limb in drawn.limbs])
    return _guides(drawn.limbs) | {"platform": local, "home": drawn.home}, {}


def _glides(drawn: DrawnMachine, location: Location) -> Geometry:
    geometry = _guides(drawn.limbs)
    geometry["guide"] = geometry["guide"] - [limb.local for limb in drawn.limbs]
    return geometry | {"home": drawn.home}, {}


def _crank(limb: DrawnLimb, location: Location) -> tuple[Array, Array, float]:
    """Centre (3,), arm (3,) and side of the knee. Raises InputError for a straight one."""
    axis = limb.drive.axis
    centre = limb.drive.at + (limb.start - limb.drive.at) @ axis * axis
    arm, line = limb.start - centre, limb.end - centre
    bend = float(np.cross(line, arm) @ axis)
    if abs(bend) < STRAIGHT_ANGLE * float(np.linalg.norm(line) * np.linalg.norm(arm)):
        raise location.error(
            f"the crank of {limb.drive.joint.name} and its strut are drawn in one line: to"
            " which side the knee bends is not seen, and the machine moves nowhere there",
            "draw the bodies where the loops close with bent knees",
        )
    side = float(np.sign(bend))
    back = Rotation.from_rotvec(-limb.drive.joint.value * axis)
    return centre, back.apply(arm), side


def _cranks(drawn: DrawnMachine, location: Location) -> Geometry:
    cranks = [_crank(limb, location) for limb in drawn.limbs]
    geometry = {
        "centre": np.array([centre for centre, _, _ in cranks]),
        "axis": np.array([limb.drive.axis for limb in drawn.limbs]),
        "first": np.array([arm for _, arm, _ in cranks]),
        "crank": np.array([np.linalg.norm(arm) for _, arm, _ in cranks]),
        "strut": np.array([limb.strut for limb in drawn.limbs]),
        "side": np.array([side for _, _, side in cranks]),
        "platform": np.array([limb.local for limb in drawn.limbs]),
        "home": drawn.home,
    }
    return geometry, {}


def _rotary(drawn: DrawnMachine, location: Location) -> Geometry:
    """Cranks with outward knees and nearly level axes, their tilts as numbers."""
    nominal: dict[str, float] = {}
    rows = []
    for k, limb in enumerate(drawn.limbs, start=1):
        axis = limb.drive.axis
        centre, arm, side = _crank(limb, location)
        if abs(axis[2]) > MAX_SLOPE or side > 0.0:
            raise location.error(
                f"{limb.drive.joint.name} has no level axis, or its knee goes down against"
                " its sense, or is inward",
                "a rotary delta has level axes, angles that grow downward, knees outward",
            )
        level = np.array([axis[0], axis[1], 0.0]) / math.hypot(axis[0], axis[1])
        tilts = across(level[None])[0] @ axis / (axis @ level)
        outward = np.cross(level, UPWARD)
        shoulder = centre - limb.local
        first = outward - outward @ axis * axis
        first = first / np.linalg.norm(first)
        down = np.cross(axis, first)
        nominal[f"zero{k}"] = math.atan2(float(arm @ down), float(arm @ first))
        nominal |= {f"tilt{k}a": float(tilts[0]), f"tilt{k}b": float(tilts[1])}
        for letter, value in zip("xyz", shoulder.tolist(), strict=True):
            nominal[f"b{k}{letter}"] = value
        angle = math.atan2(outward[1], outward[0])
        rows.append((float(shoulder @ outward), angle, float(np.linalg.norm(arm))))
    radius, angle, upper = np.array(rows).T
    geometry = {
        "radius": radius,
        "height": np.array([nominal[f"b{k}z"] for k in (1, 2, 3)]),
        "angle": angle,
        "upper": upper,
        "lower": np.array([limb.strut for limb in drawn.limbs]),
        "home": drawn.home,
    }
    return geometry, nominal


def _planar(drawn: DrawnMachine, location: Location) -> Geometry:
    """Cranks about z; their centres less the platform's joints."""
    cranks = [_crank(limb, location) for limb in drawn.limbs]
    level = [limb.drive.axis @ UPWARD for limb in drawn.limbs]
    if min(level) < 1.0 - TOLERANCE or np.abs(drawn.axes[:, 2]).max() > TOLERANCE:
        raise location.error(
            "its cranks do not turn about z, right-handed", "draw it in the plane z = 0"
        )
    geometry = {
        "centre": np.array(
            [
                c[:2] - b.local[:2]
                for (c, _, _), b in zip(cranks, drawn.limbs, strict=True)
            ]
        ),
        "crank": np.array([np.linalg.norm(arm) for _, arm, _ in cranks]),
        "strut": np.array([limb.strut for limb in drawn.limbs]),
        "side": np.array([side for _, _, side in cranks]),
        "home": drawn.home[:2],
    }
    zeros = [math.atan2(arm[1], arm[0]) for _, arm, _ in cranks]
    return geometry, {f"zero{k}": zero for k, zero in enumerate(zeros, start=1)}


FAMILIES: dict[
    tuple[str, int, bool], tuple[str, Callable[[DrawnMachine, Location], Geometry]]
] = {
    (LEG, 3, True): ("hexapod_ups", _legs),
    (CARRIAGE, 3, True): ("hexapod_pus", _carriages),
    (CRANK, 3, True): ("hexapod_rus", _cranks),
    (CARRIAGE, 3, False): ("orthoglide", _glides),
    (CRANK, 3, False): ("rotary_delta", _rotary),
    (CRANK, 2, False): ("five_bar", _planar),
}
COUNTS = {key: (6 if key[2] else key[1]) for key in FAMILIES}
