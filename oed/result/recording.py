"""What else to record: the worth of covariates and choices that a plan leaves open."""

from __future__ import annotations

from oed.result.record import Record


class RecordedChoice(Record, frozen=True):
    """A covariate to record, or a choice that lets effects be told apart.

    gain      share by which the error falls: root mean square of the components, each in
              units of what the plan leaves without it
    readings  further readings like the plan's that would give the same without it; None
              where no number does
    """

    name: str  # column of the readings file, or name of a measurement
    words: str
    effects: list[str]  # that are functions of it
    accuracy: dict[str, float]
    gain: float
    readings: int | None


class RecordingSection(Record, frozen=True):
    """What the readings of a plan leave where nothing but poses is recorded, and what else.

    Accuracies are rms errors by component and fine unit (`z_um`) after compensation.
    """

    readings: int  # of the plan
    accuracy: dict[str, float]
    floor: dict[str, float]  # with any number of readings like these
    choices: list[RecordedChoice]  # the best first
