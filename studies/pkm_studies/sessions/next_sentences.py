"""The advice at the machine, and its sentences: what is known, what to read, when to stop."""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.base import Array
from oed.measurement import Series
from oed.result import Judgement
from oed.text import format_number, format_probability
from oed.verdict import SURE_PROBABILITY, judge, overall
from pkm_studies import describe, quantities
from pkm_studies.sessions.next_effects import Outlook

if TYPE_CHECKING:
    from pkm_studies.sessions.next_reading import Adviser

#: readings that are thought ahead, to say how many reach what is wanted
MOST_AHEAD = 100
#: share of the error below which a further reading is not worth its time
LEAST_GAIN = 0.01
EVERY = "every wanted accuracy"
GEOMETRY_SO_FAR = (
    "Geometry alone so far: every wanted accuracy would be reached if no effect acted"
    " beside it. Evaluate the readings to learn whether one does (`oed identify`)."
)


@dataclasses.dataclass(frozen=True)
class Advice:
    """What a user at the machine needs to know after a reading.

    readings   number taken
    known      rms (K,) of each component over the workspace, SI, its unknown part
    after      the same after the next reading
    limits     wanted rms (K,), SI; NaN where none is
    within     probability (K,) that the rms error of this machine is within what is
               wanted; NaN where nothing is
    follows_plan  whether the limits are what the study's plan would reach
    more       readings that reach what is wanted, one after another; None where
               `MOST_AHEAD` do not, or nothing is wanted
    planned    readings of the study's plan, if it states a number
    candidate  number of the next reading among the candidates, which is in a row of a
               series; `expected` is what it should read, SI
    findings   what a check of the readings says
    outlook    all candidates, and what is known, from which the next one is chosen
    objections  why nothing should rest on the readings so far
    skipped    numbers of the candidates that are not advised
    """

    names: tuple[str, ...]
    readings: int
    known: Array
    after: Array
    limits: Array
    within: Array
    follows_plan: bool
    candidate: int
    series: Series
    row: int
    expected: Array
    more: int | None
    planned: int | None
    outlook: Outlook
    findings: tuple[str, ...] = ()
    objections: tuple[str, ...] = ()
    skipped: tuple[int, ...] = ()

    def judgement(self, component: int) -> Judgement:
        """The verdict on one component's wanted accuracy."""
        can_pass = self.outlook.holds_effects and not self.objections
        return judge(float(self.within[component]), can_pass=can_pass)

    @property
    def is_reached(self) -> bool:
        """Whether every wanted accuracy passes, or what the plan would reach is reached."""
        wanted = np.flatnonzero(np.isfinite(self.limits))
        if self.follows_plan:
            return not self.objections and bool((self.known <= self.limits).all())
        return overall(self.judgement(int(k)) for k in wanted) == "pass"

    @property
    def is_reached_by_geometry(self) -> bool:
        """Whether all would pass if nothing beside the geometry acted."""
        stated = self.within[np.isfinite(self.limits)]
        passes = bool(stated.size and (stated >= SURE_PROBABILITY).all())
        return passes and not self.outlook.holds_effects and not self.follows_plan

    @property
    def gain(self) -> float:
        """Share by which the next reading lowers the errors, on average."""
        positive = self.known > 0.0
        ratios = self.after[positive] / self.known[positive]
        return float(1.0 - np.exp(np.mean(np.log(ratios)))) if ratios.size else 0.0

    def stop_sentences(self) -> list[str]:
        """Whether to stop now, and how far it is."""
        if self.objections:
            return [
                f"Look for the cause before you go on: {'; '.join(self.objections)}."
            ]
        if self.is_reached:
            reached = "what the plan would reach" if self.follows_plan else EVERY
            return [f"Stop: {reached} is reached."]
        if self.is_reached_by_geometry:
            return [GEOMETRY_SO_FAR]
        if np.isfinite(self.limits).any():
            if self.more is None:
                return [f"{MOST_AHEAD} more readings would not reach what is wanted."]
            if self.more == 1:
                return ["About 1 more reading reaches what is wanted."]
            return [f"About {self.more} more readings reach what is wanted."]
        if self.planned is not None and self.readings >= self.planned:
            return [f"Stop: the {self.planned} readings of the plan are taken."]
        if self.readings and self.gain < LEAST_GAIN:
            return [
                f"Stop: a further reading gains less than {100 * LEAST_GAIN:.0f} %."
            ]
        if self.planned is None:
            return []
        return [f"The plan has {self.planned} readings."]


def advice_sentences(adviser: Adviser, advice: Advice) -> list[str]:
    """The advice in lines: what is known, the next reading, when to stop."""
    machine = adviser.base.resolved.machine
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    lines = [
        f"{advice.readings} readings taken. Rms error over the workspace, unknown part:"
    ]
    for k, name in enumerate(advice.names):
        unit = fine[name]
        now, then = (units.number(v[k], unit) for v in (advice.known, advice.after))
        sizes = f"{format_number(now):>8} {unit:<7} {format_number(then):>8}"
        line = f"  {name:<6} {sizes} after the next reading"
        if np.isfinite(advice.limits[k]):
            wanted = format_number(units.number(advice.limits[k], unit))
            line += f"   wanted {wanted}{_stated(advice, k)}"
        lines.append(line)
    skipped = skips(advice)
    return [
        *advice.findings,
        *lines,
        *advice.stop_sentences(),
        *skipped,
        *_next(adviser, advice),
    ]


def _stated(advice: Advice, component: int) -> str:
    """The verdict on a component; what a plan would reach has none."""
    if advice.follows_plan:
        return ""
    within = format_probability(float(advice.within[component]))
    return f": {advice.judgement(component)} (within it with {within})"


def skips(advice: Advice) -> list[str]:
    """How many readings are not advised, as their poses are skipped."""
    count = len(advice.skipped)
    if not count:
        return []
    phrase = "1 reading is" if count == 1 else f"{count} readings are"
    return [f"{phrase} not advised: the file's remarks skip the pose."]


def _next(adviser: Adviser, advice: Advice) -> list[str]:
    """Set-up, command, joints and the value that the reading should have."""
    machine = adviser.base.resolved.machine
    series, row = advice.series, advice.row
    command = describe.displayed_command(machine, series.reading_commands()[row])
    joints = describe.displayed_joints(machine, series.q[series.index[row, 0]])
    setup = adviser.base.resolved.setups[series.setup]
    expected = [
        f"{channel.name} {quantities.format_value(float(value), channel.unit)}"
        for channel, value in zip(
            setup.instrument.channels, advice.expected, strict=True
        )
    ]
    return [
        f"Next: {series.setup}, {_values(command)}; joints {_values(joints)}.",
        f"It should read {', '.join(expected)} and lowers the errors by"
        f" {100.0 * advice.gain:.2g} % on average.",
    ]


def _values(numbers: dict[str, float]) -> str:
    return ", ".join(f"{key} = {value:.7g}" for key, value in numbers.items())
