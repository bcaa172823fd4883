"""Readings files as a user has them: tables in mm and deg, with noise of four laws.

White noise, AR(1), Student t with four degrees of freedom, run offsets of twice the noise;
a fifth, a tenth of the noise, is of readings that were smoothed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from oed.measurement.measurement import Measurement

Array = NDArray[np.float64]
MM, UM, DEG, ARCSEC = 1e-3, 1e-6, np.pi / 180.0, np.pi / 648000.0
LAWS = ("white", "ar1", "t4", "run offsets")
#: decimals of a file: 0.1 um, and a tenth of an arcsec
DIGITS = {"mm": 4, "deg": 5}


@dataclasses.dataclass(frozen=True)
class VirtualMachine:
    """A machine with its set-ups and its readings.

    measurement  what the checks know of it
    readings     table of a drawn machine with a noise law, from a generator
    """

    measurement: Callable[[], Measurement]
    readings: Callable[[np.random.Generator, str], pd.DataFrame]


def noise(rng: np.random.Generator, law: str, run: Array) -> Array:
    """Errors (n,) of unit size, by run (n,)."""
    white = rng.standard_normal(len(run))
    if law == "t4":
        return np.asarray(rng.standard_t(4, len(run)) / np.sqrt(2.0))
    if law == "run offsets":
        return white + offsets(rng, run)
    if law == "smoothed":
        return 0.1 * white
    if law == "ar1":
        errors = white.copy()
        for k in range(1, len(run)):
            if run[k] == run[k - 1]:
                errors[k] = 0.7 * errors[k - 1] + np.sqrt(1.0 - 0.7**2) * white[k]
        return errors
    return white


def offsets(rng: np.random.Generator, run: Array) -> Array:
    """Offsets (n,) of twice the noise, one of each run (n,)."""
    _, number = np.unique(run, return_inverse=True)
    return np.asarray(2.0 * rng.standard_normal(number.max() + 1)[number])


def table(setup: str, run: list[str], columns: dict[str, Array]) -> pd.DataFrame:
    """Rows of one set-up, rounded as an instrument writes them."""
    frame = pd.DataFrame({"setup": setup, "run": run})
    frame["order"] = frame.groupby("run", sort=False).cumcount() + 1
    for name, values in columns.items():
        frame[name] = np.round(values, DIGITS[name.rpartition("_")[2]])
    return frame
