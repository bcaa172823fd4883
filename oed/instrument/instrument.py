"""What an instrument is: what it reads, its set-up's unknowns, its noise and cost."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from oed.base import Array, Index, Orientation
from oed.model import Expr, Machine, Parameter, Values
from oed.noise import NOTHING_STATED, NoiseStatement


@dataclasses.dataclass(frozen=True, slots=True)
class Channel:
    """One number of a reading.

    name    stem of its column, such as `length`
    unit    SI unit
    sigma   default standard deviation of its noise, SI
    shared  standard deviation, over sigma, of an error common to all readings of a run;
            1 where all are differences from one reference reading
    resolution  step of its display, SI; a set-up's sigma holds its variance, a twelfth
                of the square; 0 for fine ones
    about   what it reads: frame and sense, for tables
    alone   settings and unknowns of the set-up that this channel alone has: they go
            where it is not read

    >>> from oed import Channel
    >>> Channel("length", "m", sigma=1e-6, resolution=1e-7).unit
    'm'
    """

    name: str
    unit: str
    sigma: float
    shared: float = 0.0
    resolution: float = 0.0
    about: str = ""
    alone: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True, slots=True)
class Setting:
    """A known number of the set-up, such as bar length or cup position.

    name, unit  SI unit
    default     SI; None where a set-up must state it
    about       what it is, for tables

    >>> from oed import Setting
    >>> Setting("length", "m", default=0.3, about="of the bar").default
    0.3
    """

    name: str
    unit: str
    default: float | None
    about: str = ""


@dataclasses.dataclass(frozen=True, slots=True)
class Cost:
    """Time to mount the set-up, and to take one reading; s."""

    setup: float
    reading: float


class Frame:
    """What an instrument sees of the machine at one pose, in the base frame.

    rotation        orientation (3 x 3) of the tool
    point           tool point (3,), m
    closure_misfit  signed root mean square of the closure's equations; None unless the
                    machine is redundant by one equation
    closure_misfits  its components (k,) in the null space of the constraints, over the
                    square root of the number of equations m; None unless the machine is
                    redundant, by k equations
    null_space      (m, k) orthonormal directions of these components
    passive         angles and lengths of the machine's passive joints, by name
    """

    closure_misfit: Expr | None = None
    closure_misfits: Expr | None = None
    null_space: Expr | None = None
    passive: Values = MappingProxyType({})

    def __init__(self, rotation: Expr, point: Expr) -> None:
        """Of a platform alone; a subclass knows its machine's closure and joints."""
        self.rotation, self.point = rotation, point


@dataclasses.dataclass(frozen=True, slots=True)
class InnerReading:
    """A number that an instrument reads inside, and turns into its channels."""

    name: str  #: such as `range`
    unit: str  #: SI unit
    noise: str  #: the setting with the standard deviation of one such reading, SI
    #: which of the instrument's sources are errors of it, from 0
    sources: tuple[int, ...]
    zero: str  #: what its zero depends on, in words


#: channels of a reading from frames, nuisances and settings
Observe = Callable[[Sequence[Frame], Values, Values], Sequence[Expr]]
#: channels of a reading from the numbers that were read inside, and settings
FromInner = Callable[[Mapping[str, Array], Mapping[str, float]], Mapping[str, Array]]
#: names of the balls whose inner numbers an instrument reads one after the other
BALLS = "ab"
#: slopes of the channels over independent errors inside the instrument
Sources = Callable[[Sequence[Frame], Values, Values], Expr]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Instrument:
    """A measuring instrument.

    name, source, about    for the catalogue; `source` is data sheet or standard
    channels               numbers of one reading
    settings               known numbers of a set-up
    nuisances              unknowns of a set-up with their tolerances, identified
                           together with the machine
    cost                   time for set-up and reading
    observe(frames, s, k)  channels of a reading, from frames, nuisances s and settings
                           k, both by name. `frames[0]` is the pose read, `frames[1]`
                           the reference pose, if any
    reference              reference pose: "teach" (the set-up's teach pose), "run" (the
                           first pose of the run), or None
    sources(frames, s, k)  slopes (channels x sources) over independent errors inside
                           the instrument, each in its standard deviation. None: the
                           channels' noise is independent. A set-up's sigma scales row
                           c by sigma over the default of channel c
    inner                  numbers read inside the instrument, of which `sources` has the
                           errors: a zero that is wrong displaces all of them alike
    from_inner(raw, k)     values (n,) by channel of recorded inner numbers (n,), SI, by
                           `inner_columns`; NaN where one is missing. None: no file has
                           them
    fixed_reading(k)       value (SI) of the first channel that the poses are chosen to
                           keep, such as a ball bar's length; None where there is none
    renewed                names of the unknowns that each run seats anew, such as the
                           place of a magnetic cup
    unfit(machine)         why it cannot read a machine, in words; None where it can
    implied                reading (SI) where a file has no column for it, of an
                           instrument whose pose is the measurement: 0 of a closure, or of
                           a contact. No display shows these readings
    adapt(machine)         the instrument for a machine, where its channels or settings
                           depend on it
    orientation            how its angles make the orientation that it reads
    single                 whether a set-up reads one channel, which it has to name
    fixed_point            whether the tool point is the same at all poses
    held                   further unknowns of `s`, which are held and tested; `observe`
                           takes them as their nominal values where they are absent

    >>> from pkm_models.instruments.ball_bar import instrument
    >>> [channel.name for channel in instrument.channels]
    ['length']
    >>> [unknown.name for unknown in instrument.nuisances]
    ['cup_x', 'cup_y', 'cup_z']
    """

    name: str
    source: str
    channels: tuple[Channel, ...]
    settings: tuple[Setting, ...]
    nuisances: tuple[Parameter, ...]
    cost: Cost
    observe: Observe
    reference: Literal["teach", "run"] | None = None
    sources: Sources | None = None
    fixed_reading: Callable[[Mapping[str, float]], float] | None = None
    unfit: Callable[[Machine], str | None] = lambda machine: None
    about: str = ""
    renewed: tuple[str, ...] = ()
    implied: float | None = None
    adapt: "Callable[[Machine], Instrument] | None" = None
    orientation: Orientation | None = None
    inner: tuple[InnerReading, ...] = ()
    from_inner: FromInner | None = None
    single: bool = False
    fixed_point: bool = False
    held: tuple[Parameter, ...] = ()

    def for_machine(self, machine: Machine) -> "Instrument":
        """The instrument with the channels and settings that it has on a machine."""
        return self if self.adapt is None else self.adapt(machine)

    def take_channels(self, names: Sequence[str]) -> "Instrument":
        """The instrument that reads some of its channels alone, in its own order.

        Settings and unknowns of the other channels alone are left out. Raises
        ValueError for unknown names, for none, and for several of a `single` one.
        """
        available = [c.name for c in self.channels]
        unknown = [n for n in names if n not in available]
        if unknown or not names:
            raise ValueError(
                f"{self.name} has no channel {unknown}; it has {available}"
                if unknown
                else f"{self.name} must read one of {available} at least"
            )
        if self.single and len(names) > 1:
            raise ValueError(f"{self.name} reads one of {available} in a set-up")
        rows = [k for k, n in enumerate(available) if n in names]
        absent = {n for c in self.channels if c.name not in names for n in c.alone}
        return dataclasses.replace(
            self,
            channels=tuple(self.channels[k] for k in rows),
            settings=tuple(s for s in self.settings if s.name not in absent),
            nuisances=tuple(n for n in self.nuisances if n.name not in absent),
            observe=_entries(self.observe, rows),
            sources=None if self.sources is None else _rows(self.sources, rows),
            fixed_reading=self.fixed_reading if self.single or rows[0] == 0 else None,
        )

    @property
    def inner_columns(self) -> dict[str, str]:
        """SI unit of the recorded inner numbers by stem, such as `range_a` of ball A."""
        if self.from_inner is None:
            return {}
        return {
            f"{one.name}_{ball}": one.unit
            for one in self.inner
            for ball in BALLS[: len(one.sources)]
        }

    @property
    def arity(self) -> int:
        """Number of poses that one reading depends on."""
        return 1 if self.reference is None else 2

    def index_poses(self, run: NDArray[np.str_]) -> tuple[Index, NDArray[np.str_]]:
        """Poses (n, arity) that each reading sees, and its run (n,), from the poses'
        runs.

        A teach pose follows them; the first pose of a run may be its reference.
        """
        count = len(run)
        numbers = np.arange(count)
        if self.reference == "teach":
            index = np.column_stack([numbers, np.full(count, count)])
            return index.astype(np.intp), run
        if self.reference is None:
            return numbers[:, None].astype(np.intp), run
        first = {label: np.flatnonzero(run == label)[0] for label in np.unique(run)}
        reference = np.array([first[label] for label in run])
        read = reference != numbers
        index = np.column_stack([numbers, reference])[read]
        return index.astype(np.intp), run[read]


def _entries(observe: Observe, rows: Sequence[int]) -> Observe:
    def taken(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
        channels = observe(frames, s, k)
        return [channels[row] for row in rows]

    return taken


def _rows(sources: Sources, rows: Sequence[int]) -> Sources:
    def taken(frames: Sequence[Frame], s: Values, k: Values) -> Expr:
        return sources(frames, s, k)[list(rows), :]

    return taken


@dataclasses.dataclass(frozen=True, slots=True)
class Protocol:
    """How often each planned reading is taken."""

    repeats: int = 1  #: passes of a run in one direction
    both_directions: bool = False  #: as many passes again in the opposite direction
    #: the mean of all passes is the reading, with the noise of independent passes;
    #: otherwise every pass gives readings
    average: bool = True

    @property
    def pass_names(self) -> list[str]:
        """Names of the passes of a run, in order: `forward 1`, `backward 1`, ..."""
        names = [f"forward {k + 1}" for k in range(self.repeats)]
        if self.both_directions:
            names += [f"backward {k + 1}" for k in range(self.repeats)]
        return names


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """An instrument as mounted. Raises ValueError where its numbers do not fit."""

    name: str  #: unique in a study
    instrument: Instrument  #: the instrument
    settings: Mapping[str, float]  #: value of each setting, SI
    #: the instrument's nuisances with this set-up's tolerances
    nuisances: tuple[Parameter, ...]
    #: noise of each channel, SI; of the mean where the protocol averages
    sigma: tuple[float, ...]
    #: tool point (3,) in the platform frame, relative to the reference tool's, m
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    #: command (n_dof,) of the teach pose, SI; for reference "teach" only
    teach: tuple[float, ...] | None = None
    protocol: Protocol = Protocol()  #: how often each planned reading is taken
    #: what is stated of its noise beyond sigma
    statement: NoiseStatement = NOTHING_STATED
    #: what it shares its unknowns with: set-ups of one name see one frame
    station: str = ""

    @property
    def owner(self) -> str:
        """What stands before the names of its unknowns: its station, or itself."""
        return self.station or self.name

    def __post_init__(self) -> None:
        expected = {s.name for s in self.instrument.settings}
        if set(self.settings) != expected:
            raise ValueError(
                f"set-up {self.name}: settings {sorted(self.settings)} are not {sorted(expected)}"
            )
        if (self.teach is None) == (self.instrument.reference == "teach"):
            raise ValueError(
                f"set-up {self.name}: a teach pose goes with instruments that are"
                " taught, and only with them"
            )
        if len(self.sigma) != len(self.instrument.channels):
            channels = [c.name for c in self.instrument.channels]
            raise ValueError(f"set-up {self.name}: one sigma for each of {channels}")

    def check_fit(self, machine: Machine) -> None:
        """Raises ValueError where the instrument cannot read a machine."""
        reason = self.instrument.unfit(machine)
        if reason is not None:
            raise ValueError(
                f"set-up {self.name}: {self.instrument.name} cannot read {machine.name}: {reason}"
            )


def mount(
    instrument: Instrument,
    name: str,
    *,
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0),
    teach: Sequence[float] | None = None,
    sigma: Sequence[float] | None = None,
    tolerances: Mapping[str, float] | None = None,
    **settings: float,
) -> Setup:
    """Mount an instrument, with its defaults for all that is not given; SI.

    tolerances  prior standard deviations of nuisances, by name
    settings    values of settings, by name

    Raises ValueError for unknown names and missing settings.

    >>> from oed import mount
    >>> from pkm_models.instruments.pose_tracker import position
    >>> mount(position, "tracker", sigma=[5e-6, 5e-6, 5e-6]).sigma
    (5e-06, 5e-06, 5e-06)
    """
    if sigma is None:
        sigma = [c.sigma for c in instrument.channels]
    return Setup(
        name=name,
        instrument=instrument,
        settings=_settings(instrument, name, settings),
        nuisances=_nuisances(instrument, name, tolerances or {}),
        sigma=tuple(sigma),
        tool=tool,
        teach=None if teach is None else tuple(float(v) for v in teach),
    )


def _settings(
    instrument: Instrument, setup: str, values_by_name: Mapping[str, float]
) -> dict[str, float]:
    values: dict[str, float] = {}
    for setting in instrument.settings:
        value = values_by_name.get(setting.name, setting.default)
        if value is None:
            raise ValueError(
                f"set-up {setup}: {instrument.name} needs {setting.name}"
                f" ({setting.unit}): {setting.about}"
            )
        values[setting.name] = float(value)
    unknown = set(values_by_name) - set(values)
    if unknown:
        raise ValueError(
            f"set-up {setup}: {instrument.name} has no setting {sorted(unknown)}; it"
            f" has {sorted(values)}"
        )
    return values


def _nuisances(
    instrument: Instrument, setup: str, tolerances: Mapping[str, float]
) -> tuple[Parameter, ...]:
    unknown = set(tolerances) - {n.name for n in instrument.nuisances}
    if unknown:
        raise ValueError(
            f"set-up {setup}: {instrument.name} has no unknown {sorted(unknown)}"
        )
    nuisances = []
    for nuisance in instrument.nuisances:
        tolerance = float(tolerances.get(nuisance.name, nuisance.tolerance))
        nuisances.append(dataclasses.replace(nuisance, tolerance=tolerance))
    return tuple(nuisances)
