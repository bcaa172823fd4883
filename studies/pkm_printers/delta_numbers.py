"""Numbers that the firmwares of delta printers share, in mm and degrees."""

import dataclasses
import itertools
from typing import Final

import numpy as np

from oed import units
from oed.base import Array
from oed.model import Machine
from pkm_printers.delta_geometry import SLOPES, TOWERS, DeltaGeometry
from pkm_studies.base import InputError
from pkm_studies.catalogue import Compensation
from pkm_studies.tables import ControllerTable

#: parameters of a delta with one radius, and of one with a radius for each tower
ONE_RADIUS = ("arm", "angle", "endstop")
FAMILY = ("radius", *ONE_RADIUS, "lean", "tip")
#: mm by which radii may differ, and a tower may lean over the workspace; the export
#: states what that costs
ACCEPTED_LOSS = 0.02


def delta_numbers(
    compensation: Compensation, name: str, *, by_tower: bool = False
) -> DeltaGeometry:
    """The delta for a firmware of radii `by_tower` or one. Raises InputError for others."""

    def read(stem: str, unit: str) -> Array:
        values = [compensation.parameter(f"{stem}{i}") for i in TOWERS]
        return units.from_si(values, unit)

    added = trims(compensation, name, "radius_trim_mm")
    slope = np.zeros(2)
    if "radius" in {p.name for p in compensation.machine.parameters}:
        radii = np.full(3, units.number(compensation.parameter("radius"), "mm")) + added
    else:
        _check_upright(compensation, read("lean", "rad"), read("tip", "rad"))
        radii = read("radius", "mm")
    if has_slopes(compensation.machine):
        radii = radii - added + read("trim", "mm")
        slope = np.array([compensation.parameter(s) for s in SLOPES])
    numbers = DeltaGeometry(
        radius=float((radii - added).mean()),
        arms=read("arm", "mm"),
        angles=read("angle", "deg"),
        endstops=read("endstop", "mm"),
        radius_trim=added,
        bed_slope=slope,
    )
    if by_tower:
        return dataclasses.replace(numbers, radius_trim=radii - numbers.radius)
    _check_radii(compensation, numbers, radii)
    return numbers


def has_slopes(machine: Machine) -> bool:
    """Whether the slopes of the bed are parameters of a machine."""
    return set(SLOPES) <= {p.name for p in machine.parameters}


def check_level(compensation: Compensation, numbers: DeltaGeometry, title: str) -> None:
    """Refuse a bed that leans, for a firmware without a word for it. Raises InputError."""
    places = units.from_si(compensation.command[:, :2], "mm")
    rise = np.abs(places @ numbers.bed_slope).max()
    if rise <= ACCEPTED_LOSS:
        return
    slopes = ", ".join(
        f"{axis} {100.0 * s:+.3f} %"
        for axis, s in zip("xy", numbers.bed_slope, strict=True)
    )
    raise InputError(
        f"{title} has no word for a bed that leans, and this one rises along {slopes}: without"
        f" it the nozzle is up to {rise:.3f} mm off the bed",
        "shim the bed by as much and probe again; or import with a line factors = 6, whose"
        " numbers hide the lean as well as they can",
        value="--to",
    )


def firmware_of(compensation: Compensation, name: str) -> ControllerTable | None:
    """What the study says of this firmware; None where it is of another, or of none."""
    firmware = compensation.controller
    return firmware if firmware is not None and firmware.firmware == name else None


def retained_words(compensation: Compensation, name: str, command: str) -> str:
    """Words of a command that this firmware keeps as they are."""
    firmware = firmware_of(compensation, name)
    return "" if firmware is None else firmware.keep.get(command, "")


def trims(compensation: Compensation, name: str, field: str) -> Array:
    """Trims (3,) by tower that stay in this firmware, mm."""
    firmware = firmware_of(compensation, name)
    return np.zeros(3) if firmware is None else np.array(getattr(firmware, field))


def trim_notes(compensation: Compensation, name: str) -> list[str]:
    """Sentences on trims that stay in this firmware."""
    sentences = []
    for what, field in (("radii", "radius_trim_mm"), ("rods", "rod_trim_mm")):
        values = trims(compensation, name, field)
        if np.any(values):
            listed = ", ".join(f"{v:g}" for v in values)
            sentences.append(
                f"trims of the {what} by tower stay in the firmware: {listed} mm"
            )
    return sentences


#: of a home height: the study has that of the firmware, whatever it counts to
NOT_KNOWN: Final = "not known"


def home_notes(compensation: Compensation, name: str) -> list[str]:
    """A sentence where another firmware's height at home is not that of the nozzle."""
    firmware = compensation.controller
    if (
        firmware is None
        or firmware.firmware == name
        or firmware.home_offset_mm != NOT_KNOWN
    ):
        return []
    return [
        f"the height at home is M665 H of {firmware.firmware.capitalize()}, which may count"
        " to the probe: with a probe, set the height anew before you print"
    ]


def delta_joints(geometry: DeltaGeometry, compensation: Compensation) -> Array:
    """Travels (n, 3) down from the endstops, m, by the formula of delta firmwares."""
    commands = units.from_si(compensation.command, "mm")
    return units.to_si(geometry.travels(commands), "mm")


def not_a_delta(machine: Machine) -> str | None:
    """Why a machine is no linear delta with a parameter for each tower."""
    names = {p.name for p in machine.parameters}
    one_radius = {"radius"} | _tower_values(ONE_RADIUS)
    if names in (one_radius, _tower_values(FAMILY)) or (
        has_slopes(machine) and one_radius <= names
    ):
        return None
    return "it writes linear deltas (radius, arms, tower angles, endstops)"


def _tower_values(stems: tuple[str, ...]) -> set[str]:
    return {f"{stem}{i}" for stem, i in itertools.product(stems, TOWERS)}


def _check_upright(compensation: Compensation, lean: Array, tip: Array) -> None:
    """Refuse towers that lean. Raises InputError."""
    heights = compensation.command[:, 2]
    rise = units.number(float(np.ptp(heights, axis=0)) or 1.0, "mm")
    tilts = {f"lean{i}": lean[i - 1] for i in TOWERS}
    tilts |= {f"tip{i}": tip[i - 1] for i in TOWERS}
    leaning = {
        name: tilt for name, tilt in tilts.items() if abs(tilt) * rise > ACCEPTED_LOSS
    }
    if not leaning:
        return
    sizes = (
        f"{name} {units.number(tilt, 'mrad'):.3g}" for name, tilt in leaning.items()
    )
    lost = max(map(abs, leaning.values())) * rise
    names = ", ".join(f'"{name}"' for name in tilts)
    raise InputError(
        f"no firmware has towers that lean, and these do: {', '.join(sizes)} mrad, which"
        f" moves their carriages by up to {lost:.3f} mm over the workspace",
        f"set them to 0 and hold them in [machine] of the study, fixed = [{names}, ...],"
        " and identify again; or take csv",
    )


def _check_radii(
    compensation: Compensation, numbers: DeltaGeometry, radii: Array
) -> None:
    """Refuse towers of three radii (3,), mm, for a firmware of one. Raises InputError."""
    if np.ptp(radii - numbers.radius_trim) <= ACCEPTED_LOSS:
        return
    wanted = dataclasses.replace(numbers, radius_trim=radii - numbers.radius)
    off = delta_joints(wanted, compensation) - delta_joints(numbers, compensation)
    lost = units.number(float(np.ptp(off)), "mm")
    sizes = ", ".join(f"radius{i} {v:.3f}" for i, v in zip(TOWERS, radii, strict=True))
    raise InputError(
        f"the firmware has one radius, and the towers have three: {sizes} mm; with their mean"
        f" carriages are up to {lost:.3f} mm off",
        'take model = "linear_delta", which has one radius, or hold radius1, radius2 and'
        " radius3 (trim1 to trim3) at one value with fixed in [machine], and identify again;"
        " or take csv, or smoothie, which has a radius for each tower",
    )
