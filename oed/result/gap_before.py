"""What planned readings could find, before any is taken: the `gap_before` section of
result.json.

Detectability is sqrt(lambda), in units of the noise over all readings after calibration
has absorbed what it can. Sizes in readings are in the fine unit of their channel
(`units`); coefficients' sizes are SI. What is not known is null.
"""

from __future__ import annotations

from typing import Annotated

import msgspec

from oed.result.record import Record

#: two names
Pair = Annotated[list[str], msgspec.Meta(min_length=2, max_length=2)]


class SharedRecord(Record, frozen=True):
    """A combination of an effect's coefficients that a rival imitates.

    detectability    sqrt(lambda) where nothing else acts
    separation       sqrt(lambda) once the rival absorbs what it can
    angle_deg        principal angle between the combination and the rival
    """

    words: str
    combination: dict[str, float]
    detectability: float = msgspec.field(name="seen")
    separation: float = msgspec.field(name="apart")
    angle_deg: float


class RivalRecord(Record, frozen=True):
    """How well an effect can be distinguished from another: sqrt(lambda_k|j), smallest principal
    angle.
    """

    name: str
    separation: float = msgspec.field(name="apart")
    angle_deg: float
    shared: list[SharedRecord]


class DetectabilityRecord(Record, frozen=True):
    """What could be found of one effect.

    detectability  at its expected size, over the values of its constants from `low` to
                   `high`; `power`: chance of finding it at 1 % false alarm
    signature      rms of its readings at that size; `absorbed`: share of it that
                   calibration absorbs
    least, median  smallest rms that is found with 90 % power: in the form seen best,
                   and typically
    sizes          least size of each coefficient by itself
    """

    name: str
    about: str
    columns: int
    detectability: float
    low: float
    high: float
    power: float
    visible: bool
    signature: dict[str, float]
    absorbed: float
    least: dict[str, float | None]
    median: dict[str, float | None]
    sizes: dict[str, float | None]
    rivals: list[RivalRecord]
    not_testable: str | None


class DetectabilityTable(Record, frozen=True):
    """All effects over one plan of `readings` readings.

    names, apart, angles_deg   (K), (K x K): row after column is absorbed; detectability
                               on the diagonal
    classes    groups of visible effects that can not all be distinguished;  absorbed:
               pairs, the first not from the second
    exact      pairs of which some combinations are the same to these readings
    """

    readings: int
    effects: list[DetectabilityRecord]
    names: list[str]
    separation: list[list[float]] = msgspec.field(name="apart")
    angles_deg: list[list[float]]
    classes: list[list[str]]
    absorbed: list[Pair]
    exact: list[Pair]


class ChosenRun(Record, frozen=True):
    """A run to take, under its condition (SI)."""

    setup: str
    run: str
    condition: dict[str, float]
    seconds: float


class SeparationRecord(Record, frozen=True):
    """A combination of an effect's coefficients against a rival: sqrt(lambda) of the
    chosen runs, and of the readings planned without [gap.design] (null where they
    cannot test it).
    """

    effect: str
    rival: str
    words: str
    detectability: float = msgspec.field(name="seen")
    separation: float = msgspec.field(name="apart")
    before: float | None


class ChosenRuns(Record, frozen=True):
    """Runs chosen to tell effects apart, `kept` ones among them.

    apart, bound   least sqrt(lambda_k|j) over all pairs; no plan under the rules
                   exceeds the bound
    before         the same of the readings planned without [gap.design]
    efficiency     of the compound with D, against its bound;  proven: all plans were
                   tried
    volume         log det of the parameters' information, in tolerances
    """

    candidates: int
    retained: int = msgspec.field(name="kept")
    runs: list[ChosenRun]
    separation: float = msgspec.field(name="apart")
    bound: float
    before: float | None
    efficiency: float
    proven: bool
    share: float
    volume: float
    seconds: float
    separations: list[SeparationRecord] = msgspec.field(name="told")
    table: DetectabilityTable


class GapBeforeSection(Record, frozen=True):
    """What the planned readings could find, and the runs that [gap.design] chose."""

    table: DetectabilityTable
    units: dict[str, str]
    chosen: ChosenRuns | None
    words: list[str]
