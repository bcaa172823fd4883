"""What an unmodelled effect is: changes of joints, parameters, set-up or readings.

An effect is linear in its coefficients. Each coefficient is one `Column`: a change per
unit of the coefficient at each pose, as a function of the machine's `State`, with the
coefficient's prior standard deviation. What the form depends on nonlinearly (a time
constant, a screw's pitch) are its `constants`, a grid over which the diagnosis
marginalises. The same columns give the effect's signature in the readings (H delta p,
to first order) and, through the exact closure, a virtual machine that has the effect.
"""

import dataclasses
import fnmatch
import functools
import itertools
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from oed.base import Array, Index
from oed.model import Machine

#: coefficient in expected sizes that no machine has, whatever it is of
IMPOSSIBLE_SIZES = 1e4
#: coefficients, SI, that no machine has: grease and plastics end within 100 K of the shop,
#: and nothing that is built to micrometres or millimetres is off by a metre
IMPOSSIBLE_SI = {"K": 100.0, "m": 1.0}
#: directions in which joints move the tool less than this share of the best are held
DIRECTION_CUTOFF = 0.05


@dataclasses.dataclass(frozen=True, kw_only=True)
class State:
    """State of the machine at m poses of a set-up, reference poses included; nq joints.

    All in SI; NaN where unknown.
    """

    machine: Machine  #: the machine
    setup: str  #: name of the set-up
    instrument: str  #: name of its instrument
    pose: Array  #: (m, nx) pose coordinates
    tool: Array  #: (m, 3) tool point, base frame
    rotation: Array  #: (m, 3, 3) orientation of the platform, base frame
    axis: Array  #: (m, 3) the platform's z, base frame
    joints: Array  #: (m, nq) commanded joint coordinates
    #: (m, nq) sign of each joint's last motion in the run; 0 where nothing is known, as
    #: at a teach pose
    motion_sign: Array
    #: (m, nq) travel since the joint last reversed in the run, m or rad; inf before it
    #: does
    travel_since_reversal: Array
    rate: Array  #: (m, nq) joint velocity at the run's feed
    acceleration: Array  #: (m, nq) joint acceleration at the run's feed
    #: (m, nq) generalised force in each joint per newton along gravity at the tool
    #: point, J^-T w
    tool_force: Array
    #: (m, nq) the same at the middle of the platform's joints; at the tool point where
    #: the machine states no struts
    platform_force: Array
    #: (m, 6, nq) motion of the tool point (3, m) and rotation (3, rad) per unit of each
    #: joint, base frame
    twist: Array
    strut_length: Array  #: (m, nq) length of the strut that the joint drives
    strut_direction: Array  #: (m, nq, 3) its direction from base to platform
    base: Array  #: (m, nq, 3) its end at the base, base frame
    platform: Array  #: (m, nq, 3) its end at the platform, base frame
    joint_per_length: Array  #: (m, nq) joint change that equals a strut longer by 1 m
    #: (m,) place along the run, equal for both directions of travel, rad in [0, 2 pi)
    phase: Array
    run: NDArray[np.str_]  #: (m,) label of the run
    order: Array  #: (m,) position in the run
    time: Array  #: (m,) s
    feed: Array  #: (m,) m/s
    payload: Array  #: (m,) N
    direction: Array  #: (m,) +1 or -1
    temperature: Mapping[str, Array]  #: {body: (m,)} K
    tension: Array  #: (m, nq) tension of the cable that each joint pays out, N
    max_payload: float  #: largest payload of the session, N; 0 where unknown
    max_feed: float  #: largest feed of the session, m/s; 0 where unknown
    #: (k,) sorted times of all readings of the session, s; empty where unknown
    session_times: Array
    #: (m,) elapsed share of the session, 0 to 1: by the clock, or by the order of
    #: readings where not all have a time
    session_progress: Array
    #: {body: temperature at the session's first reading, K}
    start_temperature: Mapping[str, float]
    channels: tuple[str, ...]  #: names of the instrument's channels
    settings: Mapping[str, float]  #: settings of the set-up by name
    joint_range: Array  #: (2, nq) least and largest value of each joint in the session
    home: Array  #: (nx,) pose coordinates of the home pose
    session_span: tuple[float, float]  #: first and last time over all set-ups, s

    @functools.cached_property
    def joints_per_displacement(self) -> Array:
        """Joint changes (m, nq, 3) that displace the tool by 1 m along each base axis.

        They do not turn the tool, if the machine can avoid it. They are zero along an
        axis in which the joints hardly move the tool.
        """
        motion = self.twist[:, :3]
        if len(self.limbs) >= 6:
            size = np.repeat([1.0, self.machine.lever], 3)[:, None]
            motion = self.twist * size
        inverse = np.linalg.pinv(motion, rcond=DIRECTION_CUTOFF)
        return np.asarray(inverse[:, :, :3])

    def displacing_joints(self, axis: int, amount: Array) -> dict[int, Array]:
        """Joint changes {joint: (m,)} for a tool displacement (m,), m, along a base axis."""
        change = self.joints_per_displacement[:, :, axis] * amount[:, None]
        return {i: change[:, i] for i in self.limbs}

    @functools.cached_property
    def joints_per_extension(self) -> Array:
        """Joint changes (m, nq) that displace the tool by 1 m along its own axis."""
        per_displacement = self.joints_per_displacement
        return np.asarray(np.einsum("mqk,mk->mq", per_displacement, self.axis))

    @property
    def travel(self) -> Array:
        """Places (m, nq) of the joints in their travels of the session, from -1 to 1."""
        low, high = self.joint_range
        share = 2.0 * (self.joints - low) / np.maximum(high - low, 1e-12)
        return np.asarray(share - 1.0)

    @property
    def limbs(self) -> range:
        """Indices of the joints, from 0."""
        return range(self.joints.shape[1])

    def __len__(self) -> int:
        return len(self.pose)

    def take(self, rows: Index) -> "State":
        """The state at some of its poses, by number, in this order."""
        whole = ("session_times", "joint_range", "home")
        values: dict[str, Any] = {
            f.name: getattr(self, f.name)
            for f in dataclasses.fields(self)
            if f.name not in whole
        }
        arrays = {n: v[rows] for n, v in values.items() if isinstance(v, np.ndarray)}
        temperature = {body: v[rows] for body, v in self.temperature.items()}
        changes: dict[str, Any] = {**arrays, "temperature": temperature}
        return dataclasses.replace(self, **changes)


@dataclasses.dataclass(frozen=True, slots=True)
class Column:
    """One coefficient of an effect: what it changes at each of m poses, per unit.

    name        of the coefficient, such as `leg 1`; set-ups share the columns of one
                name, so a coefficient of one set-up has the set-up in its name
    scale       prior standard deviation of the coefficient
    label       block it belongs to, such as `leg 1`; "" for all. A coefficient that
                set-ups share belongs to none of them
    joints      {joint index: (m,)} change of the joint's true position, m or rad
    parameters  {name: (m,)} change of a geometric parameter of the machine, SI
    nuisances   {name: (m,)} change of an unknown of the set-up, such as `cup_x`, SI
    reading     {channel, or "*" for all: (m,)} change of the reading itself, SI
    shape       whether it only lets the form depart from the textbook's

    Names that a machine or set-up does not have are ignored. A column that changes
    nothing is dropped.

    >>> import numpy as np
    >>> from oed import Column
    >>> slope = Column("leg 1", scale=50e-6, joints={0: np.array([0.1, 0.2])})
    >>> slope.scale * slope.joints[0]
    array([5.e-06, 1.e-05])
    """

    name: str
    scale: float
    label: str = ""
    joints: Mapping[int, Array] = dataclasses.field(default_factory=dict)
    parameters: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    nuisances: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    reading: Mapping[str, Array] = dataclasses.field(default_factory=dict)
    shape: bool = False

    def misfit(self, state: State) -> str:
        """What of it is no change of a state's machine at its m poses; empty for none."""
        limbs = len(state.limbs)
        for index in self.joints:
            if index not in state.limbs:
                return f"joint index {index}, but the machine has 0 to {limbs - 1}"
        for name in ("joints", "parameters", "nuisances", "reading"):
            for key, change in getattr(self, name).items():
                if np.shape(change) != (len(state),):
                    return (
                        f"{name}[{key!r}] has shape {np.shape(change)}, and not a number"
                        f" for each of {len(state)} poses"
                    )
                if not np.isfinite(change).all():
                    return f"{name}[{key!r}] is not finite at all poses"
        return ""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """An unmodelled effect.

    name, source, about  for the catalogue; `source` is standard or publication
    columns              function of a State and the constants by name: the effect's
                         columns in one set-up
    needs                covariates without which it cannot be tested: `time`, `feed`,
                         `payload`, `tension`, `time or temp_leg`; `direction: both`, `payload: 2`
                         and `feed: 2` need as many different values
    constants            nonlinear constants, each with the values to marginalise over
    of_drive             the constant that a stated drive fixes: turns of its wheels a turn
                         of the joint, or the lead of its screw; "" for none
    proportional         {constant: expected size, m, at which its values hold}, of
                         lengths in proportion to the effect's size
    remedy               what a machine builder does about it
    exposed_by           reading that separates it from its rivals
    check                what to check where it is far larger than expected
    nature               what it has in common with others, in words: how a class of many
                         effects is named
    family               effects of one family differ by the form alone, which real ones
                         depart from; "" for none
    instruments          instruments of whose set-ups it is an error; empty where it is none
                         of a set-up's reference or instrument
    unfit(machine)       why it cannot occur on a machine, in words; None where it can
    common_to_limbs      whether limbs of one design, or set-ups, usually share coefficients
    units                {pattern of coefficients' names: SI unit}, the first that suits;
                         m where none does
    textbook_share       prior probability of its textbook form, where it has columns
                         that adapt the shape
    incident             whether it is an event (a knocked mount) that a diagnosis looks for
                         and no plan counts on

    >>> from pkm_models.effects.backlash import effect
    >>> effect.needs
    ('direction: both',)
    >>> effect.varies_with_time
    False
    """

    name: str
    source: str
    about: str
    columns: Callable[..., Iterable[Column]]
    needs: tuple[str, ...] = ()
    constants: Mapping[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    of_drive: str = ""
    proportional: Mapping[str, float] = dataclasses.field(default_factory=dict)
    remedy: str = ""
    exposed_by: str = ""
    check: str = ""
    nature: str = ""
    family: str = ""
    instruments: tuple[str, ...] = ()
    unfit: Callable[[Machine], str | None] = lambda machine: None
    common_to_limbs: bool = False
    textbook_share: float = 0.5
    incident: bool = False
    units: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        state_fields = {field.name for field in dataclasses.fields(State)}
        for need in self.needs:
            for name in (part.split(":")[0].strip() for part in need.split(" or ")):
                if name not in state_fields and not name.startswith("temp_"):
                    raise ValueError(f"needs {need!r}: no reading records {name}")

    @property
    def varies_with_time(self) -> bool:
        """Whether it is a function of the time or of a temperature."""
        options = [part.strip() for need in self.needs for part in need.split(" or ")]
        return any(part == "time" or part.startswith("temp_") for part in options)

    def is_offered(self, instruments: Collection[str]) -> bool:
        """Whether readings by these instruments can have it."""
        return not self.instruments or any(n in self.instruments for n in instruments)

    def size_limit(self, name: str, scale: float) -> float:
        """A coefficient in expected sizes, `scale` in SI, that no machine exceeds."""
        return min(
            IMPOSSIBLE_SIZES, IMPOSSIBLE_SI.get(self.unit(name), math.inf) / scale
        )

    def unit(self, coefficient: str) -> str:
        """SI unit of a coefficient by its name."""
        for pattern, unit in self.units.items():
            if fnmatch.fnmatchcase(coefficient, pattern):
                return unit
        return "m"

    def constant_grid(self) -> list[dict[str, float]]:
        """Every combination of the constants' values, by name."""
        combinations = itertools.product(*self.constants.values())
        return [
            dict(zip(self.constants, values, strict=True)) for values in combinations
        ]

    def coefficient_units(self) -> tuple[str, ...]:
        """SI units that coefficients may have."""
        units = list(self.units.values())
        if "*" not in self.units:
            units.append("m")
        return tuple(dict.fromkeys(units))

    def with_constants(self, constants: Mapping[str, float]) -> "Effect":
        """The effect with these constants at one value each."""
        values = {name: (value,) for name, value in constants.items()}
        return dataclasses.replace(self, constants={**self.constants, **values})

    def with_expected_size(self, unit: str, size: float) -> "Effect":
        """The effect with its largest coefficient of an SI unit of prior sd `size`, SI;
        the others, the form's departures, and constants that are lengths keep their
        ratio.
        """
        columns = functools.partial(_sized_columns, self, unit, size)
        if unit != "m":
            return dataclasses.replace(self, columns=columns)
        constants = {
            name: tuple(value * size / self.proportional[name] for value in values)
            if name in self.proportional
            else values
            for name, values in self.constants.items()
        }
        proportional = dict.fromkeys(self.proportional, size)
        return dataclasses.replace(
            self, columns=columns, constants=constants, proportional=proportional
        )


def _sized_columns(
    effect: Effect, unit: str, size: float, state: State, **constants: float
) -> Iterable[Column]:
    columns = list(effect.columns(state, **constants))
    of_unit = [c for c in columns if effect.unit(c.name) == unit]
    largest = max((c.scale for c in of_unit if not c.shape), default=size)
    for column in columns:
        if effect.unit(column.name) == unit:
            scale = column.scale * size / largest
            yield dataclasses.replace(column, scale=scale)
        else:
            yield column
