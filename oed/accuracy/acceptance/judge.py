"""Judges measured errors by an acceptance plan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from oed.base.arrays import Array
from oed.result.acceptance import PromiseRecord, VerdictRecord


def judge(
    errors: Mapping[str, Array], demands: Mapping[str, PromiseRecord]
) -> dict[str, VerdictRecord]:
    """Verdicts by component, from the errors (n,) measured at the planned poses.

    Errors are in the unit of their demand.
    """
    return {name: _verdict(errors[name], demand) for name, demand in demands.items()}


def _verdict(errors: Array, demand: PromiseRecord) -> VerdictRecord:
    rms = float(np.sqrt(np.mean(errors**2)))
    return VerdictRecord(
        rms=rms,
        max=float(np.abs(errors).max()),
        limit=demand.limit,
        promised=demand.promised,
        unit=demand.unit,
        passed=rms <= demand.limit,
    )
