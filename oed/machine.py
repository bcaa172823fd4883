"""What a machine is: a closure and a parameter table. Everything else is derived from
it.

A machine is assembled when `closure(x, q, p) = 0` for its pose coordinates x, joint
coordinates q and geometric parameters p. A new machine is one module that builds one
`Machine`; see `pkm_models.machines` for examples.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from oed import units
from oed.arrays import Array

#: A CasADi SX expression (CasADi ships no type stubs).
Expr = Any
Values = Mapping[str, Expr]


@dataclasses.dataclass(frozen=True, slots=True)
class Parameter:
    """A calibration parameter. `nominal` and `tolerance` (prior standard deviation) are
    in SI `unit`.
    """

    name: str
    nominal: float
    tolerance: float
    unit: str
    about: str = ""

    def __post_init__(self) -> None:
        if self.unit not in units.DISPLAY:
            raise ValueError(
                f"parameter {self.name}: unit {self.unit!r} is not SI (m, rad, s, N, K"
                " or 1)"
            )
        if not (
            np.isfinite(self.nominal)
            and np.isfinite(self.tolerance)
            and self.tolerance >= 0.0
        ):
            raise ValueError(
                f"parameter {self.name}: nominal and tolerance must be finite,"
                " tolerance >= 0"
            )


@dataclasses.dataclass(frozen=True, slots=True)
class Coordinate:
    """A pose, joint or command coordinate with its range (SI `unit`)."""

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf


@dataclasses.dataclass(frozen=True, slots=True)
class Component:
    """A pose error component as a user reads it. The controller can null it if
    `compensatable`.
    """

    name: str
    unit: str
    compensatable: bool


@dataclasses.dataclass(frozen=True, slots=True)
class PointGroup:
    """Joint centres that belong to one body.

    `points` holds for each centre the names of its x, y, z error parameters and its
    nominal place (m) in the body's frame, whose origin is `origin` in words. The
    group's rigid motions are the directions in parameter space that a distance cannot
    tell from a motion of the body: lost directions are named by them.
    """

    name: str
    origin: str
    points: tuple[tuple[tuple[str, str, str], tuple[float, float, float]], ...]


def _no_error(command: Values, twist: Sequence[Expr]) -> Sequence[Expr]:
    return list(twist[:3])


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A parallel machine, told by its closure.

    Functions get their coordinates by name (CasADi SX scalars in a mapping).

    closure(x, q, p)       list of scalars, zero when assembled; as many as pose plus
                           joint coordinates less the degrees of freedom (more where the
                           machine is redundant)
    platform(x)            rotation matrix (3 x 3) and origin (3,) of the platform
                           frame, at the tool point of the reference tool, in the base
                           frame
    commanded(x, tip)      what the controller holds (one scalar a degree of freedom) at
                           a pose; `tip` is the tool point (3,) of the set-up's tool
    target(c)              the same quantities as functions of the user's command
                           coordinates
    guess(c)               start for Newton at a command: (pose values, joint values)
    read_error(c, twist)   components of a small pose error [translation, rotation
                           vector] of the tool point
    skeleton(x, q, p)      for drawings: polylines of points (3,)
    struts(x, q, p)        ends (base, platform), points (3,) in the base frame, of the
                           strut that each joint drives: what gravity, heat and bending
                           act on. The first row of the closure that holds joint k is
                           the distance of its ends less what it should be, m
    """

    name: str
    source: str
    pose: tuple[Coordinate, ...]
    joints: tuple[Coordinate, ...]
    command: tuple[Coordinate, ...]
    parameters: tuple[Parameter, ...]
    components: tuple[Component, ...]
    home: Mapping[str, float]
    lever: float  # m; turns angle parameters into lengths in the paper's scalings
    closure: Callable[[Values, Values, Values], Sequence[Expr]]
    platform: Callable[[Values], tuple[Expr, Expr]]
    commanded: Callable[[Values, Expr], Sequence[Expr]]
    target: Callable[[Values], Sequence[Expr]]
    guess: Callable[[Values], tuple[Sequence[Expr], Sequence[Expr]]]
    read_error: Callable[[Values, Sequence[Expr]], Sequence[Expr]] = _no_error
    skeleton: Callable[[Values, Values, Values], Sequence[Sequence[Expr]]] | None = None
    struts: Callable[[Values, Values, Values], Sequence[tuple[Expr, Expr]]] | None = (
        None
    )
    frame: tuple[
        str, ...
    ] = ()  # parameters held at nominal because they only choose the base frame
    groups: tuple[PointGroup, ...] = ()
    about: str = ""

    def __post_init__(self) -> None:
        names = [p.name for p in self.parameters]
        twice = {n for n in names if names.count(n) > 1}
        if twice:
            raise ValueError(
                f"machine {self.name}: parameter names used twice: {sorted(twice)}"
            )
        unknown = set(self.frame) - set(names)
        if unknown:
            raise ValueError(
                f"machine {self.name}: frame names unknown parameters {sorted(unknown)}"
            )
        if set(self.home) != {c.name for c in self.command}:
            raise ValueError(
                f"machine {self.name}: home must give every command coordinate"
            )

    @property
    def nominal(self) -> Array:
        """Nominal parameter values (n_parameters,), SI."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def home_command(self) -> Array:
        """Command (n_dof,) of the home pose, SI."""
        return np.array([self.home[c.name] for c in self.command])

    def index(self, name: str) -> int:
        """Position of a parameter in the parameter vector; raises KeyError naming the
        known ones.
        """
        for i, p in enumerate(self.parameters):
            if p.name == name:
                return i
        raise KeyError(
            f"machine {self.name} has no parameter {name!r}; it has"
            f" {[p.name for p in self.parameters]}"
        )

    def with_parameters(self, parameters: Sequence[Parameter]) -> Machine:
        """The same machine with another parameter table (same names, same order)."""
        if [p.name for p in parameters] != [p.name for p in self.parameters]:
            raise ValueError(
                f"machine {self.name}: a new parameter table must keep names and order"
            )
        return dataclasses.replace(self, parameters=tuple(parameters))

    def out_of_range(
        self, command: Array, tool: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> list[tuple[int, str, float, float, float]]:
        """Rows (index, coordinate, value, lower, upper) of `command` (n, n_dof) outside
        the workspace of a tool.
        """
        found = []
        for k, c in enumerate(self.workspace(tool)):
            slack = 1e-9 * max(1.0, abs(c.upper) if np.isfinite(c.upper) else 1.0)
            bad = np.flatnonzero(
                (command[:, k] < c.lower - slack) | (command[:, k] > c.upper + slack)
            )
            found += [
                (int(i), c.name, float(command[i, k]), c.lower, c.upper) for i in bad
            ]
        return found

    def workspace(
        self, tool: Sequence[float] = (0.0, 0.0, 0.0)
    ) -> tuple[Coordinate, ...]:
        """Command coordinates with their ranges; another tool (3,) than the reference
        moves x, y and z along.
        """
        shift = dict(zip("xyz", tool, strict=True))
        return tuple(
            dataclasses.replace(
                c,
                lower=c.lower + shift.get(c.name, 0.0),
                upper=c.upper + shift.get(c.name, 0.0),
            )
            for c in self.command
        )
