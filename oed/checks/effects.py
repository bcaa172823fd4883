"""What may act on readings without a mistake: rivals of the usual mistakes.

No form of a cause is assumed: a polynomial in the order of the readings (a drift), one in
their poses (bending, play of joints, a lead error), and tolerances that are too narrow.
"""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np

from oed.base.arrays import Array
from oed.checks.session import SessionReadings
from oed.noise.structure import ReadingStructure

#: degree of a drift in the order of readings
DEGREE = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Rival:
    """An effect of unknown size.

    name       in words
    columns    (N, k) its forms, of unit size, in units of the stated noise; none where
               the parameters' own slopes count more than their tolerances say
    """

    name: str
    columns: Array | None

    @property
    def is_factor(self) -> bool:
        """Whether its size is a factor on the tolerances."""
        return self.columns is None

    def slopes(self, slopes: Array, size: float, structure: ReadingStructure) -> Array:
        """Slopes (N, r + k) with the effect at a size."""
        if self.columns is None:
            return size * slopes
        return np.hstack([slopes, size * self.columns])


def rivals(session: SessionReadings, slopes: Array) -> list[Rival]:
    """Drift, smooth error over the poses, and tolerances too narrow."""
    group = _groups(session)
    return [
        Rival("a drift through the session", _by_group(_drift(session), group)),
        Rival("a smooth error over the poses", _by_group(_smooth(session), group)),
        Rival("tolerances that are too narrow", None),
    ]


def _groups(session: SessionReadings) -> Array:
    """Number (N,) of the set-up and channel of each value."""
    frame = session.values
    number = frame.groupby(["setup", "channel"], sort=False).ngroup()
    return np.asarray(number.to_numpy())


def _by_group(forms: Array, group: Array) -> Array:
    """Forms (N, k), for each group its own."""
    parts = [np.where((group == g)[:, None], forms, 0.0) for g in np.unique(group)]
    columns = np.hstack(parts)
    return columns[:, columns.any(axis=0)]


def _drift(session: SessionReadings) -> Array:
    """Legendre polynomials (N, k) in the order of the readings."""
    order = session.values["row"].to_numpy(dtype=float)
    place = _centred(order)
    powers = [np.polynomial.Legendre.basis(k)(place) for k in range(1, DEGREE + 1)]
    return np.column_stack(powers)


def _smooth(session: SessionReadings) -> Array:
    """Monomials (N, k) of first and second degree in the poses."""
    counts = [session.channel_count(s.setup) for s in session.series]
    joints = [
        np.repeat(s.q[s.index[:, 0]], count, axis=0)
        for s, count in zip(session.series, counts, strict=True)
    ]
    place = np.apply_along_axis(_centred, 0, np.vstack(joints))
    k = range(place.shape[1])
    pairs = itertools.combinations_with_replacement(k, 2)
    return np.column_stack([place, *[place[:, i] * place[:, j] for i, j in pairs]])


def _centred(values: Array) -> Array:
    """Values (n,) brought to -1..1."""
    low, high = float(values.min()), float(values.max())
    return np.asarray((2.0 * values - low - high) / max(high - low, 1e-300))
