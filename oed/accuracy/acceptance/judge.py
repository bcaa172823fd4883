"""Judges measured errors by an acceptance plan."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from oed.base.arrays import Array


@dataclasses.dataclass(frozen=True)
class ComponentVerdict:
    """The judgement of one pose component, SI.

    rms      of the measured errors
    largest  of their sizes
    limit    largest rms with which it passes
    passed   whether it does
    """

    rms: float
    largest: float
    limit: float
    passed: bool


def judge(
    errors: Mapping[str, Array], limits: Mapping[str, float]
) -> dict[str, ComponentVerdict]:
    """Verdicts by component, from the errors (n,) measured at the planned poses, SI."""
    verdicts = {}
    for name, limit in limits.items():
        values = errors[name]
        rms = float(np.sqrt(np.mean(values**2)))
        largest = float(np.abs(values).max())
        verdicts[name] = ComponentVerdict(rms, largest, limit, rms <= limit)
    return verdicts
