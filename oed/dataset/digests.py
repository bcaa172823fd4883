"""A digest of each reading, by which a session is known again in any order of rows and columns."""

from __future__ import annotations

import hashlib
from collections.abc import Collection, Iterator, Mapping, Sequence

import numpy as np

from oed.base import Array
from oed.instrument import Series, Setup

#: share of the smaller of two sessions that is equal in both where they are the same
SAME = 0.9
#: bytes of a digest: two of a million readings share one by chance in 0.2 % of sessions
SIZE = 6


def digests(
    series: Sequence[Series], y: Array, setups: Mapping[str, Setup]
) -> list[str]:
    """Sorted digests of readings y (N,), SI, that were taken.

    A digest is of the pose, or of the joints where these were recorded, of the channel
    and of its value, to nine digits. Names of set-ups and runs, order, time and other
    covariates have no part in it, since a second file of a session may have others.
    """
    known: set[str] = set()
    start = 0
    for s in series:
        channels = [c.name for c in setups[s.setup].instrument.channels]
        end = start + len(s) * len(channels)
        known.update(_of_series(s, y[start:end].reshape(len(s), -1), channels))
        start = end
    return sorted(known)


def _of_series(series: Series, values: Array, channels: Sequence[str]) -> Iterator[str]:
    """Digests of values (n, channels) of one series."""
    pairs = zip(series.command, series.q, strict=True)
    poses = [_text(q if np.isnan(command).any() else command) for command, q in pairs]
    for index, row in zip(series.index, values, strict=True):
        place = ";".join(poses[k] for k in index)
        for channel, value in zip(channels, row, strict=True):
            if np.isfinite(value):
                key = f"{place}|{channel}|{_text([value])}"
                yield hashlib.blake2b(key.encode(), digest_size=SIZE).hexdigest()


def _text(values: Sequence[float] | Array) -> str:
    """Numbers to nine digits; zero has no sign."""
    return ",".join(f"{value + 0.0:.9g}" for value in values)


def is_counted(known: Collection[str], others: Collection[str]) -> bool:
    """Whether two sets of digests are of the same session, or one is part of the other."""
    return shared(known, others) >= SAME


def shared(known: Collection[str], others: Collection[str]) -> float:
    """Share of the smaller of two sets of digests that both have; 0 for an empty one."""
    smaller = min(len(known), len(others))
    return len(set(known) & set(others)) / smaller if smaller else 0.0
