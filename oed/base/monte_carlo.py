"""Figures of drawn machines with the standard errors that their number leaves.

Another sample of machines has other quantiles and means of squares. A report prints no
more digits than the errors here allow.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from oed.base.arrays import Array


class Drawn(NamedTuple):
    """A figure of draws, and its standard error."""

    value: float
    error: float


def quantile(values: Array, share: float, worth: float | None = None) -> Drawn:
    """A quantile of independent values (m,).

    worth  number of independent values that they are worth; m by default

    The error is half the distance between the quantiles that lie one standard error of
    the share to either side: it needs no density.
    """
    count = len(values) if worth is None else worth
    return _quantile(values, share, np.sqrt(share * (1.0 - share) / count))


def pooled_quantile(values: Array, share: float, worth: float | None = None) -> Drawn:
    """A quantile of the values (m, n) of m machines together.

    Machines are independent, their values are not: what counts is how the share beyond
    the quantile differs between machines.
    """
    machines = len(values) if worth is None else worth
    level = np.quantile(values, share)
    beyond = (values > level).mean(axis=1)
    return _quantile(values, share, beyond.std() / np.sqrt(machines))


def root_mean_square(values: Array, worth: float | None = None) -> Drawn:
    """The root mean square of the values (m, n) of m machines together."""
    machines = len(values) if worth is None else worth
    squares = (values**2).mean(axis=1)
    size = float(np.sqrt(squares.mean()))
    error = squares.std() / np.sqrt(machines) / (2.0 * size) if size > 0.0 else 0.0
    return Drawn(size, float(error))


def _quantile(values: Array, share: float, step: float) -> Drawn:
    shares = np.clip([share - step, share, share + step], 0.0, 1.0)
    low, middle, high = np.quantile(values, shares)
    return Drawn(float(middle), float(0.5 * (high - low)))
