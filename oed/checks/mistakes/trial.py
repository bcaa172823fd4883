"""A mistake that readings may have, and the session as it would be without it."""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from oed import units
from oed.base import Array, Index, Mask
from oed.checks.copies import resolution
from oed.checks.findings import rounded
from oed.checks.fit import NO_AMOUNTS, Fit, Undo
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.session import SessionReadings

#: the mistake of amounts (k,) with standard deviations (k,), without a full stop
Words = Callable[[Array, Array], str]

#: step of readings with more digits than are looked at, in their noise
FINEST_STEP = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class PoseTable:
    """What the nominal machine reads at poses other than those of the file."""

    predicted: Array  #: (N,) readings, SI; NaN where a pose cannot be reached
    slopes: Array  #: (N, r) over the free parameters in their tolerances, SI
    #: (N, k) slopes over the amounts of the change times their spread, SI
    by_amount: Array


@dataclasses.dataclass(frozen=True, eq=False, kw_only=True)
class MistakeTrial:
    """A mistake, undone.

    How it is judged in the linear model, where it differs from the readings as given:
    """

    kind: str  #: of mistake: the module that makes the trial
    scope: Scope  #: the part of the session that it concerns
    text: Words  #: the mistake in words
    #: the session without it; None where values, order and noise say so
    change: Undo | None = None
    #: (k,) where the search of its unknown amounts begins, SI
    amounts: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    #: (k,) for differences over them
    steps: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    #: amounts and standard deviations that a fit has, where it is not searched
    estimated: Callable[[Fit], tuple[Array, Array]] | None = None
    #: whether the nominal machine reads the same at any amounts: their search begins at
    #: fitted parameters
    is_blind: bool = False
    #: sum over the values of the log of the factor on them: readings that a trial makes
    #: small fit easily, and their density pays for it
    log_scale: float = 0.0
    #: the same of amounts, where it follows from them
    scaling: Callable[[Array], float] = lambda amounts: 0.0
    #: of the trial among those of its kind and level, beyond an equal share
    log_prior: float = 0.0
    family: str = ""  #: trials of which the likeliest alone is fitted
    #: values, by mask (N,), of which the trial does not say where they belong
    missing: Mask | None = None
    #: log density of these, SI; None for that of any value
    log_missing: float | None = None
    y: Array | None = None  #: (N,) values
    #: (N,) values with the mistake in them, where it is not its own inverse
    mistaken: Array | None = None
    #: readings at other poses, for the values of the scope
    table: PoseTable | None = None
    #: (N, k) slopes of the values over the amounts; those whose size is not known are
    #: scaled to what they explain
    columns: Array | None = None
    #: values, by mask (N,), that a machine of their own gives
    parts: Mask | None = None
    noise: Array | None = None  #: factors (N,) on the stated noise
    #: the same mistake in other readings; None where it has one scope
    on: "OnScope | None" = None

    @property
    def log_density_missing(self) -> float:
        """Log density of the values that the trial does not place, SI."""
        if self.missing is None or self.log_missing is not None:
            return self.log_missing or 0.0
        return self.scope.data.log_density_of_any(self.missing)

    def undo(self, amounts: Array) -> Sequence[SessionReadings]:
        """Sessions without the mistake: one, or several of machines apart."""
        if self.change is not None:
            return self.change(amounts)
        session = self.scope.session
        if self.y is not None:
            session = session.with_y(self.y)
        number = session.reading_of_value
        if self.noise is not None:
            sigma = self.noise * session.measurement.sigma(session.series)
            return [session.with_sigma(sigma)]
        if self.parts is not None:
            return [
                session.take(np.unique(number[p])) for p in (~self.parts, self.parts)
            ]
        if self.missing is None:
            return [session]
        dropped = np.unique(number[self.missing])
        is_all = len(dropped) == 1 + int(number[-1])
        return [] if is_all else [session.without(dropped)]


#: a mistake in the values of a scope; None where it cannot be there
OnScope = Callable[[Scope], "MistakeTrial | None"]


def mistakes_of_scopes(scopes: Sequence[Scope], on: OnScope) -> Iterator[MistakeTrial]:
    """One mistake in each of some scopes."""
    for scope in scopes:
        trial = on(scope)
        if trial is not None:
            yield dataclasses.replace(trial, on=on)


def mistakes_of_values(data: Suspect, make: OnScope) -> Iterator[MistakeTrial]:
    """One mistake of all values, of a unit and of a channel, in the file, set-ups, runs
    and rows, and in what one instrument may have read.
    """
    for k, scopes in enumerate(data.targeted):

        def on(scope: Scope, k: int = k) -> MistakeTrial | None:
            part = data.target_in(scope, k)
            return None if part is None else make(part)

        trials = filter(None, map(make, scopes))
        yield from (dataclasses.replace(trial, on=on) for trial in trials)
    yield from filter(None, map(make, data.instruments))


def plain(sentence: str) -> Words:
    """The words of a mistake without amounts."""
    return lambda amounts, sd: sentence


def amount(value: float, sd: float, unit: str, *, with_sd: bool = False) -> str:
    """An SI value in a unit, to the first digit of its standard deviation."""
    size, error = (units.number(float(v), unit) for v in (value, sd))
    text = f"{rounded(size, error)} {unit}"
    return f"{text} (sd {error:.2g} {unit})" if with_sd else text


def value_trial(
    scope: Scope, kind: str, sentence: str, y: Array | None = None, **more: Any
) -> MistakeTrial:
    """A trial with other values y (N,) at the same poses, without some, or other noise."""
    return MistakeTrial(kind=kind, scope=scope, text=plain(sentence), y=y, **more)


def log_density_of_known(data: Suspect, values: Mask, digits: Mask) -> float:
    """Log density, SI, of some values (N,) that are certain to the last digit of others."""
    step = resolution(data.session, np.flatnonzero(digits))
    size = np.maximum(step, FINEST_STEP * data.sigma[values])
    return -float(np.log(size).sum())


def members(session: SessionReadings, readings: Index) -> Index:
    """Values (k,) of readings in the order in which these are given."""
    counts = np.bincount(session.reading_of_value)
    starts = np.concatenate([[0], np.cumsum(counts)])
    parts = [np.arange(starts[k], starts[k + 1]) for k in readings]
    return np.concatenate(parts) if parts else np.zeros(0, dtype=np.intp)
