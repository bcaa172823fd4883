"""The machine of a study: its family's geometry, nominal numbers, workspace and home."""

import dataclasses
import fnmatch
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Adjustment, Coordinate, Machine
from oed.text import suggest
from pkm_studies import catalogue, quantities, user_code
from pkm_studies.base import Location
from pkm_studies.quantities import format_value
from pkm_studies.study import Study
from pkm_studies.tables import DriveTable, MachineTable
from pkm_studies.user_code import Origin


# Looks up names that a study uses; an unknown one raises with the nearest known.
def known_name(
    name: str, allowed: Iterable[str], location: Location, kind: str = "set-up"
) -> str:
    """The name, if it is one of `allowed`. Raises InputError."""
    names = list(allowed)
    if name not in names:
        listed_as = "set-ups" if kind == "set-up" else "allowed"
        raise location.error(f"no such {kind}", suggest(name, names, listed_as), name)
    return name


def matching_names(
    patterns: Sequence[str], allowed: Iterable[str], location: Location
) -> list[str]:
    """Known names that match a pattern. Raises InputError where one matches nothing."""
    names = list(allowed)
    for i, pattern in enumerate(patterns):
        if not fnmatch.filter(names, pattern):
            remedy = suggest(pattern.strip("*"), names)
            raise location.item(i).error("no parameter has this name", remedy, pattern)
    return [n for n in names if any(fnmatch.fnmatchcase(n, p) for p in patterns)]


def names_of_one_unit(
    patterns: Sequence[str], units: Mapping[str, str], location: Location
) -> tuple[list[str], str]:
    """Known names that match any of the patterns, and their unit.

    units  of the known names

    Raises InputError for no name, and for names of several units.
    """
    matched = matching_names(patterns, units, location)
    if not matched:
        raise location.error(
            "the list is empty", 'name parameters or patterns: ["dq*"]'
        )
    example = {units[name]: name for name in matched}  # one for each unit
    if len(example) > 1:
        kinds = " and ".join(f"{name} ({unit})" for unit, name in example.items())
        raise location.error(
            f"parameters of different kinds: {kinds}", "make one table for each kind"
        )
    return matched, next(iter(example))


# Commands that a machine cannot reach, in words.

#: remedy for poses out of reach
REACH_REMEDY = (
    "keep to poses the machine can reach; check tool and units, and well inside the"
    " workspace the model's guess"
)


def check_joint_range(
    machine: Machine,
    command: Array,
    q: Array,
    location: Location,
    remedy: str = "keep to poses within",
) -> None:
    """Raises InputError where joints (n, nq) at commands (n, n_dof) leave their range."""
    outside = machine.joints_out_of_range(q)
    if not outside:
        return
    first = [entry for entry in outside if entry[1] == outside[0][1]]
    row, name, value, lower, upper = max(
        first, key=lambda entry: max(entry[3] - entry[2], entry[2] - entry[4])
    )
    unit = next(joint.unit for joint in machine.joints if joint.name == name)
    needed, low, high = (format_value(v, unit) for v in (value, lower, upper))
    pose = pose_words(machine, command[row])
    raise location.error(
        f"the pose {pose} needs {name} = {needed}, outside the joint's range",
        f"{name} goes from {low} to {high}: {remedy}",
    )


def pose_words(machine: Machine, command: Array) -> str:
    """A command (n_dof,), SI, in the units in which a person writes it."""
    values = zip(machine.command, command, strict=True)
    return ", ".join(f"{c.name} = {format_value(v, c.unit)}" for c, v in values)


def reach_problem(error: AssemblyError, machine: Machine) -> str:
    """How many commands cannot be reached, the first one, and why."""
    if error.first is None:
        return str(error)
    poses = "1 pose" if len(error.indices) == 1 else f"{len(error.indices)} poses"
    first = pose_words(machine, error.first)
    return f"{poses} cannot be reached, the first at {first}: {error.reason}"


# What moves the parameters of a machine, as [[machine.adjust]] states it.

#: what a table may state, and what it is of the adjustment
AMOUNTS = ("step", "sd", "most")


def add_adjustments(
    table: MachineTable, machine: Machine, location: Location
) -> Machine:
    """The machine with the study's adjustments, if any. Raises InputError."""
    if table.adjust is None:
        return machine
    fixed = machine.frame if table.fixed is None else ()
    adjustments: dict[str, Adjustment] = {}
    for i, entry in enumerate(table.adjust):
        field = location.path("adjust", i)
        unit_by_name = {p.name: p.unit for p in machine.parameters}
        of_names = field.key("parameters")
        names, unit = names_of_one_unit(entry.parameters, unit_by_name, of_names)
        unit_of = dict.fromkeys(AMOUNTS, unit)
        amounts = quantities.read_values(entry.amounts, unit_of, field)
        for key, value in entry.amounts.items():
            if value < 0.0 or (value == 0.0 and key.startswith("most")):
                raise field.key(key).error("no such amount", "give a number > 0", value)
        conventions = [name for name in names if name in fixed]
        if conventions:
            raise of_names.error(
                f"{conventions[0]} only chooses the base frame, and nothing moves it",
                "name the others",
                entry.parameters,
            )
        for name in names:
            adjustments[name] = Adjustment(_words(entry.by, name), **amounts)
    parameters = tuple(
        dataclasses.replace(p, adjust=adjustments.get(p.name))
        for p in machine.parameters
    )
    return dataclasses.replace(machine, parameters=parameters)


def _words(by: str, name: str) -> str:
    """What moves a parameter: with the number in its name for `{i}`."""
    number = re.search(r"\d+", name)
    return by.replace("{i}", number.group() if number else name)


#: how parameters say that they are the zero of a joint's scale: `zero of leg 1`
ZERO = "zero of "
ASSEMBLY_REMEDY = (
    "check the numbers and their units; give [machine] home and workspace, where they"
    " are not the model's; look at it: oed check STUDY --picture home.png"
)


def study_kinematics(study: Study) -> Kinematics:
    """The kinematics of the model with the study's numbers. Raises InputError."""
    location = study.location.key("machine")
    machine, changed = _described(study.machine, study.origin, location, assembled=True)
    kinematics = Kinematics(machine)
    if changed:
        check_home(kinematics, location)
    return kinematics


def study_machine(study: Study, *, assembled: bool = True) -> Machine:
    """The model with the study's numbers, `assembled` at home. Raises InputError."""
    location = study.location.key("machine")
    return described_machine(study.machine, study.origin, location, assembled=assembled)


def described_machine(
    table: MachineTable, origin: Origin, location: Location, *, assembled: bool = True
) -> Machine:
    """The machine of a table [machine]. Raises InputError.

    origin     of the table: where a model's file lies, and whether it may run
    location   of the table, for errors
    assembled  whether it must assemble at home
    """
    machine, changed = _described(table, origin, location, assembled=assembled)
    if assembled and changed:
        check_home(Kinematics(machine), location)
    return machine


def _described(
    table: MachineTable, origin: Origin, location: Location, *, assembled: bool
) -> tuple[Machine, bool]:
    """The machine of a table, and whether it is another than one of the catalogue."""
    field = location.key("model")
    model: Machine = catalogue.machine(table.model, origin, field, assembled=assembled)
    machine = _family_machine(table, model, location)
    if table.nominal:
        unit_of = {p.name: p.unit for p in machine.parameters}
        machine = replace_nominal(
            machine,
            quantities.read_values(table.nominal, unit_of, location.key("nominal")),
        )
    machine = _replace_ranges(table, machine, location)
    changed = machine is not model or user_code.is_file(table.model)
    if isinstance(table.drive, DriveTable):
        _check_drive(table.drive, machine, location.key("drive"))
        machine = dataclasses.replace(machine, drive=table.drive.kind)
    elif table.drive is not None:
        machine = dataclasses.replace(machine, drive=table.drive)
    return add_adjustments(table, machine, location), changed


def _check_drive(table: DriveTable, machine: Machine, location: Location) -> None:
    """Raises InputError for numbers that the drive or the joints of a machine lack."""
    turns = any(joint.unit == "rad" for joint in machine.joints)
    stated = {
        "ratio": (table.ratio is not None, turns and table.kind in ("gear", "belt")),
        "stages": (bool(table.stages), turns and table.kind in ("gear", "belt")),
        "lead_mm": (table.lead_mm is not None, table.kind == "screw"),
    }
    for name, (is_stated, is_possible) in stated.items():
        if is_stated and not is_possible:
            problem = f"a {table.kind} on the joints of {machine.name} has none"
            raise location.key(name).error(problem, "leave it out, or correct `kind`")
    if table.ratio is not None and table.stages:
        remedy = "give one of the two: ratio is the product of stages"
        raise location.key("stages").error("ratio is given as well", remedy)


def _family_machine(table: MachineTable, model: Machine, location: Location) -> Machine:
    location = location.key("geometry")
    if not table.geometry:
        return model
    if model.family is None:
        problem = f"{model.name} has one geometry"
        raise location.error(problem, "give its numbers as [machine.nominal]")
    by_name = {d.name: d for d in model.family.dimensions}
    geometry = {}
    for key, value in table.geometry.items():
        name, unit = quantities.split_key(
            key, {n: d.unit for n, d in by_name.items()}, location
        )
        array = _array(value, location.key(key))
        dimension = by_name[name]
        wanted = dimension.shape
        fits = len(wanted) == array.ndim and all(
            n is None or n == m for n, m in zip(wanted, array.shape, strict=True)
        )
        one_for_all = array.shape == wanted[1:]
        if not (fits or one_for_all):
            counts = " x ".join("any" if n is None else str(n) for n in wanted) or "1"
            shape = " x ".join(map(str, array.shape)) or "1"
            misfit = f"{shape} numbers, where {counts} belong"
            raise location.key(key).error(misfit, f"give {dimension.about}")
        geometry[name] = (
            units.to_si(array, unit)
            if array.ndim
            else float(units.to_si(float(array), unit))
        )
    try:
        return model.family.build(geometry)
    except ValueError as error:
        names = ", ".join(quantities.column(d.name, d.unit) for d in by_name.values())
        raise location.error(str(error), f"the table may have {names}") from error


def _array(value: object, location: Location) -> Array:
    try:
        return np.asarray(value, dtype=float)
    except ValueError:
        remedy = "give lists of the same length, one a point"
        raise location.error("the rows differ in length", remedy) from None


def replace_nominal(model: Machine, nominal: Mapping[str, float]) -> Machine:
    """A machine with some nominal numbers, SI, by name.

    The range of joint `q1` goes with the "zero of leg 1", of a carriage or a cable: where
    joints are strokes from home, their zeros are the lengths there.
    """
    parameters = [
        dataclasses.replace(p, nominal=nominal.get(p.name, p.nominal))
        for p in model.parameters
    ]
    moved = {
        f"q{new.about.rpartition(' ')[2]}": new.nominal - old.nominal
        for new, old in zip(parameters, model.parameters, strict=True)
        if new.about.startswith(ZERO)
    }
    joints = [
        dataclasses.replace(joint, lower=joint.lower - by, upper=joint.upper - by)
        for joint in model.joints
        for by in (moved.get(joint.name, 0.0),)
    ]
    return dataclasses.replace(model.with_parameters(parameters), joints=tuple(joints))


def _replace_ranges(table: MachineTable, model: Machine, location: Location) -> Machine:
    """The machine with the study's workspace, joint ranges and home."""
    if not (table.workspace or table.travel or table.home):
        return model
    command = _ranges(table.workspace, model.command, location.key("workspace"))
    joints = _ranges(table.travel, model.joints, location.key("travel"))
    unit_of = {c.name: c.unit for c in model.command}
    stated = quantities.read_values(table.home, unit_of, location.key("home"))
    home = dict(model.home) | stated
    machine = dataclasses.replace(
        model, command=command, joints=joints, home=home, drawn=model.drawn or model
    )
    keys = {quantities.split_key(key, unit_of, location)[0]: key for key in table.home}
    for _, name, _, *ends in machine.out_of_range(machine.home_command[None]):
        unit = unit_of[name]
        key = keys.get(name, quantities.column(name, unit))
        value = quantities.format_as(home[name], unit, key)
        low, high = (quantities.format_as(end, unit, key) for end in ends)
        problem = f"home has {name} = {value}, outside the workspace"
        remedy = f"state a home pose inside: {name} goes from {low} to {high}"
        raise location.path("home", key).error(problem, remedy)
    return machine


def _ranges(
    table: Mapping[str, tuple[float, float]],
    coordinates: tuple[Coordinate, ...],
    location: Location,
) -> tuple[Coordinate, ...]:
    unit_of = {c.name: c.unit for c in coordinates}
    ranges = {}
    for key, ends in table.items():
        name, unit = quantities.split_key(key, unit_of, location)
        low, high = (float(v) for v in units.to_si(ends, unit))
        if not low < high:
            remedy = "give [lower, upper]"
            raise location.key(key).error("the range is empty", remedy, list(ends))
        ranges[name] = low, high
    return tuple(
        dataclasses.replace(c, lower=ranges[c.name][0], upper=ranges[c.name][1])
        if c.name in ranges
        else c
        for c in coordinates
    )


def check_home(kinematics: Kinematics, location: Location) -> None:
    """Raises InputError unless the machine closes at home in its mode and joint ranges."""
    machine = kinematics.machine
    home = machine.home_command[None]
    try:
        _, q = kinematics.inverse(home)
    except AssemblyError as error:
        problem = f"the home pose fails: {error}"
        raise location.error(problem, ASSEMBLY_REMEDY) from error
    check_joint_range(machine, home, q, location, ASSEMBLY_REMEDY)
