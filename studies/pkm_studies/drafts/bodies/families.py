"""The family and the geometry of a drawn machine, for a study."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_models.rotation import across
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.drafts.bodies import mjcf_file, urdf_file
from pkm_studies.drafts.bodies.limbs import (
    CARRIAGE,
    CRANK,
    LEG,
    DrawnLimb,
    DrawnMachine,
    drawn_machine,
)
from pkm_studies.drafts.bodies.tree import detached, turn
from pkm_studies.quantities import column, display_unit
from pkm_studies.resolve import replace_nominal, unreachable
from pkm_studies.user_code import Origin

SUFFIXES = (".xml", ".urdf")
#: first half width of the workspace over the largest length, and largest tilt, rad
REACH, TILT, HALVINGS = 0.08, 0.08, 6
NEAR = 1e-9
#: slope of a rotary delta's axes, at most
LEVEL = 0.1
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
        tree = urdf_file.read(path, loops)
    else:
        if loops is not None:
            raise location.error("MJCF holds its own loops", "leave out --loops")
        tree = detached(mjcf_file.read(path))
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


def _crank(limb: DrawnLimb) -> tuple[Array, Array, float]:
    """Centre (3,) and arm (3,) at a joint of 0, and the side of the knee."""
    axis = limb.drive.axis
    centre = limb.drive.at + (limb.start - limb.drive.at) @ axis * axis
    arm, line = limb.start - centre, limb.end - centre
    side = float(np.sign(np.cross(line, arm) @ axis))
    return centre, turn(axis, -limb.drive.joint.value) @ arm, side


def _cranks(drawn: DrawnMachine, location: Location) -> Geometry:
    cranks = [_crank(limb) for limb in drawn.limbs]
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
    """Cranks with outward knees; axes that are nearly level, their tilts as numbers.

    Shoulders are less the platform's joints.
    """
    nominal: dict[str, float] = {}
    rows = []
    for k, limb in enumerate(drawn.limbs, start=1):
        axis = limb.drive.axis
        centre, arm, side = _crank(limb)
        if abs(axis[2]) > LEVEL or side > 0.0:
            raise location.error(
                f"{limb.drive.joint.name} has no level axis, or its knee goes down against"
                " its sense, or is inward",
                "a rotary delta has level axes, angles that grow downward, knees outward",
            )
        level = np.array([axis[0], axis[1], 0.0]) / math.hypot(axis[0], axis[1])
        tilts = across(level[None])[0] @ axis / (axis @ level)
        outward, shoulder = np.cross(level, UPWARD), centre - limb.local
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
    cranks = [_crank(limb) for limb in drawn.limbs]
    level = [limb.drive.axis @ UPWARD for limb in drawn.limbs]
    if min(level) < 1.0 - NEAR or np.abs(drawn.axes[:, 2]).max() > NEAR:
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
