"""Acceptance plan and its judgement: `acceptance` and `verification` of result.json."""

from __future__ import annotations

from typing import Annotated

import msgspec

from oed.result.record import Judgement, Record


class PromiseRecord(Record, frozen=True):
    """What an acceptance test demands of one pose component, in `unit`.

    promised     rms error over the workspace; of what no drive corrects, with further
                 axes that take the known error back
    limit        largest rms of the measured errors that a machine at its promise has: it
                 fails beyond
    confirms     largest rms with which it meets its promise: a machine that misses stays
                 below with a probability of 5 %; null where the test cannot confirm
    power        probability that a machine which misses the promise is caught
    uncertainty  standard uncertainty of one measured error
    without      rms error over the workspace without further axes, where no drive
                 corrects the component
    """

    promised: float
    limit: float
    power: float
    uncertainty: float
    unit: str
    without: float | None = None
    confirms: float | None = None


class AcceptanceSection(Record, frozen=True):
    """Which poses confirm the promised accuracy.

    poses        commands by column, in the order of the plan
    components   {component: demand}
    reference    against which errors are stated: absolute, home or best_fit
    miss         factor on the promised rms of a machine that misses
    false_alarm  probability that a machine at its promise fails
    conditions   what the promise rests on
    further      {component: demand} of what no drive corrects; measured or not
    offsets      errors of these, known in advance, at each pose, in their units
    healthy      {component: rms} that the plan predicted for a healthy machine, with all
                 that is known corrected, in the components' units
    """

    poses: Annotated[list[dict[str, float]], msgspec.Meta(min_length=1)]
    components: dict[str, PromiseRecord]
    reference: str
    miss: float
    false_alarm: float
    conditions: list[str] = []
    further: dict[str, PromiseRecord] = {}
    offsets: list[dict[str, float]] = []
    healthy: dict[str, float] = {}


class VerdictRecord(Record, frozen=True):
    """The judgement of one pose component, in `unit`.

    Of what no drive corrects, rms and max are those with further axes, and `without`
    the rms error without them. `passed` holds where the verdict is pass; `probability` is
    that of a true rms error within the promise, at the measured poses.
    """

    rms: float
    max: float
    limit: float
    promised: float
    unit: str
    passed: bool
    without: float | None = None
    verdict: Judgement | None = None
    probability: float | None = None

    @property
    def judgement(self) -> Judgement:
        """The verdict; that of older versions knew pass and fail alone."""
        return self.verdict or ("pass" if self.passed else "fail")


class PositioningRecord(Record, frozen=True):
    """Figures in the manner of ISO 230-2, in `unit`; null where directions are missing.

    approaches  fewest of one direction at a target; the standard asks for five
    """

    targets: int
    approaches: int
    accuracy: float
    systematic: float
    repeatability: float
    mean: float | None
    reversal: float | None
    unit: str


class VerificationSection(Record, frozen=True):
    """Whether the measured errors confirm the promise.

    verdict  the worst of the components; null in results of older versions, whose tests
             could not end in `cannot tell`
    further  verdicts on what no drive corrects, as far as it was measured
    healthy  {component: rms} that the plan predicted for a healthy machine
    """

    passed: bool
    readings: int
    components: dict[str, VerdictRecord]
    positioning: dict[str, PositioningRecord] = {}
    further: dict[str, VerdictRecord] = {}
    healthy: dict[str, float] = {}
    verdict: Judgement | None = None

    @property
    def judgement(self) -> Judgement:
        """The verdict; that of older versions knew pass and fail alone."""
        return self.verdict or ("pass" if self.passed else "fail")
