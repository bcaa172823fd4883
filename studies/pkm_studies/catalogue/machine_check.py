"""Checks the functions of a user's own machine before anything is computed with them."""

import dataclasses
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from oed.mechanism import AssemblyError, Kinematics, closest_closure, symbols
from oed.model import Machine
from oed.text import shorten
from pkm_studies.base import Location

#: the machine's default for `read_error`, which reads translations
DEFAULT_READ_ERROR = {f.name: f.default for f in dataclasses.fields(Machine)}[
    "read_error"
]


def check_machine(
    machine: Machine, location: Location, *, assembled: bool = True
) -> None:
    """Raises InputError for functions that do not fit, or a home not `assembled`."""
    _check_closure(machine, location)
    _check_sizes(machine, location)
    _check_read_error(machine, location)
    _check_numbers(machine, location)
    if assembled:
        _check_home(machine, location)


def _check_home(machine: Machine, location: Location) -> None:
    try:
        Kinematics(machine).inverse(machine.home_command)
    except AssemblyError as error:
        raise location.error(
            f"the home pose does not assemble; at its guess, {_equations(machine)}",
            "a large one names the strut whose ends or length are wrong; where all are"
            " large, guess is wrong or a length common to all; look at it: oed check FILE"
            " --picture home.png",
        ) from error


def _equations(machine: Machine) -> str:
    """The closure's equations at the guess for home, as words."""
    guess = closest_closure(machine, machine.home_command).guess
    values = [f"{value:.3g}" for value in guess.equations]
    return (
        f"the closure's equations 1 to {len(values)} are {', '.join(values)} (m, rad)"
    )


def _check_closure(machine: Machine, location: Location) -> None:
    x, q, p, c = _named_symbols(machine)
    equations = _call(
        "closure", lambda: ca.vertcat(*machine.closure(x, q, p)).numel(), location
    )
    needed = len(x) + len(q) - len(c)
    if equations < needed:
        counts = f"{len(x)} pose + {len(q)} joint - {len(c)} command coordinates"
        raise location.error(
            f"closure gives {equations} equations, not {needed}",
            f"there must be one for each: {counts}",
        )


def _check_sizes(machine: Machine, location: Location) -> None:
    x, q, p, c = _named_symbols(machine)
    rotation, point = _call("platform", lambda: machine.platform(x), location)
    _check_same("platform (rotation)", ca.SX(rotation).shape, (3, 3), location)
    _check_same("platform (point)", ca.SX(point).numel(), 3, location)
    target = _call("target", lambda: len(machine.target(c)), location)
    _check_same("target", target, len(c), location)
    commanded = _call(
        "commanded", lambda: len(machine.commanded(x, ca.SX.zeros(3))), location
    )
    _check_same("commanded", commanded, len(c), location)
    guess = _call(
        "guess", lambda: tuple(len(part) for part in machine.start(c, p)), location
    )
    sizes = len(x), len(q)
    _check_same("guess (values for pose and joints)", guess, sizes, location)


def _check_read_error(machine: Machine, location: Location) -> None:
    _, _, _, c = _named_symbols(machine)
    twist = [ca.SX(0.0)] * 6
    count = _call("read_error", lambda: len(machine.read_error(c, twist)), location)
    _check_same("read_error", count, len(machine.components), location)
    rotations = [k.name for k in machine.components if k.unit != "m"]
    if machine.read_error is DEFAULT_READ_ERROR and rotations:
        raise location.error(
            f"{', '.join(rotations)} would be read as a translation",
            "give read_error: twist[3:] are the rotations",
        )


def _check_numbers(machine: Machine, location: Location) -> None:
    """Raises InputError where the closure is no number, as by functions of `math`."""
    pose, joints = symbols("s", machine.pose), symbols("s", machine.joints)
    parameters = symbols("s", machine.parameters)
    command = symbols("s", machine.command)
    rows = machine.closure(pose[1], joints[1], parameters[1])
    closure = ca.Function(
        "closure", [pose[0], joints[0], parameters[0]], [ca.vertcat(*rows)]
    )
    start = machine.start(command[1], parameters[1])
    parts = [ca.vertcat(*part) for part in start]
    guess = ca.Function("guess", [command[0], parameters[0]], parts)
    at_home = guess(machine.home_command, machine.nominal)
    value = closure(*at_home, machine.nominal)
    if not np.isfinite(np.array(value)).all():
        remedy = (
            "use ca.cos, ca.sqrt and so on, not those of math, and a guess where roots"
            " and arcs have a value"
        )
        raise location.error("closure is not a number at the guess for home", remedy)


def _named_symbols(machine: Machine) -> tuple[Any, Any, Any, Any]:
    """Symbols of pose, joints, parameters and command, by name."""
    tables = machine.pose, machine.joints, machine.parameters, machine.command
    x, q, p, c = (symbols("s", table)[1] for table in tables)
    return x, q, p, c


def _call(name: str, function: Callable[[], Any], location: Location) -> Any:
    """The value of a machine's function; what it raises becomes an InputError."""
    try:
        return function()
    except KeyError as error:
        raise location.error(
            f"{name} asks for {error}, which the machine has not", "check the name"
        ) from error
    except Exception as error:
        reason = shorten(str(error), 120)
        raise location.error(
            f"{name} fails with {type(error).__name__}: {reason}",
            "mend it in the machine's file",
        ) from error


def _check_same(name: str, value: object, wanted: object, location: Location) -> None:
    if value != wanted:
        raise location.error(
            f"{name} gives {value}, not {wanted}", "give one for each coordinate"
        )
