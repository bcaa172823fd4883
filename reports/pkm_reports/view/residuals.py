"""Which residuals of a fit belong to which reading of the drawing."""

from __future__ import annotations

import dataclasses

from oed.result import Drawing, StudyResult
from pkm_reports import text


@dataclasses.dataclass(frozen=True, slots=True)
class ReadingResiduals:
    """Residual of one channel of a reading, before and after the fit."""

    channel: str
    unit: str
    before: float
    after: float


def residuals_of_readings(
    result: StudyResult, drawing: Drawing
) -> list[list[ReadingResiduals]]:
    """For each tool point its channels' residuals; empty lists where they do not match.

    A set-up has one noise for each channel, so that their number is known.
    """
    estimate, count = result.estimate, len(drawing.tool_points)
    nothing: list[list[ReadingResiduals]] = [[] for _ in range(count)]
    channels_of = {setup.name: len(setup.sigma) for setup in result.setups}
    if estimate is None or not set(drawing.reading_of) <= set(channels_of):
        return nothing
    channels = [channels_of[name] for name in drawing.reading_of]
    if len(channels) != count or sum(channels) != len(estimate.residuals):
        return nothing
    entries = [
        ReadingResiduals(
            text.cleaned(channel),
            text.unit_symbol(estimate.units[channel]),
            round(before, 4),
            round(after, 4),
        )
        for channel, before, after in zip(
            estimate.channels,
            estimate.residuals_before,
            estimate.residuals,
            strict=True,
        )
    ]
    listed = iter(entries)
    return [[next(listed) for _ in range(n)] for n in channels]
