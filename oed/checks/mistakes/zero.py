"""A wrong zero of what an instrument reads inside, such as the range of a laser ball bar.

A dead length that was not entered displaces every point along its line of sight: other
channels change at other poses, and no offset of a channel says so.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, Words
from oed.checks.words import rounded
from oed.measurement.reading_noise import source_slopes
from oed.model.instrument import InnerReading

#: units of sizes in sentences, by SI unit
SHOWN = {"m": "mm", "rad": "mrad"}
#: words of a reading that is below and above what it should be, by SI unit
WAYS = {"m": ("short", "long"), "rad": ("small", "large")}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each inner reading off by an amount: in the file, a set-up, a run and in rows."""
    setups = given.session.measurement.setups.values()
    inner = {one.name: one for s in setups for one in s.instrument.inner}
    for one in inner.values():
        slopes = _slopes(given, one.name)
        for scope in [*given.scopes, *given.parts]:
            values = scope.values(given.session) & (slopes != 0.0)
            if values.any():
                yield _off(given, scope, one, np.where(values, slopes, 0.0), values)


def _slopes(given: Given, name: str) -> Array:
    """Slopes (N,) of the values over an inner reading; 0 where there is none."""
    session = given.session
    slopes = np.zeros(len(session))
    for series, span in zip(session.series, session.spans, strict=True):
        setup = session.measurement.setups[series.setup]
        for one in setup.instrument.inner:
            if one.name == name:
                of_sources = source_slopes(session.measurement.of(series), series)
                of_errors = of_sources[:, :, list(one.sources)].sum(axis=2)
                slopes[span] = of_errors.ravel() / setup.settings[one.noise]
    return slopes


def _off(
    given: Given, scope: Scope, inner: InnerReading, slopes: Array, values: Mask
) -> MistakeTrial:
    session = given.session
    least = given.sigma[values] / np.abs(slopes[values])
    return MistakeTrial(
        kind="offset" if scope.level in ("file", "set-up") else "run",
        scope=scope,
        words=_words(scope, inner),
        undo=lambda amounts: [session.with_y(session.y - amounts[0] * slopes)],
        amounts=np.zeros(1),
        steps=np.array([float(least.min())]),
        family=f"zero {inner.name} {scope.name}",
        columns=slopes[:, None],
    )


def _words(scope: Scope, inner: InnerReading) -> Words:
    unit = SHOWN[inner.unit]
    cause = f"{inner.zero} is wrong"
    if scope.level in ("run", "rows"):
        cause = "the instrument was zeroed again"

    def words(amounts: Array, sd: Array) -> str:
        size, error = (units.number(float(v[0]), unit) for v in (amounts, sd))
        way = WAYS[inner.unit][size > 0.0]
        return (
            f"every {inner.name}{scope.within} is {rounded(abs(size), error)} {unit} (sd"
            f" {error:.2g} {unit}) too {way}: {cause}"
        )

    return words
