"""Values written otherwise: in another unit, as deviations, with a sign or a factor."""

from collections.abc import Callable, Iterator, Mapping
from functools import partial

import numpy as np

from oed import units
from oed.base import Array, Mask
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import MistakeTrial, mistakes_of_values, value_trial
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
    for si in dict.fromkeys(data.unit[data.shown]):
        for name, factor in _unit_factors(si).items():
            yield from mistakes_of_values(
                data, partial(_other_unit_trial, data, si, name, factor)
            )
    for text, meant in SEXAGESIMAL.items():
        yield from mistakes_of_values(data, partial(_sexagesimal, data, text, meant))
    for origin in ORIGINS[1:]:
        for fine in ({}, FINE_UNITS, DIVISIONS):
            for sign in (1.0, -1.0):
                make = partial(_deviation, data, origin, fine, sign)
                yield from mistakes_of_values(data, make)
        yield from mistakes_of_values(data, partial(_added_twice, data, origin))
    yield from mistakes_of_values(data, partial(_lost, data))
    for origin in ORIGINS:
        reversed_sign = "the sign of {} is reversed"
        yield from mistakes_of_values(
            data,
            partial(_deviations_changed, data, origin, "sign", reversed_sign, -1.0),
        )
        for text, factor in (
            FACTORS | (THOUSAND_FACTORS if origin else POINT_LOST_FACTORS)
        ).items():
            why = ": the decimal point is lost" if text in POINT_LOST_FACTORS else ""
            sentence = f"{{}} are {text} what they should be{why}"
            yield from mistakes_of_values(
                data,
                partial(
                    _deviations_changed, data, origin, "scale", sentence, 1.0 / factor
                ),
            )


def _base(data: Suspect, values: Mask, origin: str) -> Array | None:
    """Readings (N,) that a sign or a factor is about: zero for no origin."""
    if not origin:
        return np.zeros_like(data.session.y)
    return data.bases(values).get(origin)


def _changed(
    data: Suspect,
    kind: str,
    scope: Scope,
    sentence: str,
    values: Mask,
    start: Array,
    factor: Array | float,
    base: Array | float = 0.0,
) -> MistakeTrial:
    """Values y of which start + factor (y - base) is right, all (N,); others stay."""
    y = data.session.y
    about = values & np.isfinite(start + base)
    right = np.where(about, start + factor * (y - base), y)
    mistaken = np.where(about, base + (y - start) / factor, y)
    log_factor = np.log(np.abs(np.broadcast_to(factor, y.shape)))
    log_scale = float(log_factor[about].sum())
    return value_trial(
        data.session,
        kind,
        scope,
        sentence,
        right,
        log_scale=log_scale,
        mistaken=mistaken,
    )


def _where(data: Suspect, scope: Scope, values: Mask) -> str:
    return f"{data.names(values)}{scope.within}"


def _readings(data: Suspect, scope: Scope, values: Mask) -> str:
    if data.is_all(scope, values):
        return f"the readings{scope.of}"
    return f"the readings of {_where(data, scope, values)}"


# -- units and deviations --------------------------------------------------------------
def _other_unit_trial(
    data: Suspect, si: str, name: str, factor: float, scope: Scope, values: Mask
) -> MistakeTrial | None:
    """The readings of a kind, or of a column, in another unit of that kind."""
    stated = data.session.column(str(data.channel[values][0]))
    if set(data.unit[values]) != {si} or factor == stated.factor:
        return None
    of_kind = data.shown & (data.unit == si) & scope.values(data.session)
    subject = f"{_where(data, scope, values)} is"
    if data.is_all(scope, values):
        subject = f"the readings{scope.of} are"
    elif np.array_equal(values, of_kind):
        subject = f"the readings ({data.names(values)}){scope.of} are"
    sentence = f"{subject} in {name}, not in {stated.name.rpartition('_')[2]}"
    zero = np.zeros(len(values))
    ratio = factor / stated.factor
    return _changed(data, "unit", scope, sentence, values, zero, ratio)


def _sexagesimal(
    data: Suspect,
    text: str,
    meant: Callable[[Array], Array],
    scope: Scope,
    values: Mask,
) -> MistakeTrial | None:
    """Angles whose decimals are minutes, or minutes and seconds, of them."""
    y = data.session.y.copy()
    y[values] = meant(y[values])
    if set(data.unit[values]) != {"rad"} or not np.isfinite(y).all():
        return None
    subject = _readings(data, scope, values)
    sentence = f"{subject} have {text} after their decimal point"
    log_scale = float(values.sum() * np.log(meant(SMALL_ANGLE) / SMALL_ANGLE)[0])
    return value_trial(data.session, "unit", scope, sentence, y, log_scale=log_scale)


def _unit_factors(si: str) -> Mapping[str, float]:
    factors = {
        name: factor for name, (unit, factor) in units.UNITS.items() if unit == si
    }
    factors.pop("in", None)  # a sentence says inch
    return {**factors, **OTHER_UNITS.get(si, {})}


def _deviation(
    data: Suspect,
    origin: str,
    fine: Mapping[str, tuple[str, float]],
    sign: float,
    scope: Scope,
    values: Mask,
) -> MistakeTrial | None:
    """Values that are deviations from `origin`, in fine units, with a sign."""
    session = data.session
    base = _base(data, values, origin)
    if base is None:
        return None
    factor = np.ones(len(session))
    names = []
    for channel in dict.fromkeys(data.channel[values & np.isfinite(base)]):
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
    subject = _readings(data, scope, values)
    sentence = f"{subject} are deviations from {what}{unit}{reversed_sign}"
    factor = sign * factor
    return _changed(data, "deviation", scope, sentence, values, base, factor)


def _added_twice(
    data: Suspect, origin: str, scope: Scope, values: Mask
) -> MistakeTrial | None:
    base = _base(data, values, origin)
    if base is None or not data.is_all(scope, values):
        return None
    sentence = f"the readings{scope.of} have {origin} added twice: they are no deviations any more"
    return _changed(data, "deviation", scope, sentence, values, -base, 1.0)


# -- signs and factors -----------------------------------------------------------------
def _lost(data: Suspect, scope: Scope, values: Mask) -> MistakeTrial | None:
    """Readings of one sign where predictions, surely not 0, ask for both."""
    y = data.session.y
    sign = np.sign(data.predicted)
    if not (np.all(y[values] >= 0.0) or np.all(y[values] <= 0.0)):
        return None
    is_known = np.abs(data.predicted) > KNOWN_SIGN_SD * data.spread
    changed = np.where(values & is_known, sign * np.abs(y), y)
    if not ((changed != y).any() and (changed != -y)[values].any()):
        return None
    of = _where(data, scope, values)
    sentence = f"the sign of {of} is lost: all readings have one sign"
    return value_trial(data.session, "sign", scope, sentence, changed)


def _deviations_changed(
    data: Suspect,
    origin: str,
    kind: str,
    sentence: str,
    factor: float,
    scope: Scope,
    values: Mask,
) -> MistakeTrial | None:
    """Readings whose deviations from an origin have another sign or size."""
    base = _base(data, values, origin)
    if base is None:
        return None
    what = _readings(data, scope, values)
    if kind == "sign" and scope.level != "instrument":
        is_all = data.is_all(scope, values) and len(set(data.channel[values])) > 1
        what = f"all readings{scope.of}" if is_all else _where(data, scope, values)
    if origin:
        what = f"the deviations of {what} from {origin}"
    text = sentence.format(what)
    return _changed(data, kind, scope, text, values, base, factor, base)
