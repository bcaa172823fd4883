"""Mistakes of an unknown amount: offsets, scales, set-ups that moved, wrong sizes.

An effect of the machine, or a parameter far outside its tolerance, can look the same.

A dead length that was not entered displaces every point of a laser ball bar along its line
of sight: other channels change at other poses, and no offset of a channel says so.
"""

import dataclasses
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
import scipy

from oed import units
from oed.base import Array, Index
from oed.checks.findings import rounded
from oed.checks.mistakes.moved import AGAIN_SUFFIX, mounted_again, with_moved
from oed.checks.mistakes.suspect import MIN_PART, Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    Words,
    amount,
    mistakes_of_scopes,
    mistakes_of_values,
    plain,
)
from oed.checks.session import SessionReadings
from oed.instrument import InnerReading
from oed.measurement import Series

#: log prior of another factor in part of a set-up: it belongs to the instrument
PART_LOG_PRIOR = -3.0
#: tolerances to which that of a number is widened which may be wrong
WIDENED_TOLERANCES = 50.0
#: words of a reading that is below and above what it should be, by SI unit
SIZE_WORDS = {"m": ("short", "long"), "rad": ("small", "large")}
#: stretches of rows inside a run, the likeliest of each channel, that are tried
N_STRETCHES = 5


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Zeros, offsets, scales, tools, set-ups that moved, and sizes far from nominal."""
    yield from _zeros(data)
    for make in (_offset, _scale, _offsets_of_runs):
        yield from mistakes_of_values(data, make)
    yield from _offsets_of_stretches(data)
    yield from filter(None, map(_moved_setup, [*data.scopes, *data.parts]))
    yield from _sizes(data)


# -- readings --------------------------------------------------------------------------
def _subject(scope: Scope) -> str:
    of = scope.of if scope.level == "instrument" else f" of {scope.columns_within}"
    return f"all readings{of} are"


def _is_of_one(scope: Scope) -> bool:
    """Whether one instrument reads all values, in one channel."""
    return scope.level == "instrument" or len(scope.channels) == 1


def _shifted_values(
    scope: Scope, kind: str, text: Words, columns: Array, family: str, **more: Any
) -> MistakeTrial:
    """Values that are off by columns (N, k) times amounts."""
    session = scope.session
    size = np.abs(columns)
    noise = np.broadcast_to(scope.data.sigma[:, None], size.shape)
    step = float((noise[size > 0.0] / size[size > 0.0]).min())
    return MistakeTrial(
        kind=kind,
        scope=scope,
        text=text,
        change=lambda amounts: [session.with_y(session.y - columns @ amounts)],
        amounts=np.zeros(columns.shape[1]),
        steps=np.full(columns.shape[1], more.pop("step", step)),
        family=f"{family} {scope.name}",
        columns=columns,
        **more,
    )


def _offset(scope: Scope) -> MistakeTrial | None:
    if not _is_of_one(scope):
        return None
    channel = scope.channels[0]
    kind, cause = "offset", "the bar length or the zero of the instrument is wrong"
    if scope.is_part:
        kind, cause = "run", "the set-up moved or was zeroed again"

    def text(amounts: Array, sd: Array) -> str:
        size, error = (scope.session.fine(channel, float(v[0])) for v in (amounts, sd))
        return f"{_subject(scope)} off by {size} (sd {error}): {cause}"

    column = np.asarray(scope.values, dtype=float)[:, None]
    family = "offset" if len(set(scope.data.channel)) == 1 else f"offset {channel}"
    return _shifted_values(scope, kind, text, column, family)


def _offsets_of_stretches(data: Suspect) -> Iterator[MistakeTrial]:
    """Rows inside a run that are off by an amount: the likeliest of each channel.

    With the precision P of the readings r about the linear model, an offset c of unknown
    size lessens their misfit by (c^T P r)^2 / c^T P c.
    """
    covariance = data.slopes @ data.slopes.T + np.diag(data.sigma**2)
    precision = scipy.linalg.inv(covariance)
    pull = precision @ (data.session.y - data.predicted)
    for channel in dict.fromkeys(data.channel[data.shown]):
        gains: list[tuple[float, Index]] = []
        for run in data.runs:
            places = np.flatnonzero((data.channel == channel) & run.values)
            gains += _gains(pull[places], precision[np.ix_(places, places)], places)
        gains.sort(key=lambda one: -one[0])
        for _, places in gains[:N_STRETCHES]:
            rows = data.rows_scope(data.session.reading_of_value[places])
            values = np.isin(np.arange(len(pull)), places)
            one = _offset(dataclasses.replace(rows, values=values))
            if one is not None:
                share = float(np.log(N_STRETCHES / len(gains)))
                yield dataclasses.replace(one, log_prior=min(share, 0.0))


def _gains(pull: Array, precision: Array, places: Index) -> list[tuple[float, Index]]:
    """What an offset of each stretch inside a run of n values gains; P r (n,), P (n, n)."""
    count = len(places)
    sums = np.append(0.0, np.cumsum(pull))
    block = np.pad(precision.cumsum(0).cumsum(1), ((1, 0), (1, 0)))
    gains = []
    for i in range(1, count - MIN_PART):
        for j in range(i + MIN_PART, count):
            size = block[j, j] - block[i, j] - block[j, i] + block[i, i]
            gains.append((float((sums[j] - sums[i]) ** 2 / size), places[i:j]))
    return gains


def _offsets_of_runs(scope: Scope) -> MistakeTrial | None:
    """Each run of a file or a set-up off by an amount of its own."""
    parts = [run.values & scope.values for run in scope.data.runs]
    columns = np.column_stack([p for p in parts if p.any()]).astype(float)
    if not _is_of_one(scope) or scope.is_part or columns.shape[1] < 2:
        return None
    channel = scope.channels[0]

    def text(amounts: Array, sd: Array) -> str:
        ends = amounts.min(), amounts.max()
        least, most = (scope.session.fine(channel, float(end)) for end in ends)
        return (
            f"{_subject(scope)} off by an amount of each run, {least} to"
            f" {most}: the instrument was not zeroed at each run, or moved between them"
        )

    return _shifted_values(scope, "run", text, columns, f"offsets {channel}")


def _scale(scope: Scope) -> MistakeTrial | None:
    """Values of one unit times 1 / (1 - a), with the amount a."""
    data, session, values = scope.data, scope.session, scope.values
    count = int(values.sum())
    is_of_setup = len(set(session.values["setup"][values])) == 1
    has_one_unit = len(set(data.unit[values])) == 1
    if not (is_of_setup and has_one_unit) and not _is_of_one(scope):
        return None

    def text(amounts: Array, sd: Array) -> str:
        rest = 1.0 - float(amounts[0])
        size, error = 100.0 * float(amounts[0]) / rest, 100.0 * float(sd[0]) / rest**2
        return (
            f"{_subject(scope)} {rounded(abs(size), error)} %"
            f" (sd {error:.2g} %) too {'large' if size > 0.0 else 'small'}: the scale or"
            " conversion factor of the instrument is wrong"
        )

    def scaling(amounts: Array) -> float:
        return count * float(np.log(max(abs(1.0 - amounts[0]), 1e-12)))

    return _shifted_values(
        scope,
        "factor",
        text,
        np.where(values, session.y, 0.0)[:, None],
        f"factor {scope.columns}",
        step=1e-6,
        log_prior=PART_LOG_PRIOR if scope.is_part else 0.0,
        scaling=scaling,
    )


# -- set-ups that moved ----------------------------------------------------------------
def _moved_setup(scope: Scope) -> MistakeTrial | None:
    """The unknowns of a set-up anew in one run, or in the first or last rows."""
    data, session, inside = scope.data, scope.session, scope.values
    names = session.values["setup"].to_numpy()
    setup = str(names[inside][0])
    is_part = scope.level in ("run", "rows") and ((names == setup) & ~inside).any()
    if not is_part or (names[inside] != setup).any():
        return None
    measurement = session.measurement
    unknowns = [measurement.names[k] for k in np.flatnonzero(measurement.free)]
    free = [k for k, name in enumerate(unknowns) if name.startswith(f"{setup}.")]
    slopes = data.slopes[inside][:, free]
    # the only unknown of a set-up may move all its readings alike
    is_offset = len(free) == 1 and np.ptp(slopes) <= 1e-9 * np.abs(slopes).max()
    if is_offset or not 0 < 2 * len(free) <= inside.sum():
        return None
    return MistakeTrial(
        kind="run",
        scope=scope,
        text=plain(
            f"what {setup} is set up on stood elsewhere{scope.within}: it moved, or was set"
            " up again"
        ),
        change=lambda amounts: [_set_up_again(session, scope.readings, setup)],
        family=f"moved {scope.name}",
        columns=np.where(inside[:, None], data.slopes[:, free], 0.0),
    )


def _set_up_again(
    session: SessionReadings, readings: Index, setup: str
) -> SessionReadings:
    """The session in which some readings have a set-up of their own, with its unknowns."""
    measurement = mounted_again(
        session.measurement, [setup], lambda one: {"station": ""}
    )
    again = measurement.setups[setup + AGAIN_SUFFIX]
    unknowns = {f"{again.name}.{n.name}": WIDENED_TOLERANCES for n in again.nuisances}
    wider = dataclasses.replace(session, measurement=measurement, wider=unknowns)

    def moved(series: Series) -> Series:
        return dataclasses.replace(series, setup=again.name)

    return with_moved(wider, readings, moved)


# -- sizes far from nominal ------------------------------------------------------------
def _sizes(data: Suspect) -> Iterator[MistakeTrial]:
    """Each free parameter far outside its tolerance."""
    measurement = data.session.measurement
    for column, k in enumerate(np.flatnonzero(measurement.free)):
        if data.slopes[:, column].any():
            yield _size(data, int(k), column)


def _size(data: Suspect, k: int, column: int) -> MistakeTrial:
    parameter = data.session.measurement.parameters[k]
    wider = dataclasses.replace(
        data.session, wider={parameter.name: WIDENED_TOLERANCES}
    )

    def text(amounts: Array, sd: Array) -> str:
        size = amount(amounts[0], sd[0], units.display(parameter.unit))
        tolerances = abs(float(amounts[0])) / parameter.tolerance
        return (
            f"{parameter.name} is {size} from its nominal value, {tolerances:.2g} times its"
            " tolerance: a number of the study is wrong"
        )

    return MistakeTrial(
        kind="size",
        scope=data.file,
        text=text,
        change=lambda amounts: [wider],
        estimated=lambda solution: solution.parameter(parameter.name),
        family=f"size {parameter.name}",
        columns=(WIDENED_TOLERANCES * data.slopes[:, column])[:, None],
    )


# -- zeros inside an instrument --------------------------------------------------------
def _zeros(data: Suspect) -> Iterator[MistakeTrial]:
    """Each inner reading off by an amount: in the file, a set-up, a run and in rows."""
    setups = data.session.measurement.setups.values()
    inner = {one.name: one for s in setups for one in s.instrument.inner}
    for one in inner.values():
        off = partial(_zero, one, _slopes(data, one.name))
        yield from mistakes_of_scopes([*data.scopes, *data.parts], off)


def _slopes(data: Suspect, name: str) -> Array:
    """Slopes (N,) of the values over an inner reading; 0 where there is none."""
    session = data.session
    slopes = np.zeros(len(session))
    for series, span in zip(session.series, session.spans, strict=True):
        setup = session.measurement.setups[series.setup]
        for one in setup.instrument.inner:
            if one.name == name:
                readings = session.measurement.of(series)
                of_sources = readings.source_gradients(series)
                of_errors = of_sources[:, :, list(one.sources)].sum(axis=2)
                slopes[span] = of_errors.ravel() / setup.settings[one.noise]
    return slopes


def _zero(inner: InnerReading, every: Array, scope: Scope) -> MistakeTrial | None:
    """An inner reading off by an amount, by slopes (N,) over it."""
    slopes = np.where(scope.values, every, 0.0)
    if not slopes.any():
        return None
    kind, cause = "offset", f"{inner.zero} is wrong"
    if scope.is_part:
        kind, cause = "run", "the instrument was zeroed again"

    def text(amounts: Array, sd: Array) -> str:
        unit = units.display(inner.unit)
        way = SIZE_WORDS[inner.unit][int(amounts[0] > 0.0)]
        size = amount(abs(amounts[0]), sd[0], unit, with_sd=True)
        return f"every {inner.name}{scope.within} is {size} too {way}: {cause}"

    return _shifted_values(scope, kind, text, slopes[:, None], f"zero {inner.name}")
