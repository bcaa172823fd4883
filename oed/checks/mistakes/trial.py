"""A mistake that readings may have, and the session as it would be without it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Index, Mask
from oed.checks.copies import resolution
from oed.checks.fit import NO_AMOUNTS, Fit, Undo
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.session import SessionReadings
from oed.checks.words import rounded

#: the mistake of amounts (k,) with standard deviations (k,), without a full stop
Words = Callable[[Array, Array], str]

#: step of readings with more digits than are looked at, in their noise
FINEST = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class PoseTable:
    """What the nominal machine reads at poses other than those of the file.

    predicted  (N,) readings, SI; NaN where a pose cannot be reached
    slopes     (N, r) over the free parameters in their tolerances, SI
    by_amount  (N, k) slopes over the amounts of the change times their spread, SI
    """

    predicted: Array
    slopes: Array
    by_amount: Array


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MistakeTrial:
    """A mistake, undone.

    kind       of mistake: the module that makes the trial
    scope      the part of the session that it concerns
    words      the mistake in words
    undo       the session without it
    amounts    (k,) where the search of its unknown amounts begins, SI
    steps      (k,) for differences over them
    estimated  amounts and standard deviations that a fit has, where it is not searched
    is_blind   whether the nominal machine reads the same at any amounts: their search
               begins at fitted parameters
    log_scale  sum over the values of the log of the factor on them: readings that a trial
               makes small fit easily, and their density pays for it
    scaling    the same of amounts, where it follows from them
    log_prior  of the trial among those of its kind and level, beyond an equal share
    family     trials of which the likeliest alone is fitted
    missing    values, by mask (N,), of which the trial does not say where they belong
    log_missing  log density of these, SI; None for that of any value

    How it is judged in the linear model, where it differs from the readings as given:

    y          (N,) values
    mistaken   (N,) values with the mistake in them, where it is not its own inverse
    table      readings at other poses, for the values of the scope
    columns    (N, k) slopes of the values over the amounts; those whose size is not
               known are scaled to what they explain
    parts      values, by mask (N,), that a machine of their own gives
    noise      factors (N,) on the stated noise

    on         the same mistake in other readings; None where it has one scope
    """

    kind: str
    scope: Scope
    words: Words
    undo: Undo
    amounts: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    steps: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    estimated: Callable[[Fit], tuple[Array, Array]] | None = None
    is_blind: bool = False
    log_scale: float = 0.0
    scaling: Callable[[Array], float] = lambda amounts: 0.0
    log_prior: float = 0.0
    family: str = ""
    missing: Mask | None = None
    log_missing: float | None = None
    y: Array | None = None
    mistaken: Array | None = None
    table: PoseTable | None = None
    columns: Array | None = None
    parts: Mask | None = None
    noise: Array | None = None
    on: OnScope | None = None


#: a mistake in the readings of a scope; None where it cannot be there
OnScope = Callable[[Scope], "MistakeTrial | None"]
#: the same of some values (N,) in it
OnValues = Callable[[Scope, Mask], "MistakeTrial | None"]


def in_scopes(scopes: Sequence[Scope], on: OnScope) -> Iterator[MistakeTrial]:
    """One mistake in each of some scopes."""
    for scope in scopes:
        trial = on(scope)
        if trial is not None:
            yield dataclasses.replace(trial, on=on)


def in_values(given: Given, make: OnValues) -> Iterator[MistakeTrial]:
    """One mistake of all values, of a unit and of a channel, in the file, set-ups, runs
    and rows, and in what one instrument may have read.
    """
    for k, places in enumerate(given.places):

        def on(scope: Scope, k: int = k) -> MistakeTrial | None:
            values = given.values_in(scope, k)
            return None if values is None else make(scope, values)

        for scope, values in places:
            trial = make(scope, values)
            if trial is not None:
                yield dataclasses.replace(trial, on=on)
    for scope, values in given.instruments:
        trial = make(scope, values)
        if trial is not None:
            yield trial


def plain(sentence: str) -> Words:
    """The words of a mistake without amounts."""
    return lambda amounts, sd: sentence


def amount(value: float, sd: float, unit: str, *, with_sd: bool = False) -> str:
    """An SI value in a unit, to the first digit of its standard deviation."""
    size, error = (units.number(float(v), unit) for v in (value, sd))
    text = f"{rounded(size, error)} {unit}"
    return f"{text} (sd {error:.2g} {unit})" if with_sd else text


def value_trial(
    session: SessionReadings,
    kind: str,
    scope: Scope,
    sentence: str,
    y: Array,
    log_scale: float = 0.0,
    mistaken: Array | None = None,
) -> MistakeTrial:
    """A trial with other values y (N,) at the same poses."""
    return MistakeTrial(
        kind=kind,
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [session.with_y(y)],
        log_scale=log_scale,
        y=y,
        mistaken=mistaken,
    )


def dropped_trial(
    given: Given, kind: str, scope: Scope, sentence: str, missing: Mask, **more: Any
) -> MistakeTrial:
    """A trial without the readings that have some values (N,)."""
    session = given.session
    dropped = np.unique(session.reading_of_value[missing]).tolist()
    is_all = len(dropped) == 1 + int(session.reading_of_value[-1])
    return MistakeTrial(
        kind=kind,
        scope=scope,
        words=plain(sentence),
        undo=lambda amounts: [] if is_all else [session.without(dropped)],
        missing=missing,
        **more,
    )


def noise_trial(
    given: Given,
    kind: str,
    scope: Scope,
    sentence: str,
    factor: Array,
    log_prior: float,
) -> MistakeTrial:
    """A trial with factors (N,) on the stated noise."""
    session = given.session

    def undo(amounts: Array) -> list[SessionReadings]:
        sigma = factor * given.sigma
        series = tuple(
            dataclasses.replace(s, sigma=sigma[span].reshape(len(s), -1))
            for s, span in zip(session.series, session.spans, strict=True)
        )
        return [dataclasses.replace(session, series=series)]

    return MistakeTrial(
        kind=kind,
        scope=scope,
        words=plain(sentence),
        undo=undo,
        log_prior=log_prior,
        noise=factor,
    )


def log_density_of_known(given: Given, values: Mask, digits: Mask) -> float:
    """Log density, SI, of some values (N,) that are certain to the last digit of others."""
    step = resolution(given.session, np.flatnonzero(digits))
    size = np.maximum(step, FINEST * given.sigma[values])
    return -float(np.log(size).sum())


def members(session: SessionReadings, readings: Index) -> Index:
    """Values (k,) of readings in the order in which these are given."""
    counts = np.bincount(session.reading_of_value)
    starts = np.concatenate([[0], np.cumsum(counts)])
    parts = [np.arange(starts[k], starts[k + 1]) for k in readings]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)
