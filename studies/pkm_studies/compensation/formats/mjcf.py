"""MJCF: the identified machine for MuJoCo, loops closed by `equality/connect`."""

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

#: attributes that are numbers of the geometry
GEOMETRY = ("pos", "quat", "axis", "ref", "anchor")
QUIET = {"contype": "0", "conaffinity": "0"}


def write(compensation: Compensation) -> Texts:
    """The model, and its numbers for each draw of the posterior."""
    root = _model(compensation, compensation.identified.values)
    lines = [
        *compensation.comments,
        "SI units: m, rad; driven joints read as those of the study",
        body_names.TRANSLATION,
        body_names.MASSES,
    ]
    text = body_names.commented(root, lines)
    texts = {".mjcf.xml": text}
    table = body_names.draws_table(
        compensation, lambda draw: geometry(_model(compensation, draw))
    )
    return texts | ({"_mjcf_draws.csv": table} if table else {})


def geometry(root: ET.Element) -> Mapping[str, float]:
    """Numbers of named elements: `carriage1.pos.0` is x of the body's place."""
    numbers = {}
    for element in root.iter():
        name = element.get("name")
        for attribute in GEOMETRY:
            text = element.get(attribute)
            if name is None or text is None:
                continue
            for k, word in enumerate(text.split()):
                numbers[f"{name}.{attribute}.{k}"] = float(word)
    return numbers


def _model(compensation: Compensation, values: Array) -> ET.Element:
    machine = compensation.machine
    skeleton = body_names.skeleton_of(compensation, values)
    thick = body_names.STRUT_RADIUS_SHARE * machine.lever
    root = ET.Element("mujoco", model=machine.name)
    ET.SubElement(root, "compiler", angle="radian", autolimits="true")
    defaults = ET.SubElement(root, "default")
    size = {
        "size": text_of(np.array([thick])),
        "density": repr(body_names.STEEL_DENSITY),
    }
    ET.SubElement(defaults, "geom", {"type": "capsule"} | size | QUIET)
    world = ET.SubElement(root, "worldbody")
    _platform(world, machine, skeleton, thick)
    closures = ET.Element("equality")
    for k, limb in enumerate(skeleton.limbs):
        strut = _limb(world, limb, machine.joints[k], k + 1)
        anchor = text_of(limb.end - limb.start)
        bodies = {"body1": strut, "body2": "platform", "anchor": anchor}
        ET.SubElement(closures, "connect", bodies, name=f"closure{k + 1}")
    root.append(closures)
    return root


def _platform(
    world: ET.Element, machine: Machine, skeleton: PlatformOnLimbs, thick: float
) -> None:
    """The platform with its free coordinates, and a site at the tool point."""
    quaternion = _quaternion(skeleton.rotation)
    body = ET.SubElement(
        world,
        "body",
        name="platform",
        pos=text_of(skeleton.point),
        quat=text_of(quaternion),
    )
    if len(machine.pose) == 6:
        ET.SubElement(body, "freejoint", name="platform_pose")
    else:
        for coordinate in machine.pose:
            k = "xyz".index(coordinate.name)
            ET.SubElement(
                body,
                "joint",
                name=coordinate.name,
                type="slide",
                axis=text_of(np.eye(3)[k]),
                ref=text_of(skeleton.point[k]),
            )
    ET.SubElement(body, "geom", type="sphere", size=text_of(np.array([2.0 * thick])))
    ET.SubElement(body, "site", name="tool_point", size=text_of(np.array([thick])))
    for limb in skeleton.limbs:
        ends = np.r_[np.zeros(3), limb.local]
        if np.linalg.norm(limb.local) > thick:
            ET.SubElement(body, "geom", fromto=text_of(ends))


def _limb(world: ET.Element, limb: Limb, joint: Coordinate, k: int) -> str:
    """The bodies of a limb; returns the name of that which ends at the platform."""
    swing = [
        {"name": f"swing{k}{letter}", "type": "hinge", "axis": text_of(axis)}
        for letter, axis in zip("ab", square_directions(limb), strict=True)
    ]
    drive = {
        "name": joint.name,
        "type": "hinge" if limb.kind == CRANK else "slide",
        "axis": text_of(limb.axis),
        "ref": text_of(np.array([limb.joint])),
    }
    if np.isfinite([joint.lower, joint.upper]).all():
        drive["range"] = text_of(np.array([joint.lower, joint.upper]))
    along = text_of(np.r_[np.zeros(3), limb.end - limb.start])
    first, second = f"{limb.kind}{k}", f"strut{k}"
    outer = ET.SubElement(world, "body", name=first, pos=text_of(limb.centre))
    location = text_of(limb.start - limb.centre)
    inner_joints = swing
    outer_joints = [drive]
    if limb.kind == LEG:
        inner_joints = [drive]
        outer_joints = swing
    for joint_attributes in outer_joints:
        ET.SubElement(outer, "joint", joint_attributes)
    if limb.kind == CRANK:
        ET.SubElement(
            outer, "geom", fromto=text_of(np.r_[np.zeros(3), limb.start - limb.centre])
        )
    else:
        ET.SubElement(outer, "geom", type="sphere")
    inner = ET.SubElement(outer, "body", name=second, pos=location)
    for joint_attributes in inner_joints:
        ET.SubElement(inner, "joint", joint_attributes)
    ET.SubElement(inner, "geom", fromto=along)
    return second


def _quaternion(rotation: Array) -> Array:
    """w, x, y, z of a rotation (3, 3) by less than half a turn."""
    w = 0.5 * np.sqrt(1.0 + np.trace(rotation))
    skew = rotation - rotation.T
    return np.array([w, *(np.array([skew[2, 1], skew[0, 2], skew[1, 0]]) / (4.0 * w))])


controller = ControllerFormat(
    name="mjcf",
    about="MJCF of the identified machine for MuJoCo, with draws of the posterior",
    source="MuJoCo documentation, XML reference",
    write=write,
    unfit=body_names.unfit,
    draws=True,
)
