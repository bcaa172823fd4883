"""Covariates that no workshop has: temperatures in kelvin, loads of a thousand tons."""

from __future__ import annotations

import numpy as np

from oed.base import Array, Mask
from oed.checks.findings import CheckFinding, Severity, listing
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


def doubtful_conditions(session: SessionReadings) -> list[CheckFinding]:
    """Covariates outside the range that machines work at, by column and row."""
    findings = []
    frame = session.values.iloc[session.firsts]
    for stem in filter(is_covariate, frame.columns):
        limits = next((v for k, v in RANGES.items() if stem.startswith(k)), None)
        if limits is None:
            continue
        values = frame[stem].to_numpy(dtype=float)
        outside = np.isfinite(values) & ((values < limits[0]) | (values > limits[1]))
        if outside.any():
            findings.append(_doubt(session, stem, limits, values, outside))
    return findings


def _doubt(
    session: SessionReadings,
    stem: str,
    limits: tuple[float, float],
    values: Array,
    outside: Mask,
) -> CheckFinding:
    name = column_name(stem, covariate_unit(stem))
    factor = parse_column(name).factor
    rows = session.rows(np.flatnonzero(outside))
    ends = values[outside].min(), values[outside].max()
    unit = FEED_UNIT if name.endswith(FEED_UNIT) else name.rpartition("_")[2]
    between = f"{ends[0] / factor:.6g}"
    if ends[1] > ends[0]:
        between += f" to {ends[1] / factor:.6g}"
    lower, upper = (limit / factor for limit in limits)
    sentence = (
        f"{name} is {between} in {len(rows)} row{'s' if len(rows) > 1 else ''}"
        f" ({listing(rows)}), outside {lower:.6g} to {upper:.6g} {unit}:"
        f" {_cause(stem, *ends, limits[1])}."
    )
    return CheckFinding(Severity.ORDER, "condition", sentence, rows)


def _cause(stem: str, least: float, largest: float, upper: float) -> str:
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
