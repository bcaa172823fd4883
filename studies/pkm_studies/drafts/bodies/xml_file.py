"""Reads the XML of bodies: the root of a file, and the numbers of its attributes."""

import csv
import io
import math
import xml.etree.ElementTree as ET
from collections.abc import Collection
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from oed.base import Array
from pkm_studies import files
from pkm_studies.base import Location
from pkm_studies.csv_table import named_errors
from pkm_studies.drafts.bodies.tree import (
    BALL,
    FREE,
    HINGE,
    SLIDE,
    WORLD,
    Body,
    BodyJoint,
    BodyLoop,
    BodyTree,
)

MAX_BYTES = 20_000_000
#: largest number of a file, m or degrees: what is beyond is no place of a machine
MAX_NUMBER = 1e6
#: elements within one another, and bodies behind one another: humanoid robots have 30
MAX_DEPTH = 200
#: elements of a file: the largest public models of robots have some 5000
MAX_ELEMENTS = 20_000


def read_root(path: Path, tag: str, what: str) -> ET.Element:
    """The root of an XML file. Raises InputError where it is another one.

    tag   that the root has
    what  the format, for the error
    """
    location = Location(str(path))
    content = files.read_bytes(path, limit=MAX_BYTES, what=f"{what} file")
    try:
        root = _bounded(content, location, what)
    except (ET.ParseError, ValueError) as error:
        raise location.error(
            f"this is no XML file: {error}", f"give a whole {what} file"
        ) from None
    if root.tag != tag:
        raise location.error(
            f"its root is <{root.tag}>", f"give {what}, whose root is <{tag}>"
        )
    return root


def _bounded(content: bytes, location: Location, what: str) -> ET.Element:
    """The root of XML. Raises InputError where it is deeper or larger than a machine."""
    root, depth, count = None, 0, 0
    for event, element in ET.iterparse(io.BytesIO(content), ("start", "end")):
        root = element if root is None else root
        starts = event == "start"
        depth, count = depth + (1 if starts else -1), count + starts
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise location.error(
                f"it has more than {MAX_ELEMENTS} elements, or more than {MAX_DEPTH}"
                " within one another, as no model of a machine has",
                f"give the {what} of the mechanism alone",
            )
    return root  # type: ignore[return-value]  # a file without one is a ParseError


def read_numbers(text: str, count: int, location: Location, remedy: str) -> Array:
    """Numbers (count,) separated by blanks. Raises InputError."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        raise location.error(f"{text!r} are no numbers", remedy) from None
    if len(numbers) != count:
        raise location.error(f"{text!r} are not {count} numbers", remedy)
    if not (np.abs(numbers) <= MAX_NUMBER).all():
        raise location.error(f"{text!r} is no place and no angle of a machine", remedy)
    return numbers


def read_direction(text: str, count: int, location: Location, remedy: str) -> Array:
    """The same, scaled to the length 1. Raises InputError where it has no length."""
    numbers = read_numbers(text, count, location, remedy)
    length = float(np.linalg.norm(numbers))
    if length == 0.0:
        raise location.error(f"{text!r} has no direction", remedy)
    return np.asarray(numbers / length)


# Reads URDF, and the table of loops that close it, as `oed compensate --to urdf` writes.

URDF_JOINTS = {
    "revolute": HINGE,
    "continuous": HINGE,
    "prismatic": SLIDE,
    "floating": FREE,
    "spherical": BALL,
}
URDF_REMEDY = "correct it as URDF has it"
HEAD = "loop, link_a, a_x_m, a_y_m, a_z_m, link_b, b_x_m, b_y_m, b_z_m"


def read_urdf(path: Path, loops: Path | None) -> BodyTree:
    """The tree of a URDF file with its loops. Raises InputError."""
    location = Location(str(path))
    if loops is None:
        raise location.error("URDF has no loops", f"give --loops TABLE.csv: {HEAD}")
    root = read_root(path, "robot", "URDF")
    bodies: dict[str, Body] = {}
    ends = [joint.find("child") for joint in root.findall("joint")]
    children = {end.get("link") for end in ends if end is not None}
    for link in root.findall("link"):
        name = link.get("name", "")
        if name not in children:
            bodies[name] = Body(name, WORLD, np.zeros(3), np.eye(3), ())
    for joint in root.findall("joint"):
        body = _body(joint, location)
        if body.name in bodies:
            problem = f"two joints lead to link {body.name!r}"
            raise location.error(problem, "give each link one parent")
        bodies[body.name] = body
    _check_parents(bodies, location)
    ignored = {e.tag for e in root if e.tag not in ("link", "joint")} | {"inertial"}
    with named_errors(str(loops)):
        closing = _loops(loops, bodies)
    return BodyTree(bodies, closing, {}, tuple(sorted(ignored)))


def _body(element: ET.Element, location: Location) -> Body:
    name, kind = element.get("name", ""), element.get("type", "")
    ends = [element.find(side) for side in ("parent", "child")]
    if None in ends or element.find("mimic") is not None:
        problem = f"joint {name} has no parent, no child, or mimics another"
        raise location.error(problem, "give each joint both links and its own motion")
    parent, child = (end.get("link", "") for end in ends if end is not None)
    position, angles = (
        read_numbers(_text(element, "origin", key), 3, location, URDF_REMEDY)
        for key in ("xyz", "rpy")
    )
    rotation = Rotation.from_euler("xyz", angles).as_matrix()
    if kind == "fixed":
        return Body(child, parent, position, rotation, ())
    if kind not in URDF_JOINTS:
        raise location.error(f"joint {name} is {kind}", f"use {', '.join(URDF_JOINTS)}")
    axis = read_direction(
        _text(element, "axis", "xyz", "1 0 0"), 3, location, URDF_REMEDY
    )
    joint = BodyJoint(name, URDF_JOINTS[kind], axis, np.zeros(3))
    return Body(child, parent, position, rotation, (joint,))


def _check_parents(bodies: dict[str, Body], location: Location) -> None:
    """Raises InputError unless each link leads to the base, over a few others."""
    depth = {WORLD: 0}
    for name in bodies:
        chain = dict[str, None]()
        link = name
        while link not in depth:
            if link not in bodies:
                problem = f"link {link!r} is a parent, but no <link>"
                raise location.error(problem, "name links of the file")
            if link in chain:
                problem = f"link {link!r} is its own parent"
                raise location.error(problem, "make the links a tree, from the base on")
            chain[link] = None
            link = bodies[link].parent
        for above in reversed(chain):
            depth[above] = depth[bodies[above].parent] + 1
        if depth[name] > MAX_DEPTH:
            problem = f"link {name!r} hangs on more than {MAX_DEPTH} others"
            raise location.error(problem, "give the links of the mechanism alone")


def _text(element: ET.Element, tag: str, attribute: str, default: str = "0 0 0") -> str:
    child = element.find(tag)
    return default if child is None else child.get(attribute, default)


def _loops(path: Path, bodies: dict[str, Body]) -> tuple[BodyLoop, ...]:
    location = Location(str(path))
    loops = []
    text = files.read_text(path, limit=MAX_BYTES, what="table of loops")
    for row in csv.DictReader(text.splitlines()):
        ends: list[tuple[str, Array]] = []
        for side in "ab":
            name = row.get(f"link_{side}", "")
            cells = [row.get(f"{side}_{k}_m") or "none" for k in "xyz"]
            remedy = f"the columns are {HEAD}"
            point = read_numbers(" ".join(cells), 3, location, remedy)
            if name not in bodies:
                raise location.error(
                    f"there is no link {name!r}", "name links of the URDF"
                )
            ends.append((name, point))
        loops.append(BodyLoop(*ends[0], *ends[1]))
    if not loops:
        raise location.error("it has no loop", f"the columns are {HEAD}")
    return tuple(loops)


# Reads MJCF: bodies, joints and `equality/connect`, as MuJoCo's XML reference states.

#: sections and elements of bodies that say nothing of the geometry
APART = (
    "option",
    "size",
    "visual",
    "statistic",
    "asset",
    "contact",
    "actuator",
    "sensor",
    "keyframe",
    "tendon",
    "custom",
    "extension",
    "geom",
    "inertial",
    "camera",
    "light",
)
#: attributes that turn a body
TURNS = ("quat", "euler", "axisangle", "xyaxes", "zaxis")
MJCF_JOINTS = {"hinge": HINGE, "slide": SLIDE, "ball": BALL, "free": FREE}
#: sites at the tool point, the first that there is
TOOLS = ("tool_point", "tool", "tcp")
MJCF_REMEDY = "save the model from MuJoCo (mj_saveLastXML), which writes plain bodies"
ORIGIN = "0 0 0"


def read_mjcf(path: Path) -> BodyTree:
    """The tree of an MJCF file. Raises InputError for what it does not read."""
    location = Location(str(path))
    return _Reader(read_root(path, "mujoco", "MJCF"), location).tree()


class _Reader:
    """What a file says before its bodies: units, order of Euler angles, defaults."""

    def __init__(self, root: ET.Element, location: Location) -> None:
        self.root, self.location = root, location
        compiler = root.find("compiler")
        settings = {} if compiler is None else compiler.attrib
        degrees = settings.get("angle", "degree") == "degree"
        self.angle = math.radians(1.0) if degrees else 1.0
        self.order = settings.get("eulerseq", "xyz")
        if len(self.order) != 3 or set(self.order.lower()) - set("xyz"):
            raise location.error(
                f"eulerseq {self.order!r} is no order of axes", MJCF_REMEDY
            )
        if settings.get("coordinate", "local") != "local":
            raise location.error("coordinates are global", MJCF_REMEDY)
        self.defaults: dict[str, dict[str, str]] = {}
        for default in root.findall("default"):
            self._default(default, {})
        self.bodies: dict[str, Body] = {}
        self.sites: dict[str, tuple[str, Array]] = {}
        self.ignored: set[str] = set()

    def tree(self) -> BodyTree:
        for section in self.root:
            if section.tag == "worldbody":
                self._children(section, WORLD, "main")
            elif section.tag not in ("compiler", "default", "equality"):
                self._leave(section)
        loops = [
            self._loop(element)
            for section in self.root.findall("equality")
            for element in section
        ]
        if not loops:
            raise self.location.error(
                "no loop is closed", "close the loops with <equality><connect .../>"
            )
        tools: dict[str, Array] = {}
        for name in TOOLS:
            if name in self.sites:
                body, offset = self.sites[name]
                tools.setdefault(body, offset)
        bodies = self.bodies
        return BodyTree(
            bodies, tuple(_closed(bodies, loops)), tools, tuple(sorted(self.ignored))
        )

    def _leave(self, element: ET.Element) -> None:
        if element.tag not in APART:
            raise self.location.error(f"<{element.tag}> is not read", MJCF_REMEDY)
        self.ignored.add(element.tag)

    def _default(self, element: ET.Element, above: dict[str, str]) -> None:
        joint = element.find("joint")
        settings = above | ({} if joint is None else dict(joint.attrib))
        self.defaults[element.get("class", "main")] = settings
        for child in element.findall("default"):
            self._default(child, settings)

    def _children(self, element: ET.Element, name: str, style: str) -> None:
        for child in element:
            if child.tag == "body":
                self._body(child, name, child.get("childclass", style))
            elif child.tag == "site":
                label = child.get("name", "")
                self._check_name("site", label, self.sites)
                self.sites[label] = (name, self._numbers(child.get("pos", ORIGIN)))
            elif child.tag not in ("joint", "freejoint"):
                self._leave(child)

    def _body(self, element: ET.Element, parent: str, style: str) -> None:
        name = element.get("name") or f"body{len(self.bodies) + 1}"
        self._check_name("body", name, self.bodies)
        if element.get("mocap") == "true":
            raise self.location.error(f"body {name} is a mocap body", "leave it out")
        joints = [
            self._joint(child, name, style)
            for child in element
            if child.tag in ("joint", "freejoint")
        ]
        location = self._numbers(element.get("pos", ORIGIN))
        rotation = self._rotation(element, name)
        self.bodies[name] = Body(name, parent, location, rotation, tuple(joints))
        self._children(element, name, style)

    def _joint(self, element: ET.Element, body: str, style: str) -> BodyJoint:
        stated = dict(element.attrib)
        if element.tag == "freejoint":
            stated["type"] = "free"
        else:
            class_name = stated.get("class", style)
            stated = self.defaults.get(class_name, {}) | stated
        kind = MJCF_JOINTS.get(stated.get("type", "hinge"))
        name = stated.get("name", f"a joint of {body}")
        if kind is None:
            raise self.location.error(f"{name} is no joint of MJCF", MJCF_REMEDY)
        unit = self.angle if kind == HINGE else 1.0
        return BodyJoint(
            name=name,
            kind=kind,
            axis=self._direction(stated.get("axis", "0 0 1"), 3),
            at=self._numbers(stated.get("pos", ORIGIN)),
            value=unit * float(self._numbers(stated.get("ref", "0"), 1)[0]),
        )

    def _rotation(self, element: ET.Element, name: str) -> Array:
        keys = [key for key in TURNS if element.get(key) is not None]
        if not keys:
            return np.eye(3)
        key = keys[0]
        text = element.get(key, "")
        if len(keys) > 1 or key == "zaxis":
            raise self.location.error(
                f"body {name} is turned by {', '.join(keys)}", MJCF_REMEDY
            )
        if key == "xyaxes":
            numbers = self._numbers(text, 6)
            z = np.cross(numbers[:3], numbers[3:])
            if not z.any():
                raise self.location.error(f"{text!r} are no two axes", MJCF_REMEDY)
            x, z = (v / np.linalg.norm(v) for v in (numbers[:3], z))
            return np.column_stack([x, np.cross(z, x), z])
        rotation = Rotation.identity()
        if key == "quat":
            quaternion = self._direction(text, 4)
            rotation = Rotation.from_quat(quaternion, scalar_first=True)
        elif key == "axisangle":
            angle = self.angle * self._numbers(text, 4)[3]
            axis = self._direction(" ".join(text.split()[:3]), 3)
            rotation = Rotation.from_rotvec(angle * axis)
        else:
            # letters may be of both kinds: axes that turn along, and fixed ones
            for letter, number in zip(self.order, self._numbers(text), strict=True):
                step = Rotation.from_euler(letter.lower(), self.angle * number)
                rotation = rotation * step if letter.islower() else step * rotation
        return np.asarray(rotation.as_matrix())

    def _loop(self, element: ET.Element) -> BodyLoop:
        """A connection; the point on the second body follows from the drawing."""
        closes = element.tag in ("connect", "weld")
        if not closes or element.get("active") == "false":
            problem = f"<equality> holds <{element.tag}> that is no active connection"
            raise self.location.error(problem, "close loops with <connect> or <weld>")
        if element.tag == "weld":
            return self._weld(element)
        if element.get("site1") is not None:
            first, second = (self._site(element.get(f"site{k}", "")) for k in (1, 2))
            return BodyLoop(*first, *second)
        names = element.get("body1", ""), element.get("body2", WORLD)
        for name in names:
            if name not in self.bodies and name != WORLD:
                raise self.location.error(
                    f"a connection names body {name!r}", "name one of the file"
                )
        anchor = self._numbers(element.get("anchor", ""))
        return BodyLoop(names[0], anchor, names[1], np.full(3, np.nan))

    def _weld(self, element: ET.Element) -> BodyLoop:
        """A weld as a connection: at the ball joint on which one of its bodies hangs."""
        tree = BodyTree(self.bodies, (), {})
        names = [element.get("body1", ""), element.get("body2", WORLD)]
        for first, second in (names, names[::-1]):
            body = self.bodies.get(first)
            if body is None or [j.kind for j in body.joints] != [BALL]:
                continue
            if second in self.bodies or second == WORLD:
                origin = tree.local(body.parent, tree.point(first, body.joints[0].at))
                return BodyLoop(body.parent, origin, second, np.full(3, np.nan))
        raise self.location.error(
            f"a <weld> joins {' and '.join(map(repr, names))}, neither of which hangs on a"
            " ball joint alone",
            "end each limb in a body on a ball joint, or close it with <connect>",
        )

    def _site(self, name: str) -> tuple[str, Array]:
        if name not in self.sites:
            raise self.location.error(
                f"a connection names site {name!r}", "name one of the file"
            )
        return self.sites[name]

    def _numbers(self, text: str, count: int = 3) -> Array:
        return read_numbers(text, count, self.location, MJCF_REMEDY)

    def _direction(self, text: str, count: int) -> Array:
        return read_direction(text, count, self.location, MJCF_REMEDY)

    def _check_name(self, kind: str, name: str, allowed: Collection[str]) -> None:
        if name and name in allowed:
            raise self.location.error(
                f"two of its elements <{kind}> have the name {name!r}",
                "give each a name of its own",
            )


def _closed(bodies: dict[str, Body], loops: list[BodyLoop]) -> list[BodyLoop]:
    """Loops with the point on the second body where it follows from the drawing."""
    tree = BodyTree(bodies, (), {})
    closed = []
    for loop in loops:
        if np.isfinite(loop.on_second).all():
            closed.append(loop)
            continue
        there = tree.local(loop.second, tree.point(loop.first, loop.on_first))
        closed.append(BodyLoop(loop.first, loop.on_first, loop.second, there))
    return closed
