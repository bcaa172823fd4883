"""What columns mean: frame, order, sense and unit of every coordinate and channel."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from oed import units
from oed.dataset import ReadingsColumn
from oed.instrument import Channel, Instrument
from oed.model import Coordinate, Machine, Parameter, PassiveJoint
from oed.units import UnitError
from pkm_studies import catalogue
from pkm_studies.catalogue import CatalogueEntry
from pkm_studies.quantities import column

if TYPE_CHECKING:
    from oed.measurement import Measurement


def _column(name: str, role: str, about: str) -> dict[str, str]:
    """A column: its name with the usual unit, what it is for, and what it means."""
    return {"name": name, "role": role, "about": about}


def _machine_columns(machine: Machine) -> list[dict[str, str]]:
    """Commands, joints, pose errors, passive joints and parameters of a machine."""
    commands = [
        _column(column(c.name, c.unit), "command", _command_convention(c))
        for c in machine.command
    ]
    errors = []
    for c in machine.components:
        about = c.about if c.compensatable else f"{c.about}; no drive corrects it"
        errors.append(_column(f"{c.name}_{units.FINE[c.unit]}", "pose error", about))
    return [
        *commands,
        *(_statement(c, "joint") for c in machine.joints),
        *errors,
        *(_statement(joint, "passive joint") for joint in machine.passive_joints()),
        *(_statement(p, "parameter") for p in machine.parameters),
    ]


def machine_frames(machine: Machine) -> list[str]:
    """The frames of a machine, in sentences without a full stop."""
    sentences = []
    if machine.base_frame:
        sentences.append(f"base frame: {machine.base_frame}; right-handed")
    if machine.tool_axis:
        sentences.append(f"tool axis, z of the platform's frame: {machine.tool_axis}")
    if machine.orientation is not None:
        explained = ""
        if any(kind == "tilt" for kind, _ in machine.orientation.factors):
            explained = ", T(rx, ry) a rotation by the vector (rx, ry, 0)"
        sentences.append(
            f"orientation of the platform's frame in the base frame:"
            f" {machine.orientation.formula}{explained}"
        )
    return sentences


def conventions_listing(kind: str) -> list[CatalogueEntry]:
    """The catalogue of a kind, with the frames and columns of each entry."""
    entries = catalogue.listing(kind)
    if kind not in ("machines", "instruments"):
        return entries
    items = catalogue.named_items(kind)
    return [_add_conventions(kind, entry, items[entry.name][1]) for entry in entries]


def _add_conventions(kind: str, entry: CatalogueEntry, item: Any) -> CatalogueEntry:
    if kind == "machines":
        frames, columns = machine_frames(item), _machine_columns(item)
    else:
        frames, columns = [], [_statement(c, "reading") for c in item.channels]
    return dataclasses.replace(entry, frames=frames, columns=columns)


def readings_comments(
    machine: Machine, setups: Mapping[str, Instrument], header: Sequence[str]
) -> list[str]:
    """Lines that open a CSV of readings of set-ups: frames, then each column."""
    lines = machine_frames(machine)
    for name in header:
        phrase = _meaning(name, machine, setups)
        if phrase:
            lines.append(f"{name}: {phrase}")
    return lines


def comments_of(measurement: Measurement) -> Callable[[Sequence[str]], Sequence[str]]:
    """`readings_comments` of a measurement, over the names of the columns."""
    setups = {name: s.instrument for name, s in measurement.setups.items()}
    return lambda header: readings_comments(measurement.machine, setups, header)


def _statement(
    item: Coordinate | Channel | PassiveJoint | Parameter, role: str
) -> dict[str, str]:
    return _column(column(item.name, item.unit), role, item.about)


def _command_convention(coordinate: Coordinate) -> str:
    """The meaning of a command: places are those of the set-up's tool."""
    if coordinate.name in "xyz" and coordinate.about:
        return f"{coordinate.about}, with the tool of the set-up"
    return coordinate.about


def _meaning(name: str, machine: Machine, setups: Mapping[str, Instrument]) -> str:
    """What a column of readings means; empty for labels, covariates and remarks."""
    try:
        stem = ReadingsColumn.parse(name).stem
    except UnitError:
        return ""
    for c in machine.command:
        if c.name == stem:
            return _command_convention(c)
    for c in machine.joints:
        if c.name == stem:
            return c.about
    by_setup = {
        setup: channel.about
        for setup, instrument in setups.items()
        for channel in instrument.channels
        if channel.name == stem and channel.about
    }
    meanings = dict.fromkeys(by_setup.values())
    if len(meanings) < 2:
        return "".join(meanings)
    return "; ".join(f"{setup}: {phrase}" for setup, phrase in by_setup.items())
