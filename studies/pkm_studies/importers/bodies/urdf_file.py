"""Reads URDF, and the table of loops that close it, as `oed compensate --to urdf` writes."""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from oed.base.arrays import Array
from pkm_studies.base.errors import Place
from pkm_studies.importers.bodies.tree import (
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

JOINTS = {
    "revolute": HINGE,
    "continuous": HINGE,
    "prismatic": SLIDE,
    "floating": FREE,
    "spherical": BALL,
}
HEAD = "loop, link_a, a_x_m, a_y_m, a_z_m, link_b, b_x_m, b_y_m, b_z_m"


def read(path: Path, loops: Path | None) -> BodyTree:
    """The tree of a URDF file with its loops. Raises InputError."""
    place = Place(str(path))
    if loops is None:
        raise place.error("URDF has no loops", f"give --loops TABLE.csv: {HEAD}")
    try:
        root = ET.parse(path).getroot()
    except (ET.ParseError, OSError) as error:
        raise place.error(f"this is no XML file: {error}", "give a URDF file") from None
    if root.tag != "robot":
        raise place.error(
            f"its root is <{root.tag}>", "give URDF, whose root is <robot>"
        )
    bodies: dict[str, Body] = {}
    children = {e.find("child").get("link") for e in root.findall("joint")}  # type: ignore[union-attr]
    for link in root.findall("link"):
        name = link.get("name", "")
        if name not in children:
            bodies[name] = Body(name, WORLD, np.zeros(3), np.eye(3), ())
    for joint in root.findall("joint"):
        body = _body(joint, place)
        bodies[body.name] = body
    ignored = {e.tag for e in root if e.tag not in ("link", "joint")} | {"inertial"}
    return BodyTree(bodies, _loops(loops, bodies), {}, tuple(sorted(ignored)))


def _body(element: ET.Element, place: Place) -> Body:
    """The link behind a joint."""
    name, kind = element.get("name", ""), element.get("type", "")
    ends = [element.find(side) for side in ("parent", "child")]
    if None in ends or element.find("mimic") is not None:
        problem = f"joint {name} has no parent, no child, or mimics another"
        raise place.error(problem, "give each joint both links and its own motion")
    parent, child = (end.get("link", "") for end in ends if end is not None)
    at, angles = _numbers(element, "origin", "xyz"), _numbers(element, "origin", "rpy")
    rotation = np.eye(3)
    for k in (2, 1, 0):
        rotation = rotation @ turn(np.eye(3)[k], angles[k])
    if kind == "fixed":
        return Body(child, parent, at, rotation, ())
    if kind not in JOINTS:
        raise place.error(f"joint {name} is {kind}", f"use {', '.join(JOINTS)}")
    axis = _numbers(element, "axis", "xyz", "1 0 0")
    joint = BodyJoint(name, JOINTS[kind], axis / np.linalg.norm(axis), np.zeros(3))
    return Body(child, parent, at, rotation, (joint,))


def _numbers(
    element: ET.Element, tag: str, attribute: str, default: str = "0 0 0"
) -> Array:
    child = element.find(tag)
    text = default if child is None else child.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def _loops(path: Path, bodies: dict[str, Body]) -> tuple[BodyLoop, ...]:
    place, loops = Place(str(path)), []
    try:
        with path.open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError as error:
        raise place.error(
            f"it cannot be read: {error}", "give the loops' table"
        ) from None
    for row in rows:
        ends: list[tuple[str, Array]] = []
        for side in "ab":
            name = row.get(f"link_{side}", "")
            try:
                point = np.array([float(row[f"{side}_{k}_m"]) for k in "xyz"])
            except (KeyError, ValueError, TypeError):
                raise place.error(
                    "a row has no place", f"the columns are {HEAD}"
                ) from None
            if name not in bodies:
                raise place.error(
                    f"there is no link {name!r}", "name links of the URDF"
                )
            ends.append((name, point))
        loops.append(BodyLoop(*ends[0], *ends[1]))
    if not loops:
        raise place.error("it has no loop", f"the columns are {HEAD}")
    return tuple(loops)
