"""What a machine is: a closure and a parameter table, from which all else is derived.

A machine is assembled when `closure(x, q, p) = 0` for its pose coordinates x, joint
coordinates q and geometric parameters p. A new machine is one module that builds one
`Machine`; see `pkm_models.machines` for examples.
"""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from oed import units
from oed.base import Array, Mask, Orientation


@dataclasses.dataclass(frozen=True, slots=True)
class Adjustment:
    """A motion that a fitter makes, and how exactly."""

    by: str  #: what to turn, shift or shim, in words
    step: float = 0.0  #: smallest amount, SI; 0 where it is turned continuously
    #: standard deviation of the amount as the fitter sets it, SI; that of an error
    #: anywhere within a step where it is not stated
    sd: float | None = None
    #: largest amount to either side, SI; 0: four tolerances of the parameter
    most: float = 0.0

    @property
    def error(self) -> float:
        """Standard deviation of the fitter's error, SI."""
        return self.step / math.sqrt(12.0) if self.sd is None else self.sd


@dataclasses.dataclass(frozen=True, slots=True)
class Parameter:
    """A calibration parameter.

    name       unique within a machine or an instrument
    nominal    value from the drawing, SI
    tolerance  prior standard deviation, SI
    unit       SI unit: m, rad, s, N, K or 1
    about      what it is, for tables
    bounds     least and largest value that it can have, SI
    adjust     what moves it at the machine; None where nothing does
    expected   prior mean, SI, where an earlier session knows better than the drawing

    >>> from oed import Parameter
    >>> Parameter("l1", nominal=3.350, tolerance=0.5e-3, unit="m").tolerance
    0.0005
    """

    name: str
    nominal: float
    tolerance: float
    unit: str
    about: str = ""
    bounds: tuple[float, float] = (-np.inf, np.inf)
    adjust: Adjustment | None = None
    expected: float | None = None

    def __post_init__(self) -> None:
        if self.unit not in units.DISPLAY:
            raise ValueError(
                f"parameter {self.name}: unit {self.unit!r} is not SI (m, rad, s, N, K or 1)"
            )
        finite = np.isfinite(self.nominal) and np.isfinite(self.tolerance)
        if not finite or self.tolerance < 0.0:
            raise ValueError(
                f"parameter {self.name}: nominal and tolerance must be finite, tolerance >= 0"
            )
        if not self.bounds[0] <= self.nominal <= self.bounds[1]:
            raise ValueError(f"parameter {self.name}: nominal is out of its bounds")

    @property
    def mean(self) -> float:
        """Prior mean, SI: nominal without an earlier session."""
        return self.nominal if self.expected is None else self.expected


@dataclasses.dataclass(frozen=True, slots=True)
class CommonTolerance:
    """Parameters whose errors are correlated: parts of one batch, holes of one jig."""

    names: tuple[str, ...]  #: of the k parameters
    #: between each two of them, below 1; or all of them, (k, k)
    correlation: float | tuple[tuple[float, ...], ...]


if TYPE_CHECKING:
    Expr = Any  # CasADi ships no type stubs
else:

    class Expr:
        """A CasADi SX expression, as signatures name it."""


#: Expressions or numbers by the name of their coordinate or parameter.
Values = Mapping[str, Expr]
Strut = tuple[Expr, Expr]  #: Ends of a strut, at the base and at the platform.
#: Pose and joints from which Newton's method starts.
Start = tuple[Sequence[Expr], Sequence[Expr]]
NO_SHIFT = (0.0, 0.0, 0.0)  #: the reference tool's point (3,), m

#: a coordinate may exceed its range by this share of the range's upper end
RANGE_SLACK = 1e-9


@dataclasses.dataclass(frozen=True, slots=True)
class Coordinate:
    """A pose, joint or command coordinate with its range, in the SI `unit`.

    about  what it measures: frame and sense, for tables

    >>> from oed import Coordinate
    >>> z = Coordinate("z", "m", lower=0.0, upper=1.5, about="height above the table")
    >>> z.upper
    1.5
    """

    name: str
    unit: str
    lower: float = -np.inf
    upper: float = np.inf
    about: str = ""


@dataclasses.dataclass(frozen=True, slots=True)
class Component:
    """A pose error component as a user reads it.

    name           such as `x` or `theta`
    unit           SI unit
    compensatable  whether the controller can null it
    about          what it measures: frame and sense, for tables

    >>> from oed import Component
    >>> Component("theta", "rad", compensatable=False).compensatable
    False
    """

    name: str
    unit: str
    compensatable: bool
    about: str = ""


@dataclasses.dataclass(frozen=True, slots=True)
class PointGroup:
    """Joint centres of one body, whose rigid motions name null directions.

    name    such as `platform joints`
    origin  of the body's frame, in words
    points  for each centre the names of its x, y, z error parameters, and its nominal
            place (3,) in the body's frame, m

    >>> from oed import PointGroup
    >>> ball = (("dx", "dy", "dz"), (0.1, 0.0, 0.0))
    >>> PointGroup("platform joints", "the tool point", (ball,)).points[0][1]
    (0.1, 0.0, 0.0)
    """

    name: str
    origin: str
    points: tuple[tuple[tuple[str, str, str], tuple[float, float, float]], ...]


@dataclasses.dataclass(frozen=True, slots=True)
class PassiveJoint:
    """A passive joint of a machine, as `Machine.passive` lists it.

    name   such as `swing1`; unique among the machine's coordinates
    unit   SI unit, rad or m
    value  its angle or length, a CasADi expression of pose, joints and parameters
    about  what it measures: axis and sense, for tables

    >>> from oed import PassiveJoint
    >>> PassiveJoint("swing1", "rad", 0.1, "swing of leg 1, outward").unit
    'rad'
    """

    name: str
    unit: str
    value: Any
    about: str


def _translation_error(command: Values, twist: Sequence[Expr]) -> Sequence[Expr]:
    return list(twist[:3])


@dataclasses.dataclass(frozen=True, slots=True)
class Dimension:
    """One entry of a family's table of geometry."""

    name: str  #: as in the table, without its unit
    unit: str  #: SI unit
    #: () for a number, (3,) or (6, 3) for a list; None for a length that the user
    #: chooses, as in (None, 2)
    shape: tuple[int | None, ...]
    default: Any  #: SI value; None where the family derives it from the others
    about: str  #: what it is


@dataclasses.dataclass(frozen=True, slots=True)
class Family:
    """Machines of one architecture and any geometry.

    build(geometry) the machine of these SI values by name, arrays or numbers; entries
                    that are left out are derived. Raises ValueError, in a sentence,
                    where they make no machine
    """

    name: str  #: as the model in a study
    dimensions: tuple[Dimension, ...]  #: the table of geometry
    build: Callable[[Mapping[str, Any]], Machine]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Machine:
    """A parallel machine, defined by its closure.

    Functions get coordinates by name, as CasADi SX scalars in a mapping.

    name, source, about  for the catalogue; `source` is the publication
    pose, joints         coordinates x and q
    command              coordinates in which a user commands the machine
    parameters           geometric parameters p, calibrated
    components           pose error components, as `read_error` gives them
    home                 command of the home pose, by coordinate
    lever                m; turns angles into lengths in the publications' scalings
    frame                parameters held at nominal: they only choose the base frame
    correlated           parameters whose errors have a common cause
    groups               joint centres that belong to one body
    closure(x, q, p)     scalars that are zero when assembled; as many as pose plus
                         joint coordinates less the degrees of freedom, more where the
                         machine is redundant
    platform(x)          rotation (3 x 3) and origin (3,) of the platform frame in the
                         base frame, at the tool point of the reference tool
    commanded(x, tip)    quantities that the controller holds, one a degree of freedom;
                         `tip` is the tool point (3,) of the set-up's tool
    target(c)            the same quantities as functions of the user's command
    guess(c)             start of Newton's method at a command: pose and joint
                         values; as guess(c, p) it follows the parameters, so that the
                         machine assembles at any size
    read_error(c, twist) components of a small pose error [translation, rotation
                         vector] of the tool point
    skeleton(x, q, p)    polylines of points (3,), for drawings
    struts(x, q, p)      ends (base, platform) of the strut that each joint drives,
                         points (3,) in the base frame. Gravity, heat and bending act on
                         struts. The first row of the closure that holds joint k is the
                         distance of its ends less the strut's length, m
    passive(x, q, p)     passive joints, which sensors can read and locks can hold
    drawn                the machine as drawn, where `nominal` or `home` are those of
                         another; its home pose states the assembly mode that is meant
    family               what made the machine from a table of geometry, if anything did
    cable_stiffness      E A of the cable that each joint pays out, N: recorded tensions
                         stretch it; inf where it is not known. None where the struts
                         are no cables
    base_frame           origin and axes of the base frame, in words
    tool_axis            where z of the platform's frame points, in words; "" where the
                         platform does not turn
    orientation          how the angles of the pose make the rotation of the platform
    command_orientation  the same of the command's angles
    drive                what moves the joints: `screw`, `belt`, `cable`, `gear` or
                         `linear_motor`; "" where it is not stated. Effects that such a
                         drive cannot have are left out

    A slider on a straight guide, whose scale has a home error:

    >>> import casadi as ca
    >>> from oed import Component, Coordinate, Machine, Parameter
    >>> slider = Machine(
    ...     name="slider",
    ...     source="a drawing",
    ...     pose=(Coordinate("x", "m"),),
    ...     joints=(Coordinate("q", "m", 0.0, 1.0),),
    ...     command=(Coordinate("x", "m", 0.0, 1.0),),
    ...     parameters=(Parameter("home", 0.0, 1e-4, "m"),),
    ...     components=(Component("x", "m", compensatable=True),),
    ...     home={"x": 0.5},
    ...     lever=1.0,
    ...     closure=lambda x, q, p: [x["x"] - q["q"] - p["home"]],
    ...     platform=lambda x: (ca.SX.eye(3), ca.vertcat(x["x"], 0.0, 0.0)),
    ...     commanded=lambda x, tip: [tip[0]],
    ...     target=lambda c: [c["x"]],
    ...     guess=lambda c: ([c["x"]], [c["x"]]),
    ...     read_error=lambda c, twist: [twist[0]],
    ... )
    >>> slider.nominal
    array([0.])
    """

    name: str
    source: str
    pose: tuple[Coordinate, ...]
    joints: tuple[Coordinate, ...]
    command: tuple[Coordinate, ...]
    parameters: tuple[Parameter, ...]
    components: tuple[Component, ...]
    home: Mapping[str, float]
    lever: float
    closure: Callable[[Values, Values, Values], Sequence[Expr]]
    platform: Callable[[Values], tuple[Expr, Expr]]
    commanded: Callable[[Values, Expr], Sequence[Expr]]
    target: Callable[[Values], Sequence[Expr]]
    guess: Callable[..., Start]
    read_error: Callable[[Values, Sequence[Expr]], Sequence[Expr]] = _translation_error
    skeleton: Callable[[Values, Values, Values], Sequence[Sequence[Expr]]] | None = None
    struts: Callable[[Values, Values, Values], Sequence[Strut]] | None = None
    passive: Callable[[Values, Values, Values], Sequence[PassiveJoint]] = (
        lambda x, q, p: ()
    )
    frame: tuple[str, ...] = ()
    correlated: tuple[CommonTolerance, ...] = ()
    groups: tuple[PointGroup, ...] = ()
    about: str = ""
    drawn: Machine | None = None
    family: Family | None = None
    cable_stiffness: tuple[float, ...] | None = None
    drive: str = ""
    base_frame: str = ""
    tool_axis: str = ""
    orientation: Orientation | None = None
    command_orientation: Orientation | None = None

    def __post_init__(self) -> None:
        names = [p.name for p in self.parameters]
        repeated = {n for n in names if names.count(n) > 1}
        if repeated:
            raise ValueError(
                f"machine {self.name}: parameter names used twice: {sorted(repeated)}"
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
    def alignment_lever(self) -> float:
        """Weight of rotations against lengths in a best alignment of poses, m.

        0 where no drive corrects a turn: what turns the platform about its tool point, as
        an error of a passive leg does, must not shift the places then.
        """
        turns = [c for c in self.components if c.unit == "rad" and c.compensatable]
        return self.lever if turns else 0.0

    @property
    def driven(self) -> tuple[str, ...]:
        """Names of the components that the controller corrects."""
        return tuple(c.name for c in self.components if c.compensatable)

    @property
    def home_command(self) -> Array:
        """Command (n_dof,) of the home pose, SI."""
        return np.array([self.home[c.name] for c in self.command])

    def index(self, name: str) -> int:
        """Position of a parameter in the parameter vector. Raises KeyError."""
        names = [p.name for p in self.parameters]
        if name not in names:
            raise KeyError(
                f"machine {self.name} has no parameter {name!r}; it has {names}"
            )
        return names.index(name)

    def with_parameters(self, parameters: Sequence[Parameter]) -> Machine:
        """The machine with another table of its names. Raises ValueError."""
        if [p.name for p in parameters] != [p.name for p in self.parameters]:
            raise ValueError(
                f"machine {self.name}: a new parameter table must keep names and order"
            )
        drawn = self.drawn or self
        return dataclasses.replace(self, parameters=tuple(parameters), drawn=drawn)

    def passive_joints(self) -> list[PassiveJoint]:
        """The passive joints, in expressions of symbols."""
        import casadi as ca  # what states a machine loads without it

        tables = self.pose, self.joints, self.parameters
        symbols = [{item.name: ca.SX.sym(item.name) for item in t} for t in tables]
        return list(self.passive(*symbols))

    def passive_at_home(self) -> dict[str, float]:
        """Value of each passive joint, SI, by name, at the start for the home pose."""
        import casadi as ca  # what states a machine loads without it

        p_by_name = {p.name: p.nominal for p in self.parameters}
        pose, joints = self.start(self.home, p_by_name)
        x = dict(zip((c.name for c in self.pose), pose, strict=True))
        q = dict(zip((c.name for c in self.joints), joints, strict=True))
        passive = self.passive(x, q, p_by_name)
        return {j.name: round(float(ca.DM(j.value)), 12) + 0.0 for j in passive}

    def start(self, c: Values, p: Values) -> Start:
        """Start of Newton's method at a command and parameters: pose and joints."""
        follows = len(inspect.signature(self.guess).parameters) > 1
        return self.guess(c, p) if follows else self.guess(c)

    def out_of_range(
        self, command: Array, tool: Sequence[float] = NO_SHIFT
    ) -> list[tuple[int, str, float, float, float]]:
        """Commands outside a tool's workspace: row, name, value and ends."""
        return _outside(command, self.workspace(tool))

    def joints_out_of_range(
        self, q: Array
    ) -> list[tuple[int, str, float, float, float]]:
        """Joint values (n, nq) outside their ranges, each as `out_of_range` has it."""
        return _outside(q, self.joints)

    def workspace(self, tool: Sequence[float] = NO_SHIFT) -> tuple[Coordinate, ...]:
        """Command coordinates with the ranges for a tool, which moves x, y and z."""
        shift = dict(zip("xyz", tool, strict=True))
        return tuple(_shifted(c, shift.get(c.name, 0.0)) for c in self.command)

    def with_tool(self, command: Array, tool: Array) -> Array:
        """Commands (n, n_dof) whose x, y and z are moved with the tool point (3,)."""
        shift = dict(zip("xyz", tool.tolist(), strict=True))
        by_coordinate = [shift.get(c.name, 0.0) for c in self.command]
        return np.asarray(command + np.array(by_coordinate))

    def and_home(self, command: Array, tool: Array) -> Array:
        """Commands (n, n_dof) of a tool point (3,), then home with it (n + 1, n_dof)."""
        return np.vstack([command, self.with_tool(self.home_command, tool)])


def _outside(
    values: Array, coordinates: tuple[Coordinate, ...]
) -> list[tuple[int, str, float, float, float]]:
    """Values (n, k) outside the ranges of coordinates: row, name, value, ends."""
    return [
        (int(row), c.name, float(values[row, k]), c.lower, c.upper)
        for k, c in enumerate(coordinates)
        for row in np.flatnonzero(_exceeds(values[:, k], c))
    ]


def _exceeds(values: Array, coordinate: Coordinate) -> Mask:
    """Mask (n,) of values outside a coordinate's range, rounding aside."""
    upper = coordinate.upper if np.isfinite(coordinate.upper) else 1.0
    slack = RANGE_SLACK * max(1.0, abs(upper))
    below = values < coordinate.lower - slack
    above = values > coordinate.upper + slack
    return below | above


def _shifted(coordinate: Coordinate, shift: float) -> Coordinate:
    lower, upper = coordinate.lower + shift, coordinate.upper + shift
    return dataclasses.replace(coordinate, lower=lower, upper=upper)
