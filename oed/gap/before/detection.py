"""Types of what planned readings could find: detectability, rivals, classes."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

from oed.arrays import Array
from oed.gap.before.power import FALSE_ALARM, needed_lambda


@dataclasses.dataclass(frozen=True, slots=True)
class SharedSignature:
    """A combination of an effect's coefficients that a rival imitates.

    combination      {coefficient: share}, in prior standard deviations, the largest 1
    words            the same in words
    detectability    sqrt(lambda_k) at one prior standard deviation along it
    separation       sqrt(lambda_k|j) at one prior standard deviation along it
    angle            principal angle, deg
    """

    combination: Mapping[str, float]
    words: str
    detectability: float
    separation: float
    angle: float


@dataclasses.dataclass(frozen=True, slots=True)
class EffectRival:
    """How well the readings distinguish an effect from another.

    name          of the rival
    separation    sqrt(lambda_k|j) expected over the effect's prior, the rival at its
                  most absorbing constants
    angle         smallest principal angle, deg, of the textbook columns over directions
                  that can be seen
    shared        combinations that can be seen but not distinguished from the rival, or
                  that are the same whatever their size
    """

    name: str
    separation: float
    angle: float
    shared: tuple[SharedSignature, ...] = ()


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Detectability:
    """What the readings can find of one effect.

    Figures are means over the grid of its constants unless stated otherwise.

    effect           name of the effect
    columns          number of coefficients that change some reading
    detectability    sqrt(lambda_k) expected at the prior sizes: the root of the trace
    low, high        the same at the worst and at the best constants
    power            probability of finding it at that size, for one test with all its
                     columns
    signature        {channel: root mean square of its readings at the prior sizes, SI},
                     before calibration
    absorbed         share of that signature, in units of the noise, that calibration
                     absorbs
    least            {channel: smallest root mean square, SI, that is found}, in the most
                     visible form
    median           the same, median over the prior
    sizes            {coefficient: its least size when it acts alone, in its own unit},
                     inf where it cannot be seen
    rivals           ascending by separation
    not_testable     why the readings cannot test it; None where they can
    """

    effect: str
    columns: int = 0
    detectability: float = 0.0
    low: float = 0.0
    high: float = 0.0
    power: float = FALSE_ALARM
    signature: Mapping[str, float] = dataclasses.field(default_factory=dict)
    absorbed: float = 0.0
    least: Mapping[str, float] = dataclasses.field(default_factory=dict)
    median: Mapping[str, float] = dataclasses.field(default_factory=dict)
    sizes: Mapping[str, float] = dataclasses.field(default_factory=dict)
    rivals: tuple[EffectRival, ...] = ()
    not_testable: str | None = None

    @property
    def visible(self) -> bool:
        """Whether it is found with the wanted power at its prior size."""
        if self.not_testable is not None:
            return False
        return self.detectability**2 >= needed_lambda(self.columns)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detection:
    """What a plan could find, of all effects.

    effects       in the order given
    names         (K,) of those that can be tested
    separation    (K, K) sqrt(lambda_k|j) of row k after column j is absorbed;
                  sqrt(lambda_k) on the diagonal
    angles        (K, K) smallest principal angles, deg; 0 on the diagonal
    classes       groups of visible effects that are not all distinguishable
    absorbed      pairs (k, j): k is not distinguishable from j, though j may be from k
    exact         pairs of which some combinations are the same to these readings,
                  whatever their size
    """

    effects: tuple[Detectability, ...]
    names: tuple[str, ...]
    separation: Array
    angles: Array
    classes: tuple[tuple[str, ...], ...]
    absorbed: tuple[tuple[str, str], ...]
    exact: tuple[tuple[str, str], ...]

    def row(self, name: str) -> Detectability:
        """Detectability of one effect. Raises KeyError."""
        for row in self.effects:
            if row.effect == name:
                return row
        names = [row.effect for row in self.effects]
        raise KeyError(f"no effect {name!r}; there are {names}")

    @property
    def not_testable(self) -> dict[str, str]:
        """{effect: why the readings cannot test it}."""
        reasons = {row.effect: row.not_testable for row in self.effects}
        return {effect: why for effect, why in reasons.items() if why is not None}
