"""Values written otherwise: in another unit, as deviations, with a sign or a factor."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from oed.base import units
from oed.base.arrays import Array, Mask
from oed.checks.mistakes.given import Given
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, value_trial

#: units that a file's readings may be in, beside those of a column
OTHERS = {"m": {"inch": units.INCH}, "rad": {}, "1": {}}
#: standard deviations of a prediction from zero from which on its sign is known
SURE = 3.0
#: what readings are of what they should be
FACTORS = {
    "half of": 0.5,
    "twice": 2.0,
    "a tenth of": 0.1,
    "ten times": 10.0,
    "a hundredth of": 0.01,
    "a hundred times": 100.0,
}


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Readings in other units, deviations, reversed and lost signs, simple factors."""
    yield from _units(given)
    yield from _deviations(given)
    yield from _signs(given)
    yield from _factors(given)


def _bases(given: Given, values: Mask) -> dict[str, Array]:
    """Readings (N,) that a sign or a factor is about, by origin: zero without one."""
    return {"": np.zeros_like(given.session.y), **given.bases(values)}


# -- units -----------------------------------------------------------------------------


def _units(given: Given) -> Iterator[MistakeTrial]:
    """The readings of a kind, and of a column, in each other unit of that kind."""
    for scope, values in given.shown_scopes():
        kinds = list(dict.fromkeys(given.unit[values]))
        for si in kinds:
            of_kind = values & (given.unit == si)
            channels = list(dict.fromkeys(given.channel[of_kind]))
            which = "" if len(kinds) == 1 else f" ({_names(given, channels)})"
            subject = f"the readings{which}{scope.of} are"
            yield from _in_units(given, scope, subject, of_kind)
            if len(channels) == 1:
                continue
            for channel in channels:
                subject = f"{_names(given, [channel])}{scope.within} is"
                of_channel = of_kind & (given.channel == channel)
                yield from _in_units(given, scope, subject, of_channel)
    for scope, values in given.instruments:
        yield from _in_units(given, scope, f"the readings{scope.of} are", values)


def _names(given: Given, channels: list[str]) -> str:
    return ", ".join(given.session.column(c).name for c in channels)


def _in_units(
    given: Given, scope: Scope, subject: str, values: Mask
) -> Iterator[MistakeTrial]:
    session = given.session
    stated = session.column(str(given.channel[values][0]))
    word = stated.name.rpartition("_")[2]
    for name, factor in _unit_factors(stated.unit).items():
        if factor == stated.factor:
            continue
        ratio = factor / stated.factor
        y = np.where(values, session.y * ratio, session.y)
        log_scale = float(values.sum() * np.log(ratio))
        sentence = f"{subject} in {name}, not in {word}"
        yield value_trial(session, "unit", scope, sentence, y, log_scale)


def _unit_factors(si: str) -> Mapping[str, float]:
    """Factors to SI of the units of a kind, by name."""
    known = {name: factor for name, (unit, factor) in units.UNITS.items() if unit == si}
    known.pop("in", None)  # a sentence says inch
    return {**known, **OTHERS.get(si, {})}


# -- deviations ------------------------------------------------------------------------


def _deviations(given: Given) -> Iterator[MistakeTrial]:
    """Readings plus and minus the instrument's length, or what the machine predicts."""
    for scope, values in given.shown_scopes():
        for origin, base in given.bases(values).items():
            about = values & np.isfinite(base)
            yield from _about(given, scope, about, base, origin)


def _about(
    given: Given, scope: Scope, values: Mask, base: Array, origin: str
) -> Iterator[MistakeTrial]:
    session = given.session
    origin = origin.replace(
        "the nominal machine", "the readings of the nominal machine"
    )
    for words, factor in _fine_factors(given, values).items():
        for sign, reversed_sign in ((1.0, ""), (-1.0, " with the sign reversed")):
            y = np.where(values, base + sign * factor * session.y, session.y)
            sentence = (
                f"the readings{scope.of} are deviations from {origin}{words}"
                f"{reversed_sign}"
            )
            log_scale = float(np.log(factor[values]).sum())
            yield value_trial(session, "deviation", scope, sentence, y, log_scale)
    y = np.where(values, session.y - base, session.y)
    sentence = (
        f"the readings{scope.of} have {origin} added twice: they are no deviations any"
        " more"
    )
    yield value_trial(session, "deviation", scope, sentence, y)


def _fine_factors(given: Given, values: Mask) -> dict[str, Array]:
    """Factors (N,) on the values as read: 1, and those of fine units, in words."""
    ones = np.ones(len(values))
    fine, names = ones.copy(), []
    for channel in dict.fromkeys(given.channel[values]):
        column = given.session.column(str(channel))
        name = units.FINE[column.unit]
        if column.unit != "1" and units.factor(name) != column.factor:
            fine[given.channel == channel] = units.factor(name) / column.factor
            names.append(name)
    factors = {"": ones}
    if names:
        factors[f" in {' and '.join(dict.fromkeys(names))}"] = fine
    return factors


# -- signs and factors -----------------------------------------------------------------


def _signs(given: Given) -> Iterator[MistakeTrial]:
    """Each channel with the other sign, and with deviations of the other sign."""
    for scope, channel, values in given.channel_scopes():
        column = given.session.column(channel).name
        yield from _reversed(given, scope, f"{column}{scope.within}", values)
        yield from _lost(given, scope, f"{column}{scope.within}", values)
    for scope, values in given.shown_scopes():
        if len(dict.fromkeys(given.channel[values])) > 1:
            y = np.where(values, -given.session.y, given.session.y)
            sentence = f"the sign of all readings{scope.of} is reversed"
            yield value_trial(given.session, "sign", scope, sentence, y)
    for scope, values in given.instruments:
        yield from _reversed(given, scope, f"the readings{scope.of}", values)


def _reversed(
    given: Given, scope: Scope, of: str, values: Mask
) -> Iterator[MistakeTrial]:
    for origin, base in _bases(given, values).items():
        what = f"the deviations of {of} from {origin}" if origin else of
        sentence = f"the sign of {what} is reversed"
        yield _times(given, "sign", scope, sentence, values, base, -1.0)


def _lost(given: Given, scope: Scope, of: str, values: Mask) -> Iterator[MistakeTrial]:
    """Readings that are all positive, or all negative, where some should not be.

    A reading has a sign to lose where its prediction is surely above or below zero.
    """
    y, sign = given.session.y, np.sign(given.predicted)
    if not (np.all(y[values] >= 0.0) or np.all(y[values] <= 0.0)):
        return
    is_known = np.abs(given.predicted) > SURE * given.spread
    changed = np.where(values & is_known, sign * np.abs(y), y)
    if (changed != y).any() and (changed != -y)[values].any():
        sentence = f"the sign of {of} is lost: all readings have one sign"
        yield value_trial(given.session, "sign", scope, sentence, changed)


def _factors(given: Given) -> Iterator[MistakeTrial]:
    """The readings and each column, times each factor."""
    for scope, values in given.shown_scopes():
        yield from _scaled(given, scope, f"readings{scope.of}", values)
    for scope, channel, values in given.channel_scopes():
        if len(dict.fromkeys(given.channel[scope.values(given.session)])) > 1:
            column = given.session.column(channel).name
            subject = f"readings of {column}{scope.within}"
            yield from _scaled(given, scope, subject, values)
    for scope, values in given.instruments:
        yield from _scaled(given, scope, f"readings{scope.of}", values)


def _scaled(
    given: Given, scope: Scope, subject: str, values: Mask
) -> Iterator[MistakeTrial]:
    for origin, base in _bases(given, values).items():
        deviations = f"the deviations of the {subject} from {origin}"
        what = deviations if origin else f"the {subject}"
        for words, factor in FACTORS.items():
            sentence = f"{what} are {words} what they should be"
            yield _times(given, "scale", scope, sentence, values, base, factor)


def _times(
    given: Given,
    kind: str,
    scope: Scope,
    sentence: str,
    values: Mask,
    base: Array,
    factor: float,
) -> MistakeTrial:
    """Values whose deviations from `base` (N,) were multiplied by a factor."""
    session, y = given.session, given.session.y
    about = values & np.isfinite(base)
    changed = np.where(about, base + (y - base) / factor, y)
    is_own_inverse = factor == -1.0
    mistaken = (
        None if is_own_inverse else np.where(about, base + (y - base) * factor, y)
    )
    log_scale = -float(about.sum() * np.log(abs(factor)))
    return value_trial(session, kind, scope, sentence, changed, log_scale, mistaken)
