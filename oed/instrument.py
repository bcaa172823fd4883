"""What an instrument is: what it reads from one or two poses, what of its set-up is
unknown, its noise and cost.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Literal

from oed.machine import Expr, Machine, Parameter, Values


@dataclasses.dataclass(frozen=True, slots=True)
class Channel:
    """One number of a reading: its column stem (`length`), SI unit and default noise
    sigma (SI).

    `shared` is the standard deviation of an error common to all readings of a run, in
    units of sigma: 1 where each is told against one reference reading of the same
    instrument.
    """

    name: str
    unit: str
    sigma: float
    shared: float = 0.0


@dataclasses.dataclass(frozen=True, slots=True)
class Setting:
    """A known number of the set-up (bar length, cup position), SI, with its default
    (None: must be given).
    """

    name: str
    unit: str
    default: float | None
    about: str = ""


@dataclasses.dataclass(frozen=True, slots=True)
class Cost:
    """Time in seconds to mount the set-up and to take one reading."""

    setup: float
    reading: float


@dataclasses.dataclass(frozen=True, slots=True)
class Frame:
    """What an instrument can see of the machine: the tool's orientation (3 x 3) and
    tool point (3,), base frame.

    misfit  root mean square, with a sign, by which the closure's equations miss each
            other; None where the machine is not redundant by one equation
    """

    rotation: Expr
    point: Expr
    closure_misfit: Expr | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Instrument:
    """A measuring instrument.

    observe(frames, s, k)  the reading's channels from the frames it needs, set-up
                           nuisances s and settings k (both by name). `frames[0]` is the
                           pose read; where `reference` is set, `frames[1]` is the
                           set-up's teach pose ("teach") or the first pose of the run
                           ("run").
    nuisances              unknowns of a set-up with their tolerances: they are
                           identified with the machine
    sources(frames, s, k)  slopes (channels x sources) from independent errors inside
                           the instrument, each in units of its own standard deviation;
                           None: the channels' noise is independent. With sources, a
                           set-up's sigma scales them: channel c's sigma over the
                           default is the factor of row c
    unfit(machine)         why it cannot read a machine, in words; None, as by default,
                           where it can
    holds(k)               value (SI) that the first channel has by design, if the poses
                           are chosen to keep it (a ball bar's length); None otherwise
    """

    name: str
    source: str
    channels: tuple[Channel, ...]
    settings: tuple[Setting, ...]
    nuisances: tuple[Parameter, ...]
    cost: Cost
    observe: Callable[[Sequence[Frame], Values, Values], Sequence[Expr]]
    reference: Literal["teach", "run"] | None = None
    sources: Callable[[Sequence[Frame], Values, Values], Expr] | None = None
    fixed_reading: Callable[[Mapping[str, float]], float] | None = None
    unfit: Callable[[Machine], str | None] = lambda machine: None
    about: str = ""

    @property
    def arity(self) -> int:
        """Poses that one reading depends on."""
        return 1 if self.reference is None else 2


@dataclasses.dataclass(frozen=True, slots=True)
class Protocol:
    """How often each planned reading is taken: `repeats` times one way, and as often
    back if `both_directions`.

    With `average` their mean is the reading, and its noise is that of independent
    passes; without, all are kept.
    """

    repeats: int = 1
    both_directions: bool = False
    average: bool = True

    @property
    def pass_names(self) -> list[str]:
        """Names of the passes of a run, in order."""
        ways = ("forward", "backward") if self.both_directions else ("forward",)
        return [f"{way} {k + 1}" for way in ways for k in range(self.repeats)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """An instrument as mounted: its settings (SI), the tool in use, the teach pose,
    tolerances of its unknowns.

    tool       tool point (3,) in the platform frame relative to the reference tool's, m
    teach      command (n_dof,) of the pose at which the set-up was taught, SI; only for
               reference "teach"
    nuisances  the instrument's nuisances with this set-up's tolerances
    sigma      noise (SI) of each channel, of the mean where the protocol averages
    protocol   how often each planned reading is taken
    """

    name: str
    instrument: Instrument
    settings: Mapping[str, float]
    nuisances: tuple[Parameter, ...]
    sigma: tuple[float, ...]
    tool: tuple[float, float, float] = (0.0, 0.0, 0.0)
    teach: tuple[float, ...] | None = None
    protocol: Protocol = Protocol()

    def __post_init__(self) -> None:
        known = {s.name for s in self.instrument.settings}
        if set(self.settings) != known:
            raise ValueError(
                f"set-up {self.name}: settings {sorted(self.settings)} are not"
                f" {sorted(known)}"
            )
        if (self.teach is None) == (self.instrument.reference == "teach"):
            raise ValueError(
                f"set-up {self.name}: a teach pose goes with instruments that are"
                " taught, and only with them"
            )
        if len(self.sigma) != len(self.instrument.channels):
            raise ValueError(
                f"set-up {self.name}: one sigma for each of"
                f" {[c.name for c in self.instrument.channels]}"
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
    """A set-up with the instrument's defaults where nothing is said; raises ValueError
    for unknown names (SI).
    """
    given = dict(settings)
    values: dict[str, float] = {}
    for s in instrument.settings:
        value = given.pop(s.name, s.default)
        if value is None:
            raise ValueError(
                f"set-up {name}: {instrument.name} needs {s.name} ({s.unit}): {s.about}"
            )
        values[s.name] = float(value)
    if given:
        raise ValueError(
            f"set-up {name}: {instrument.name} has no setting {sorted(given)}; it has"
            f" {sorted(values)}"
        )
    wanted = dict(tolerances or {})
    nuisances = tuple(
        dataclasses.replace(n, tolerance=float(wanted.pop(n.name, n.tolerance)))
        for n in instrument.nuisances
    )
    if wanted:
        raise ValueError(
            f"set-up {name}: {instrument.name} has no unknown {sorted(wanted)}"
        )
    return Setup(
        name=name,
        instrument=instrument,
        settings=values,
        nuisances=nuisances,
        sigma=(
            tuple(sigma)
            if sigma is not None
            else tuple(c.sigma for c in instrument.channels)
        ),
        tool=tool,
        teach=None if teach is None else tuple(float(v) for v in teach),
    )
