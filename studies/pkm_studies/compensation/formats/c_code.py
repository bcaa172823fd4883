"""C: forward and inverse kinematics of the identified machine, and a LinuxCNC module."""

import re
from collections.abc import Sequence
from importlib import resources

import numpy as np

from oed.base import Array
from oed.compensate import compensated_joints
from oed.mechanism import generated_functions
from oed.model import Coordinate, Machine
from pkm_studies.catalogue import Compensation, ControllerFormat, Texts

#: SI units in one of LinuxCNC's units of a metric machine
LINUXCNC_UNITS = {"m": "1e-3", "rad": "(3.14159265358979323846 / 180.0)"}
#: LinuxCNC's axes of lengths by name, and of angles in their order
LENGTHS = {n: f"tran.{n}" for n in "xyz"}
ANGLES = ("a", "b", "c")
#: functions of the C file that CasADi offers and nobody calls stay out of the way
LOCAL = """#if defined(__GNUC__)
#define CASADI_SYMBOL_EXPORT static __attribute__((unused))
#else
#define CASADI_SYMBOL_EXPORT static
#endif
"""
PARAMETER = re.compile(r"^ \* parameter \S+ = (\S+)", re.MULTILINE)


def write(compensation: Compensation) -> Texts:
    """Source, header, and a LinuxCNC module where its axes hold the commands."""
    source = _source(compensation)
    texts = {".c": source, ".h": _comment(compensation) + _template("kinematics.h")}
    axes = linuxcnc_axes(compensation.machine.command)
    if axes is not None:
        texts["_kins.c"] = source + _module(compensation.machine, axes)
    return texts


def _template(name: str) -> str:
    folder = resources.files("pkm_studies").joinpath("compensation/c_templates")
    return folder.joinpath(name).read_text("utf-8")


def _comment(compensation: Compensation) -> str:
    """What the file is, its units and coordinates, and the parameters; closed."""
    machine = compensation.machine
    lines = [
        *compensation.comments,
        "all values in SI units: m, rad",
        *(_coordinate("command", k, c) for k, c in enumerate(machine.command)),
        *(_coordinate("joint", k, c) for k, c in enumerate(machine.joints)),
        *(_coordinate("pose", k, c) for k, c in enumerate(machine.pose)),
    ]
    values = compensation.identified.values
    for p, value in zip(machine.parameters, values, strict=True):
        lines.append(f"parameter {p.name} = {float(value)!r} {p.unit}")
    safe = (line.replace("*/", "* /") for line in lines)
    return "/*\n" + "".join(f" * {line}\n" for line in safe) + " */\n\n"


def _coordinate(kind: str, k: int, coordinate: Coordinate) -> str:
    about = f": {coordinate.about}" if coordinate.about else ""
    return f"{kind}[{k}] {coordinate.name}, {coordinate.unit}{about}"


def _source(compensation: Compensation) -> str:
    machine, values = compensation.machine, compensation.identified.values
    generated = generated_functions(machine, values)
    return "\n".join(
        [
            _comment(compensation) + LOCAL,
            generated.text,
            _sizes(machine, generated.reals, generated.whole),
            f"#define PKM_LONGEST_STEP {generated.longest_step!r}\n",
            _home(compensation),
            _template("solve.c"),
        ]
    )


def _sizes(machine: Machine, reals: int, whole: int) -> str:
    joints, commands = len(machine.joints), len(machine.command)
    # closure and command are as many equations as pose and joints
    closure = len(machine.pose) + joints - commands
    sizes = {
        "X": len(machine.pose),
        "Q": joints,
        "C": commands,
        "PHI": closure,
        "REALS": max(reals, 1),
        "WHOLE": max(whole, 1),
    }
    results = "PKM_OK = 0, PKM_NOT_ASSEMBLED = 1, PKM_OTHER_MODE = 2"
    listed = ", ".join(f"PKM_{name} = {size}" for name, size in sizes.items())
    return f"enum {{ {results} }};\nenum {{ {listed} }};"


def _home(compensation: Compensation) -> str:
    """The home pose with the identified parameters, and the assembly mode."""
    machine, kinematics = compensation.machine, compensation.kinematics
    values, command = compensation.identified.values, machine.home_command
    pose, joints = kinematics.inverse(command, values)
    return "\n".join(
        [
            _array("double pkm_home_pose", pose[0]),
            _array("double pkm_home_joints", joints[0]),
            _array("double pkm_home_command", command),
            _array("signed char pkm_home_mode", kinematics.home_mode.astype(int)),
            "",
        ]
    )


def _array(head: str, values: Array) -> str:
    listed = ", ".join(repr(v) for v in values.tolist())
    return f"static const {head}[] = {{{listed}}};"


def linuxcnc_axes(command: Sequence[Coordinate]) -> list[str] | None:
    """Member of LinuxCNC's pose for each coordinate; None where there are too few."""
    angles = iter(ANGLES)
    axes = []
    for coordinate in command:
        length = coordinate.unit == "m"
        axis = LENGTHS.get(coordinate.name) if length else next(angles, None)
        if axis is None or coordinate.unit not in LINUXCNC_UNITS:
            return None
        axes.append(axis)
    return axes


def _module(machine: Machine, axes: Sequence[str]) -> str:
    units = [LINUXCNC_UNITS[c.unit] for c in machine.command]
    rows = list(enumerate(zip(axes, units, strict=True)))
    read = [f"  command[{k}] = world->{axis} * {unit};" for k, (axis, unit) in rows]
    written = [
        f"  world->{axis} = pkm_last_command[{k}] / {unit};" for k, (axis, unit) in rows
    ]
    joint_units = ", ".join(LINUXCNC_UNITS[j.unit] for j in machine.joints)
    letters = ", ".join(
        f"{axis[-1].upper()} is {c.name}"
        for axis, c in zip(axes, machine.command, strict=True)
    )
    text = _template("linuxcnc_kins.c")
    for mark, part in (
        ("@COMMAND_OF_WORLD@", "\n".join(read)),
        ("@WORLD_OF_COMMAND@", "\n".join(written)),
        ("@MODULE@", "compensation_kins"),
    ):
        text = text.replace(mark, part)
    head = f"\n/* Axes: {letters}; mm and degrees, joints alike. */\n"
    return f"{head}static const double pkm_joint_unit[] = {{{joint_units}}};\n\n{text}"


def joints(texts: Texts, compensation: Compensation) -> Array:
    """Joints with the parameters that the file states."""
    stated = np.array([float(v) for v in PARAMETER.findall(texts[".h"])])
    return compensated_joints(compensation.kinematics, compensation.command, stated)


controller = ControllerFormat(
    name="c",
    about="C: forward and inverse kinematics, and a LinuxCNC module around them",
    source="this project; CasADi's code generation; LinuxCNC, src/emc/kinematics",
    write=write,
    joints=joints,
)
