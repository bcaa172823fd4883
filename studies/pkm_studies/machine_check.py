"""Whether the functions of a user's own machine fit its coordinates: told as bad input,
before anything is computed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np

from oed.kinematics import AssemblyError, Kinematics, symbols
from oed.machine import Machine
from pkm_studies.errors import Place, shorten

PLAIN = {f.name: f.default for f in dataclasses.fields(Machine)}["read_error"]


def check_machine(machine: Machine, place: Place) -> None:
    """Raises InputError, naming the function of the machine that does not fit, or why
    its home pose fails.
    """
    _shapes(machine, place)
    _numbers(machine, place)
    try:
        Kinematics(machine).inverse(machine.home_command)
    except AssemblyError as error:
        raise place.error(
            f"the home pose fails: {error}",
            "check the closure there by hand, and guess",
        ) from error


def _shapes(machine: Machine, place: Place) -> None:
    x, q, p, c = (
        symbols("s", s)[1]
        for s in (machine.pose, machine.joints, machine.parameters, machine.command)
    )
    nx, nq, dof = len(x), len(q), len(c)
    rows = _call(
        "closure", lambda: ca.vertcat(*machine.closure(x, q, p)).numel(), place
    )
    if rows < nx + nq - dof:
        needed = f"{nx} pose + {nq} joint - {dof} command coordinates"
        raise place.error(
            f"closure gives {rows} equations, not {nx + nq - dof}",
            f"there must be one for each: {needed}",
        )
    rotation, point = _call("platform", lambda: machine.platform(x), place)
    _same("platform (rotation)", ca.SX(rotation).shape, (3, 3), place)
    _same("platform (point)", ca.SX(point).numel(), 3, place)
    _same("target", _call("target", lambda: len(machine.target(c)), place), dof, place)
    _same(
        "commanded",
        _call("commanded", lambda: len(machine.commanded(x, ca.SX.zeros(3))), place),
        dof,
        place,
    )
    guess = _call("guess", lambda: tuple(len(part) for part in machine.guess(c)), place)
    _same("guess (values for pose and joints)", guess, (nx, nq), place)
    read = _call(
        "read_error", lambda: len(machine.read_error(c, [ca.SX(0.0)] * 6)), place
    )
    _same("read_error", read, len(machine.components), place)
    if machine.read_error is PLAIN and any(k.unit != "m" for k in machine.components):
        names = ", ".join(k.name for k in machine.components if k.unit != "m")
        raise place.error(
            f"{names} would be read as a translation",
            "give read_error: twist[3:] are the rotations",
        )


def _numbers(machine: Machine, place: Place) -> None:
    """The closure at the guess for home, in numbers: functions of `math` quietly give
    no number for a symbol.
    """
    (x, xs), (q, qs), (p, ps), (c, cs) = (
        symbols("s", s)
        for s in (machine.pose, machine.joints, machine.parameters, machine.command)
    )
    closure = ca.Function(
        "closure", [x, q, p], [ca.vertcat(*machine.closure(xs, qs, ps))]
    )
    guess = ca.Function("guess", [c], [ca.vertcat(*part) for part in machine.guess(cs)])
    value = closure(*guess(machine.home_command), machine.nominal)
    if not np.isfinite(np.array(value)).all():
        remedy = (
            "use ca.cos, ca.sqrt and so on, not those of math, and a guess where roots"
            " and arcs have a value"
        )
        raise place.error("closure is not a number at the guess for home", remedy)


def _call(name: str, work: Callable[[], Any], place: Place) -> Any:
    """What a function of the machine gives; what it raises is told as bad input."""
    try:
        return work()
    except KeyError as error:
        raise place.error(
            f"{name} asks for {error}, which the machine has not", "check the name"
        ) from error
    except Exception as error:
        problem = (
            f"{name} fails with {type(error).__name__}: {shorten(str(error), 120)}"
        )
        raise place.error(problem, "mend it in the machine's file") from error


def _same(name: str, found: object, wanted: object, place: Place) -> None:
    if found != wanted:
        raise place.error(
            f"{name} gives {found}, not {wanted}", "give one for each coordinate"
        )
