"""Noise laws for tests of the diagnosis, by the standard deviations of their parts."""

from __future__ import annotations

from typing import Any

import numpy as np

from oed.noise.law import NoiseLaw
from oed.noise.process import Laws

#: channels that a law of tests is of, at most
CHANNELS = 9


def noise_law(
    run_sd: float = 0.0,
    ar1_sd: float = 0.0,
    ar1_length: float = 1.0,
    variance: float = 1.0,
    *,
    seat_sd: float = 0.0,
    ratios: tuple[float, ...] = (1.0,) * CHANNELS,
    **more: Any,
) -> NoiseLaw:
    """A law of these parts, `variance` that of single readings, by channel."""
    within = np.sqrt(variance + ar1_sd**2)
    law = Laws(
        scale=within * np.array([ratios]),
        carried=np.array([(ar1_sd / within) ** 2]),
        reach=np.array([ar1_length]),
        level=np.array([run_sd / within]),
        seat=np.array([seat_sd / within]),
    )
    return NoiseLaw(law, **more)


#: the stated noise where nothing but the scatter of single readings is stated
STATED_LAW = noise_law()
