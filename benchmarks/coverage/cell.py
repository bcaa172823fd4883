"""Figures of one cell of the table: one configuration under one law of the noise."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy import stats

#: what the intervals promise, and the limits of the targets
PROMISE = 0.95
MEAN_LIMITS, NEES_LIMITS = (0.93, 0.97), (0.9, 1.15)
#: of the band of the worst share, and of the intervals of means
WORST_BAND, MEAN_INTERVAL = 0.999, 0.95


@dataclasses.dataclass(frozen=True)
class Share:
    """Share of intervals that hold the truth.

    mean    over machines and quantities
    half    half its 95 % interval; machines are independent, quantities are not
    worst   of one quantity over machines
    lowest  lower end of the 99.9 % band of a share that is truly 0.95
    """

    mean: float
    half: float
    worst: float
    lowest: float

    @property
    def mean_holds(self) -> bool:
        """Whether the mean is within its limits."""
        return MEAN_LIMITS[0] <= self.mean <= MEAN_LIMITS[1]

    @property
    def mean_may_hold(self) -> bool:
        """Whether the mean's interval reaches into its limits."""
        return _reaches(self.mean, self.half, MEAN_LIMITS)

    @property
    def worst_holds(self) -> bool:
        """Whether the worst share is within its band."""
        return self.worst >= self.lowest


@dataclasses.dataclass(frozen=True)
class Cell:
    """Figures of the machines of one cell.

    machines      how many
    combinations  of identifiable parameters
    bands         of pose components over the workspace
    nees          mean squared error over all combinations, over their number
    nees_half     half its 95 % interval
    """

    machines: int
    combinations: Share
    bands: Share
    nees: float
    nees_half: float

    @property
    def nees_holds(self) -> bool:
        """Whether the joint error is within its limits."""
        return NEES_LIMITS[0] <= self.nees <= NEES_LIMITS[1]

    @property
    def nees_may_hold(self) -> bool:
        """Whether the joint error's interval reaches into its limits."""
        return _reaches(self.nees, self.nees_half, NEES_LIMITS)


def _reaches(value: float, half: float, limits: tuple[float, float]) -> bool:
    return value - half <= limits[1] and value + half >= limits[0]


def summarise(results: Sequence[dict[str, Any]]) -> Cell:
    """The figures of machines' results."""
    nees = np.array([r["nees"] for r in results])
    return Cell(
        machines=len(results),
        combinations=_share([r["combinations"] for r in results]),
        bands=_share([r["bands"] for r in results]),
        nees=float(nees.mean()),
        nees_half=_half(nees),
    )


def _share(texts: Sequence[str]) -> Share:
    inside = np.array([[mark == "1" for mark in text] for text in texts])
    count = len(inside)
    tail = 0.5 * (1.0 - WORST_BAND)
    return Share(
        mean=float(inside.mean()),
        half=_half(inside.mean(axis=1)),
        worst=float(inside.mean(axis=0).min()),
        lowest=float(stats.binom.ppf(tail, count, PROMISE)) / count,
    )


def _half(values: np.ndarray) -> float:
    """Half the 95 % interval of the mean of independent values."""
    if len(values) < 2:
        return float("inf")
    quantile = stats.t.ppf(0.5 + 0.5 * MEAN_INTERVAL, len(values) - 1)
    return float(quantile * values.std(ddof=1) / np.sqrt(len(values)))
