"""Covariates of planned readings under [gap.conditions]: time, direction, feed, load."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from pkm_studies.tables import ConditionsTable

if TYPE_CHECKING:
    import pandas as pd

#: how `Series.passes` ends the name of a run's pass
PASS_SUFFIX = re.compile(r", (forward|backward) (\d+)$")
#: seconds in a minute
MINUTE = units.factor("min")
#: m/s in a mm/min
FEED_MM_PER_MIN = units.factor("mm") / units.factor("min")
COLUMNS = ["time", "direction", "feed", "payload", "repeat"]


def planned_covariates(
    measurement: Measurement, series: Sequence[Series], table: ConditionsTable
) -> pd.DataFrame:
    """Covariates of planned readings, SI, one row a reading; unknown columns left out.

    Runs follow one another in the order given; each takes the next of several feeds
    and payloads.
    """
    import pandas as pd

    frames: list[pd.DataFrame] = []
    clock, number, mounted = table.start_min * MINUTE, 0, ""
    for s in series:
        setup = measurement.setups[s.setup]
        if s.setup != mounted:
            clock += _mounting_time(setup, table)
            mounted = s.setup
        step = _pose_time(setup, table)
        protocol = setup.protocol
        both_ways = protocol.both_directions and protocol.average
        frame = pd.DataFrame(np.full((len(s), len(COLUMNS)), np.nan), columns=COLUMNS)
        for run in dict.fromkeys(s.run):
            rows = np.flatnonzero(s.run == run)
            backward, repeat = _pass_of(str(run))
            way = -1.0 if backward else 1.0
            frame.loc[rows, "time"] = clock + step * np.arange(1, len(rows) + 1)
            frame.loc[rows, "direction"] = np.nan if both_ways else way
            frame.loc[rows, "feed"] = (
                _value_of_run(table.feed_mm_min, number) * FEED_MM_PER_MIN
            )
            frame.loc[rows, "payload"] = _value_of_run(table.payload, number)
            frame.loc[rows, "repeat"] = repeat
            clock += step * len(rows) + table.pause_s
            number += 1
        frames.append(frame)
    covariates = pd.concat(frames, ignore_index=True).dropna(axis=1, how="all")
    for body, warming in table.temperature.items():
        share = -np.expm1(-covariates["time"] / (warming.after_min * MINUTE))
        covariates[f"temp_{body}"] = warming.rise * share
    return covariates


def _mounting_time(setup: Setup, table: ConditionsTable) -> float:
    if table.setup_min is None:
        return setup.instrument.cost.setup
    return table.setup_min * MINUTE


def _pose_time(setup: Setup, table: ConditionsTable) -> float:
    """Time at one pose, s: all its passes, where their mean is the reading."""
    protocol = setup.protocol
    passes = len(protocol.pass_names) if protocol.average else 1
    return reading_time(setup, table) * passes


def reading_time(setup: Setup, table: ConditionsTable) -> float:
    """Time of one reading, s."""
    if table.reading_s is None:
        return setup.instrument.cost.reading
    return table.reading_s


def _pass_of(run: str) -> tuple[bool, float]:
    """Whether a run is a pass backward, and which repeat it is."""
    match = PASS_SUFFIX.search(run)
    if match is None:
        return False, 1.0
    return match.group(1) == "backward", float(match.group(2))


def _value_of_run(stated: float | list[float] | None, number: int) -> float:
    """The value for run `number`: one for all, or those of a list in turn, or NaN."""
    if stated is None:
        return np.nan
    return stated[number % len(stated)] if isinstance(stated, list) else stated
