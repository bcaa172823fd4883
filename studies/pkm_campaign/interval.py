"""The 95 % interval of a mean over independent cases."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import Array

#: standard deviations to either side of a 95 % interval
HALF_WIDTH = float(special.ndtri(0.975))


def mean_interval(values: Sequence[float] | Array) -> tuple[float, float]:
    """Ends of the interval, by the normal law; NaN from one value."""
    count = len(values)
    if count < 2:
        return math.nan, math.nan
    mean, half = np.mean(values), HALF_WIDTH * np.std(values, ddof=1) / np.sqrt(count)
    return float(mean - half), float(mean + half)
