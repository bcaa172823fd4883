"""Covariates that no workshop has: temperatures in kelvin, loads of a thousand tons."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base.arrays import Mask
from oed.checks.findings import CheckFinding, Severity
from oed.checks.session import SessionReadings
from oed.dataset.columns import (
    FEED_UNIT,
    TEMPERATURE,
    TENSION,
    column_name,
    covariate_unit,
    is_covariate,
    parse_column,
)

#: least and largest value, SI, that machines work at, by the beginning of the name: a
#: body's temperature (C, or a difference), a speed (300 m/min), a load of 10 t, a tension
RANGES = {
    TEMPERATURE: (-60.0, 150.0),
    "feed": (0.0, 5.0),
    "payload": (0.0, 1e5),
    TENSION: (0.0, 1e6),
}
#: 0 C in kelvin, and -60 C
KELVIN, COLD = 273.15, 213.15
#: how much smaller a fine unit than that of the column may be
FINE = 1e3
#: rows that a sentence names
NAMED = 6


def doubtful_conditions(session: SessionReadings) -> list[CheckFinding]:
    """Covariates outside the range that machines work at, by column and row."""
    return list(_findings(session))


def _findings(session: SessionReadings) -> Iterator[CheckFinding]:
    frame = session.values.iloc[session.firsts]
    for stem in filter(is_covariate, frame.columns):
        limits = next((v for k, v in RANGES.items() if stem.startswith(k)), None)
        if limits is None:
            continue
        values = frame[stem].to_numpy(dtype=float)
        outside = np.isfinite(values) & ((values < limits[0]) | (values > limits[1]))
        if outside.any():
            yield _doubt(session, stem, outside)


def _doubt(session: SessionReadings, stem: str, outside: Mask) -> CheckFinding:
    lower, upper = next(v for k, v in RANGES.items() if stem.startswith(k))
    name = column_name(stem, covariate_unit(stem))
    factor = parse_column(name).factor
    rows = session.rows(np.flatnonzero(outside))
    values = session.values[stem].to_numpy(dtype=float)[session.firsts][outside]
    unit = FEED_UNIT if name.endswith(FEED_UNIT) else name.rpartition("_")[2]
    listed = ", ".join(str(row) for row in rows[:NAMED])
    more = ", ..." if len(rows) > NAMED else ""
    between = f"{values.min() / factor:.6g}"
    if np.ptp(values) > 0.0:
        between += f" to {values.max() / factor:.6g}"
    sentence = (
        f"{name} is {between} in {len(rows)} row{'s' if len(rows) > 1 else ''} (row"
        f"{'s' if len(rows) > 1 else ''} {listed}{more}), outside {lower / factor:.6g} to"
        f" {upper / factor:.6g} {unit}: {_cause(stem, values.min(), values.max())}."
    )
    return CheckFinding(Severity.ORDER, "condition", sentence, rows)


def _cause(stem: str, least: float, largest: float) -> str:
    upper = next(v for k, v in RANGES.items() if stem.startswith(k))[1]
    if stem.startswith(TEMPERATURE):
        if least >= COLD and largest <= KELVIN + upper:
            return f"kelvin, not Celsius? Subtract {KELVIN}"
        if least < -KELVIN:
            return "nothing is below absolute zero; leave the cell empty where it is unknown"
        return "a sensor's mark of no value? Leave the cell empty where it is unknown"
    if least < 0.0:
        return "it cannot be negative; correct the sign, or leave the cell empty"
    if largest <= FINE * upper:
        return "in a finer unit than that of the column?"
    return "correct it, or leave the cell empty where it is unknown"
