"""URDF: the identified machine as a tree, and a table of the loops that close it."""

import csv
import io
import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping

import numpy as np

from oed.base import Array
from oed.model import Coordinate, Machine
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts
from pkm_studies.compensation.formats import body_names
from pkm_studies.compensation.formats.body_names import text_of
from pkm_studies.compensation.table_grid import (
    CRANK,
    LEG,
    Limb,
    PlatformOnLimbs,
    square_directions,
)

BASE, TOOL = "base", "platform"
LOOP_HEAD = (
    "loop",
    "link_a",
    "a_x_m",
    "a_y_m",
    "a_z_m",
    "link_b",
    "b_x_m",
    "b_y_m",
    "b_z_m",
)
EFFORT = {"effort": "1e6", "velocity": "1e3"}


def write(compensation: Compensation) -> Texts:
    """The tree, its loops, and the numbers of the tree for each draw of the posterior."""
    root, loops = _model(compensation, compensation.identified.values)
    lines = [
        *compensation.comments,
        "driven joints read as those of the study, in m and rad; passive joints are 0 at home",
        "URDF has no loops: the points of each row of the loops' table coincide",
        body_names.TRANSLATION,
        body_names.MASSES,
    ]
    text = body_names.commented(root, lines)
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([LOOP_HEAD, *loops])
    texts = {".urdf": text, "_loops.csv": out.getvalue()}
    table = body_names.draws_table(
        compensation, lambda draw: geometry(*_model(compensation, draw))
    )
    return texts | ({"_urdf_draws.csv": table} if table else {})


def geometry(root: ET.Element, loops: list[list[str]]) -> Mapping[str, float]:
    """Numbers of joints and loops: `q1.origin.xyz.0`, `q1.axis.xyz.2`, `loop1.a.0`."""
    numbers = {}
    for joint in root.iter("joint"):
        for child in joint.iter():
            for attribute in ("xyz", "rpy"):
                cells = (child.get(attribute) or "").split()
                for k, word in enumerate(cells):
                    label = f"{joint.get('name')}.{child.tag}.{attribute}.{k}"
                    numbers[label] = float(word)
    for row in loops:
        for side, cells in (("a", row[2:5]), ("b", row[6:9])):
            numbers |= {f"{row[0]}.{side}.{k}": float(w) for k, w in enumerate(cells)}
    return numbers


def _model(
    compensation: Compensation, values: Array
) -> tuple[ET.Element, list[list[str]]]:
    machine = compensation.machine
    skeleton = body_names.skeleton_of(compensation, values)
    root = ET.Element("robot", name=machine.name)
    tree = _LinkTree(root, body_names.STRUT_RADIUS_SHARE * machine.lever)
    tree.link(BASE)
    _platform(tree, machine, skeleton)
    loops = []
    for k, limb in enumerate(skeleton.limbs):
        link, point = _limb(tree, limb, machine.joints[k], k + 1)
        ends = [*text_of(point).split(), TOOL, *text_of(limb.local).split()]
        loops.append([f"loop{k + 1}", link, *ends])
    return root, loops


class _LinkTree:
    """A robot to which links and joints are added."""

    def __init__(self, root: ET.Element, radius: float) -> None:
        """`radius`, m, of the steel balls that stand for the links' masses."""
        self.root = root
        self.mass = 4.0 / 3.0 * math.pi * radius**3 * body_names.STEEL_DENSITY
        self.moment = 0.4 * self.mass * radius**2

    def link(self, name: str) -> None:
        link = ET.SubElement(self.root, "link", name=name)
        inertial = ET.SubElement(link, "inertial")
        ET.SubElement(inertial, "mass", value=repr(self.mass))
        same = repr(self.moment)
        moments = {"ixx": same, "iyy": same, "izz": same}
        ET.SubElement(inertial, "inertia", moments, ixy="0", ixz="0", iyz="0")

    def joint(
        self,
        name: str,
        kind: str,
        parent: str,
        child: str,
        axis: Array,
        anchor: Array,
        turn: Array | None = None,
        limits: tuple[float, float] | None = None,
    ) -> str:
        """A joint to a new link; returns the link's name."""
        joint = ET.SubElement(self.root, "joint", name=name, type=kind)
        ET.SubElement(joint, "parent", link=parent)
        ET.SubElement(joint, "child", link=child)
        angles = np.zeros(3) if turn is None else turn
        ET.SubElement(joint, "origin", xyz=text_of(anchor), rpy=text_of(angles))
        ET.SubElement(joint, "axis", xyz=text_of(axis))
        if limits is not None:
            low, high = (repr(v) for v in limits)
            ET.SubElement(joint, "limit", EFFORT, lower=low, upper=high)
        self.link(child)
        return child


def _platform(tree: _LinkTree, machine: Machine, skeleton: PlatformOnLimbs) -> None:
    """The platform behind virtual joints: places, then turns about x, y and z."""
    names = [c.name for c in machine.pose if c.name in "xyz"]
    wide = (-1e3, 1e3)
    fixed = [
        0.0 if n in names else v for n, v in zip("xyz", skeleton.point, strict=True)
    ]
    turns = len(machine.pose) == 6
    parent = BASE
    for name in names:
        first, last = name == names[0], name == names[-1]
        child = TOOL if last and not turns else f"platform_{name}"
        position = np.array(fixed) if first else np.zeros(3)
        axis = np.eye(3)["xyz".index(name)]
        parent = tree.joint(
            name, "prismatic", parent, child, axis, position, limits=wide
        )
    if not turns:
        return
    angles = _roll_pitch_yaw(skeleton.rotation)
    for k, name in enumerate(("turn_x", "turn_y", "turn_z")):
        child = TOOL if k == 2 else f"platform_{name}"
        turn = angles if k == 0 else None
        joint = (name, "continuous", parent, child, np.eye(3)[k], np.zeros(3), turn)
        parent = tree.joint(*joint)


def _limb(tree: _LinkTree, limb: Limb, joint: Coordinate, k: int) -> tuple[str, Array]:
    """The links of a limb; the link and the point (3,) on it that end at the platform."""
    limits = (joint.lower, joint.upper)
    first, second = square_directions(limb)
    along, zero = limb.end - limb.start, -limb.joint * limb.axis
    swing = f"swing{k}a", f"swing{k}b"
    if limb.kind == LEG:
        end_body = tree.joint(
            swing[0], "continuous", BASE, f"fork{k}", first, limb.start
        )
        end_body = tree.joint(
            swing[1], "continuous", end_body, f"leg{k}", second, np.zeros(3)
        )
        drive = (joint.name, "prismatic", end_body, f"strut{k}", limb.axis, zero)
        return tree.joint(*drive, limits=limits), along
    if limb.kind == CRANK:
        turn = _roll_pitch_yaw(_rotation(limb.axis, -limb.joint))
        drive = (joint.name, "revolute", BASE, f"crank{k}", limb.axis, limb.centre)
        parent = tree.joint(*drive, turn=turn, limits=limits)
    else:
        location = limb.start + zero
        drive = (joint.name, "prismatic", BASE, f"carriage{k}", limb.axis, location)
        parent = tree.joint(*drive, limits=limits)
    knee = limb.start - limb.centre
    end_body = tree.joint(swing[0], "continuous", parent, f"fork{k}", first, knee)
    last = tree.joint(
        swing[1], "continuous", end_body, f"strut{k}", second, np.zeros(3)
    )
    return last, along


def _rotation(axis: Array, angle: float) -> Array:
    """Rotation (3, 3) about a unit axis, by Rodrigues' formula."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned = math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return np.asarray(np.eye(3) + turned)


def _roll_pitch_yaw(rotation: Array) -> Array:
    """URDF's angles (3,) of a rotation (3, 3): about fixed x, y, z; no roll at 90 deg."""
    pitch = math.atan2(-rotation[2, 0], math.hypot(rotation[2, 1], rotation[2, 2]))
    if math.hypot(rotation[2, 1], rotation[2, 2]) < 1e-12:
        return np.array([0.0, pitch, math.atan2(-rotation[0, 1], rotation[1, 1])])
    roll = math.atan2(rotation[2, 1], rotation[2, 2])
    return np.array([roll, pitch, math.atan2(rotation[1, 0], rotation[0, 0])])


controller = ControllerFormat(
    name="urdf",
    about="URDF of the identified machine, with loops and draws of the posterior as tables",
    source="ROS documentation, urdf/XML",
    write=write,
    unfit=body_names.unfit,
    draws=True,
)
