"""Noise of virtual readings, drawn without the toolkit's noise model.

All sizes are in the stated standard deviation of a reading's channel:

white     independent normal errors
t4        independent Student t errors of 4 degrees of freedom and unit variance
offsets   white, and each channel of each run off by a normal error of 2
ar1       a stationary first-order autoregression of 0.9 along each channel of a run
all       half the variance by ar1, half by t4, and offsets of 2
outliers  white, and each reading off by 5 to 50 in one case of fifty
drift     white, and a straight line from 0 to 4 through the session, of either sign
walk      white, and a random walk through the session that ends with a deviation of 4
sawtooth  white, and a saw-tooth of 4 from peak to peak, as of a thermostat, of three to
          eight periods a session

Where an instrument states an error that all readings of a run share (a common reference
reading), a normal one comes on top, as it states.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from benchmarks.harness.noise import autoregression

OFFSET, DECAY, OUTLIERS, FAR = 2.0, 0.9, 0.02, (5.0, 50.0)
#: size of what moves through a session, and periods of a saw-tooth
COURSE, PERIODS = 4.0, (3.0, 8.0)
LAWS = ("white", "t4", "offsets", "ar1", "all", "outliers", "drift", "walk", "sawtooth")


@dataclasses.dataclass(frozen=True)
class Layout:
    """N readings: which belong together, and their stated noise."""

    #: (N,) one channel of one run; readings of a chain follow each other
    chain: np.ndarray
    sigma: np.ndarray  #: (N,) stated standard deviation, SI
    #: (N,) standard deviation, SI, of the stated error common to a chain
    shared: np.ndarray


def draw(law: str, layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """Errors (N,), SI, of one session under a law of LAWS."""
    size = len(layout.chain)
    common = layout.shared * _by_chain(layout, rng)
    if law == "ar1":
        return layout.sigma * _autoregression(layout, rng) + common
    if law == "t4":
        return layout.sigma * _student(size, rng) + common
    if law == "all":
        single = _autoregression(layout, rng) + _student(size, rng)
        offset = OFFSET * _by_chain(layout, rng)
        return layout.sigma * (np.sqrt(0.5) * single + offset) + common
    error = rng.standard_normal(size)
    if law == "offsets":
        error += OFFSET * _by_chain(layout, rng)
    elif law == "outliers":
        far = np.exp(rng.uniform(*np.log(FAR), size)) * rng.choice([-1.0, 1.0], size)
        error += np.where(rng.uniform(size=size) < OUTLIERS, far, 0.0)
    elif law in ("drift", "walk", "sawtooth"):
        error += _course(law, size, rng)
    elif law != "white":
        raise ValueError(f"law {law!r} is none of {LAWS}")
    return layout.sigma * error + common


def _course(law: str, size: int, rng: np.random.Generator) -> np.ndarray:
    """What all readings (N,) share through the session, in the order they are taken."""
    time = np.arange(size) / size
    if law == "drift":
        return COURSE * rng.choice([-1.0, 1.0]) * time
    if law == "walk":
        return COURSE * np.cumsum(rng.standard_normal(size)) / np.sqrt(size)
    phase = rng.uniform(*PERIODS) * time + rng.uniform()
    return COURSE * (phase % 1.0 - 0.5)


def _by_chain(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """A standard normal error of each chain, at its readings (N,)."""
    return rng.standard_normal(layout.chain.max() + 1)[layout.chain]


def _student(size: int, rng: np.random.Generator) -> np.ndarray:
    return rng.standard_t(4.0, size) / np.sqrt(2.0)


def _autoregression(layout: Layout, rng: np.random.Generator) -> np.ndarray:
    """Stationary errors (N,) of unit variance."""
    white = rng.standard_normal(len(layout.chain))
    error = np.empty_like(white)
    for number in range(layout.chain.max() + 1):
        members = layout.chain == number
        error[members] = autoregression(white[members], DECAY)
    return error
