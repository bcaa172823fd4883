"""Reads URDF, and the table of loops that close it, as `oed compensate --to urdf` writes."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

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
    turn,
)
from pkm_studies.drafts.bodies.xml_file import (
    DEEPEST,
    LIMIT,
    read_direction,
    read_numbers,
    read_root,
)

JOINTS = {
    "revolute": HINGE,
    "continuous": HINGE,
    "prismatic": SLIDE,
    "floating": FREE,
    "spherical": BALL,
}
REMEDY = "correct it as URDF has it"
HEAD = "loop, link_a, a_x_m, a_y_m, a_z_m, link_b, b_x_m, b_y_m, b_z_m"


def read(path: Path, loops: Path | None) -> BodyTree:
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
    """The link behind a joint."""
    name, kind = element.get("name", ""), element.get("type", "")
    ends = [element.find(side) for side in ("parent", "child")]
    if None in ends or element.find("mimic") is not None:
        problem = f"joint {name} has no parent, no child, or mimics another"
        raise location.error(problem, "give each joint both links and its own motion")
    parent, child = (end.get("link", "") for end in ends if end is not None)
    position, angles = (
        read_numbers(_text(element, "origin", key), 3, location, REMEDY)
        for key in ("xyz", "rpy")
    )
    rotation = np.eye(3)
    for k in (2, 1, 0):
        rotation = rotation @ turn(np.eye(3)[k], angles[k])
    if kind == "fixed":
        return Body(child, parent, position, rotation, ())
    if kind not in JOINTS:
        raise location.error(f"joint {name} is {kind}", f"use {', '.join(JOINTS)}")
    axis = read_direction(_text(element, "axis", "xyz", "1 0 0"), 3, location, REMEDY)
    joint = BodyJoint(name, JOINTS[kind], axis, np.zeros(3))
    return Body(child, parent, position, rotation, (joint,))


def _check_parents(bodies: dict[str, Body], location: Location) -> None:
    """Raises InputError unless each link leads to the base, over a few others."""
    depth = {WORLD: 0}
    for name in bodies:
        chain, link = dict[str, None](), name
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
        if depth[name] > DEEPEST:
            problem = f"link {name!r} hangs on more than {DEEPEST} others"
            raise location.error(problem, "give the links of the mechanism alone")


def _text(element: ET.Element, tag: str, attribute: str, default: str = "0 0 0") -> str:
    child = element.find(tag)
    return default if child is None else child.get(attribute, default)


def _loops(path: Path, bodies: dict[str, Body]) -> tuple[BodyLoop, ...]:
    location, loops = Location(str(path)), []
    text = files.read_text(path, limit=LIMIT, what="table of loops")
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
