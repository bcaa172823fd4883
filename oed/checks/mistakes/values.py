"""Values written otherwise: in another unit, as deviations, with a sign or a factor."""

import itertools
from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from oed import units
from oed.base import Array
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    OnScope,
    mistakes_of_values,
    value_trial,
)
from oed.dataset import SEXAGESIMAL, WRONG_FACTORS

#: units that a file's readings may be in, beside those of a column
OTHER_UNITS = {"m": {"inch": units.INCH}}
#: fine units in which deviations are written, by SI unit
FINE_UNITS = {si: (units.FINE[si], units.factor(units.FINE[si])) for si in ("m", "rad")}
DIVISIONS = {"m": ("divisions of 0.01 mm", 1e-5)}
#: an angle, rad, by which a notation says what its last digits are
SMALL_ANGLE = np.array([1e-5 * units.DEG])
#: standard deviations of a prediction from zero from which on its sign is known
KNOWN_SIGN_SD = 3.0
#: what readings, or deviations, are of what they should be
FACTORS = {**WRONG_FACTORS, "a hundredth of": 0.01, "a hundred times": 100.0}
#: the same of readings without a decimal point, and of deviations in another unit
POINT_LOST_FACTORS = {f"{10**k} times": 10.0**k for k in range(4, 8)}
THOUSAND_FACTORS = {"a thousandth of": 1e-3, "a thousand times": 1e3}
ORIGINS = ("", "the nominal length", "the nominal machine")


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Readings in other units, deviations, reversed and lost signs, simple factors."""
    makers: list[OnScope] = []
    for si in dict.fromkeys(data.unit[data.shown]):
        makers += [
            partial(_other_unit_trial, si, *u) for u in _unit_factors(si).items()
        ]
    makers += [partial(_sexagesimal, *notation) for notation in SEXAGESIMAL.items()]
    for origin in ORIGINS[1:]:
        for fine, sign in itertools.product(({}, FINE_UNITS, DIVISIONS), (1.0, -1.0)):
            makers.append(partial(_deviation, origin, fine, sign))
        makers.append(partial(_added_twice, origin))
    makers.append(_lost)
    for origin in ORIGINS:
        reversed_sign = "the sign of {} is reversed"
        makers.append(partial(_deviations_changed, origin, "sign", reversed_sign, -1.0))
        factors = FACTORS | (THOUSAND_FACTORS if origin else POINT_LOST_FACTORS)
        for text, factor in factors.items():
            why = ": the decimal point is lost" if text in POINT_LOST_FACTORS else ""
            sentence = f"{{}} are {text} what they should be{why}"
            makers.append(
                partial(_deviations_changed, origin, "scale", sentence, 1.0 / factor)
            )
    for make in makers:
        yield from mistakes_of_values(data, make)


def _base(scope: Scope, origin: str) -> Array | None:
    """Readings (N,) that a sign or a factor is about: zero for no origin."""
    if not origin:
        return np.zeros_like(scope.session.y)
    return scope.data.bases(scope.values).get(origin)


def _changed(
    scope: Scope,
    kind: str,
    sentence: str,
    start: Array | float,
    factor: Array | float,
    base: Array | float = 0.0,
) -> MistakeTrial:
    """Values y of which start + factor (y - base) is right, all (N,); others stay."""
    y = scope.session.y
    about = scope.values & np.isfinite(start + base)
    right = np.where(about, start + factor * (y - base), y)
    mistaken = np.where(about, base + (y - start) / factor, y)
    log_factor = np.log(np.abs(np.broadcast_to(factor, y.shape)))
    log_scale = float(log_factor[about].sum())
    return value_trial(
        scope, kind, sentence, right, log_scale=log_scale, mistaken=mistaken
    )


# -- units and deviations --------------------------------------------------------------
def _other_unit_trial(
    si: str, name: str, factor: float, scope: Scope
) -> MistakeTrial | None:
    """The readings of a kind, or of a column, in another unit of that kind."""
    stated = scope.session.column(scope.channels[0])
    if not scope.is_of(si) or factor == stated.factor:
        return None
    subject = f"{scope.columns_within} is"
    if scope.has_all:
        subject = f"the readings{scope.of} are"
    elif np.array_equal(scope.values, scope.shown & (scope.data.unit == si)):
        subject = f"the readings ({scope.columns}){scope.of} are"
    sentence = f"{subject} in {name}, not in {stated.name.rpartition('_')[2]}"
    return _changed(scope, "unit", sentence, 0.0, factor / stated.factor)


def _sexagesimal(
    text: str, meant: Callable[[Array], Array], scope: Scope
) -> MistakeTrial | None:
    """Angles whose decimals are minutes, or minutes and seconds, of them."""
    y, values = scope.session.y.copy(), scope.values
    y[values] = meant(y[values])
    if not scope.is_of("rad") or not np.isfinite(y).all():
        return None
    sentence = f"{scope.subject} have {text} after their decimal point"
    log_scale = float(values.sum() * np.log(meant(SMALL_ANGLE) / SMALL_ANGLE)[0])
    return value_trial(scope, "unit", sentence, y, log_scale=log_scale)


def _unit_factors(si: str) -> Mapping[str, float]:
    factors = {
        name: factor for name, (unit, factor) in units.UNITS.items() if unit == si
    }
    factors.pop("in", None)  # a sentence says inch
    return {**factors, **OTHER_UNITS.get(si, {})}


def _deviation(
    origin: str, fine: Mapping[str, tuple[str, float]], sign: float, scope: Scope
) -> MistakeTrial | None:
    """Values that are deviations from `origin`, in fine units, with a sign."""
    data, session = scope.data, scope.session
    base = _base(scope, origin)
    if base is None:
        return None
    factor = np.ones(len(session))
    names = []
    for channel in dict.fromkeys(data.channel[scope.values & np.isfinite(base)]):
        column = session.column(str(channel))
        name, of_unit = fine.get(column.unit, ("", column.factor))
        if of_unit != column.factor:
            factor[data.channel == channel] = of_unit / column.factor
            names.append(name)
    if fine and not names:
        return None
    what = origin.replace("the nominal machine", "the readings of the nominal machine")
    unit = f" in {' and '.join(dict.fromkeys(names))}" if names else ""
    reversed_sign = " with the sign reversed" if sign < 0.0 else ""
    sentence = f"{scope.subject} are deviations from {what}{unit}{reversed_sign}"
    return _changed(scope, "deviation", sentence, base, sign * factor)


def _added_twice(origin: str, scope: Scope) -> MistakeTrial | None:
    base = _base(scope, origin)
    if base is None or not scope.has_all:
        return None
    sentence = f"the readings{scope.of} have {origin} added twice: they are no deviations any more"
    return _changed(scope, "deviation", sentence, -base, 1.0)


# -- signs and factors -----------------------------------------------------------------
def _lost(scope: Scope) -> MistakeTrial | None:
    """Readings of one sign where predictions, surely not 0, ask for both."""
    data, y, values = scope.data, scope.session.y, scope.values
    sign = np.sign(data.predicted)
    if not (np.all(y[values] >= 0.0) or np.all(y[values] <= 0.0)):
        return None
    is_known = np.abs(data.predicted) > KNOWN_SIGN_SD * data.spread
    changed = np.where(values & is_known, sign * np.abs(y), y)
    if not ((changed != y).any() and (changed != -y)[values].any()):
        return None
    sentence = f"the sign of {scope.columns_within} is lost: all readings have one sign"
    return value_trial(scope, "sign", sentence, changed)


def _deviations_changed(
    origin: str, kind: str, sentence: str, factor: float, scope: Scope
) -> MistakeTrial | None:
    """Readings whose deviations from an origin have another sign or size."""
    base = _base(scope, origin)
    if base is None:
        return None
    what = scope.subject
    if kind == "sign" and scope.level != "instrument":
        is_all = scope.has_all and len(scope.channels) > 1
        what = f"all readings{scope.of}" if is_all else scope.columns_within
    if origin:
        what = f"the deviations of {what} from {origin}"
    return _changed(scope, kind, sentence.format(what), base, factor, base)
