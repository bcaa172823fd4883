"""Signatures: what an effect's coefficients do to the readings, to first order; and
exactly, for virtual machines.

The signature of a coefficient is H delta p of its changes, summed over the poses that a
reading sees:

    G = sum_j y_qj dq_j + y_pj dp_j  +  y_s ds  +  dy.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from oed.arrays import Array, Mask
from oed.effect import Column, Effect, State
from oed.measurement import Measurement, Response, Series

#: signature below which a coefficient is taken to change nothing, against the noise
#: (both summed over the readings)
NOTHING = 1e-6

#: how the reason begins for which an effect cannot be tested where a covariate is
#: missing
LACKS = "the readings do not have "


@dataclasses.dataclass(frozen=True)
class Signature:
    """An effect's columns in the readings, at one set of constants.

    effect, constants    what it is of
    columns (N, k)       readings per standard deviation of each coefficient, SI
    names, labels (k,)   of the coefficients, and the blocks they belong to
    scales (k,)          prior standard deviations of the coefficients, in their own
                         units
    shape (k,)           which columns only let the form adapt
    textbook             prior share of the form without these
    """

    effect: str
    constants: Mapping[str, float]
    columns: Array
    names: tuple[str, ...]
    labels: tuple[str, ...]
    scales: Array
    shape: Mask
    textbook: float


def signature(
    effect: Effect,
    constants: Mapping[str, float],
    states: Sequence[State],
    responses: Sequence[Response],
    measurement: Measurement,
    series: Sequence[Series],
    sigma: Array | None = None,
    *,
    textbook: bool = False,
) -> Signature:
    """The effect's signature in the readings of all series, at its `constants`; sigma
    (N,): their noise, SI.

    textbook: without the columns that only let the form adapt
    """
    sizes = [r.nuisances.shape[0] * r.nuisances.shape[1] for r in responses]
    ends = np.cumsum([0, *sizes])
    found: dict[str, Column] = {}
    values: dict[str, Array] = {}
    for k, (state, response, s) in enumerate(
        zip(states, responses, series, strict=True)
    ):
        for column in effect.columns(state, **constants):
            if textbook and column.shape:
                continue
            if column.name not in values:
                found[column.name], values[column.name] = column, np.zeros(ends[-1])
            values[column.name][ends[k] : ends[k + 1]] += column.scale * _read(
                column, response, measurement, s
            )
    sigma = measurement.sigma(series) if sigma is None else sigma
    kept = [n for n, v in values.items() if np.linalg.norm(v / sigma) > NOTHING]
    return Signature(
        effect=effect.name,
        constants=dict(constants),
        columns=(
            np.column_stack([values[n] for n in kept])
            if kept
            else np.zeros((ends[-1], 0))
        ),
        names=tuple(kept),
        labels=tuple(found[n].label for n in kept),
        scales=np.array([found[n].scale for n in kept]),
        shape=np.array([found[n].shape for n in kept], dtype=bool),
        textbook=effect.textbook,
    )


def _read(
    column: Column, response: Response, measurement: Measurement, series: Series
) -> Array:
    """Change (n channels,) of a series' readings per unit of a coefficient."""
    setup = measurement.setups[series.setup]
    total = np.zeros(response.nuisances.shape[:2])
    index = measurement.machine.index
    known = (
        {p.name for p in measurement.machine.parameters} if column.parameters else set()
    )
    for j, place in enumerate(series.index.T):
        for limb, change in column.joints.items():
            total += response.joints[j][:, :, limb] * change[place, None]
        for name, change in column.parameters.items():
            if name in known:
                total += response.parameters[j][:, :, index(name)] * change[place, None]
    read = series.index[:, 0]
    for k, nuisance in enumerate(setup.nuisances):
        if nuisance.name in column.nuisances:
            total += (
                response.nuisances[:, :, k]
                * column.nuisances[nuisance.name][read, None]
            )
    for k, channel in enumerate(setup.instrument.channels):
        for name in ("*", channel.name):
            if name in column.reading:
                total[:, k] += column.reading[name][read]
    return total.ravel()


def exact(
    measurement: Measurement,
    series: Sequence[Series],
    theta: Array,
    states: Sequence[State],
    acting: Iterable[tuple[Effect, Mapping[str, float], Mapping[str, float]]],
) -> Array:
    """Noise-free readings (N,) of a machine at theta (n,) with effects, through the
    exact closure.

    acting: (effect, its constants, coefficients by name as factors on their prior
    standard deviations).
    """
    acting = list(acting)
    parts = []
    for state, s in zip(states, series, strict=True):
        columns = [
            (c, factors[c.name])
            for effect, constants, factors in acting
            for c in effect.columns(state, **constants)
            if c.name in factors
        ]
        parts.append(_exact(measurement, s, theta, columns))
    return np.concatenate(parts)


def _exact(
    measurement: Measurement,
    series: Series,
    theta: Array,
    columns: list[tuple[Column, float]],
) -> Array:
    setup, machine = measurement.setups[series.setup], measurement.machine
    joints, parameters = (
        np.zeros(series.q.shape),
        np.zeros((len(series.q), len(machine.parameters))),
    )
    nuisances = np.zeros((len(series), len(setup.nuisances)))
    direct = np.zeros((len(series), len(setup.instrument.channels)))
    known, read = {p.name for p in machine.parameters}, series.index[:, 0]
    for column, factor in columns:
        size = factor * column.scale
        for limb, change in column.joints.items():
            joints[:, limb] += size * change
        for name, change in column.parameters.items():
            if name in known:
                parameters[:, machine.index(name)] += size * change
        for k, nuisance in enumerate(setup.nuisances):
            if nuisance.name in column.nuisances:
                nuisances[:, k] += size * column.nuisances[nuisance.name][read]
        for k, channel in enumerate(setup.instrument.channels):
            for name in ("*", channel.name):
                if name in column.reading:
                    direct[:, k] += size * column.reading[name][read]
    return (
        measurement.moved(series, theta, joints, parameters, nuisances) + direct.ravel()
    )


def untestable(effect: Effect, states: Sequence[State]) -> str | None:
    """Why these readings cannot test an effect: what is missing, in words; None where
    they can.
    """
    reason = effect.unfit(states[0].machine)
    if reason is not None:
        return reason
    missing = [
        need
        for need in effect.needs
        if not any(_there(part.strip(), states) for part in need.split(" or "))
    ]
    return LACKS + ", ".join(missing) if missing else None


def _there(need: str, states: Sequence[State]) -> bool:
    name, _, wanted = need.partition(":")
    if name.startswith("temp_"):
        return any(
            np.isfinite(
                s.temperature.get(name.removeprefix("temp_"), np.array([np.nan]))
            ).any()
            for s in states
        )
    values = np.concatenate([getattr(s, name) for s in states])
    values = values[np.isfinite(values)]
    if name == "time":
        return len(np.unique(values)) > 1
    least = re.search(r"\d+", wanted)
    number = 2 if wanted.strip() == "both" else int(least.group()) if least else 1
    return len(np.unique(np.round(values, 9))) >= number
