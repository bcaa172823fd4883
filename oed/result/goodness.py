"""Checks of the readings: the `goodness` section of result.json."""

from __future__ import annotations

from oed.result.record import Number, Record


class OutlierRecord(Record, frozen=True):
    """A reading that all others contradict; `row` is that of its file."""

    setup: str
    run: str
    order: int
    row: int
    pull: float


class MistakeRecord(Record, frozen=True):
    """A mistake that explains readings which do not fit, and how far it does."""

    what: str
    evidence: str


class GoodnessSection(Record, frozen=True):
    """Goodness of fit against the stated noise, and what a check of the readings says.

    bad_fit   whether nothing fitted to the readings can be trusted
    findings  sentences, the most harmful first
    """

    chi2: Number
    dof: Number
    p_low: Number
    p_high: Number
    bad_fit: bool = False
    outliers: list[OutlierRecord] = []
    mistakes: list[MistakeRecord] = []
    findings: list[str] = []
