"""Change of the readings by an effect's coefficients: to first order, and exactly.

The signature of a coefficient is H delta p of its changes, summed over the poses that a
reading sees:

    G = sum_j y_qj dq_j + y_pj dp_j  +  y_s ds  +  dy.

The exact form serves virtual machines.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from oed.base import Array, Mask
from oed.effect_model import Column, Effect, State
from oed.measurement import Measurement, Response, Series

#: norm of a signature over all readings, in units of the noise, up to which a
#: coefficient changes nothing
NOTHING = 1e-6

#: start of the reason for which an effect cannot be tested where a covariate is missing
LACKS = "the readings do not have "


@dataclasses.dataclass(frozen=True)
class Signature:
    """An effect's columns in the readings, at one set of constants.

    effect       name of the effect
    constants    {constant: value}
    columns      (N, k) readings per standard deviation of each coefficient, SI
    names        (k,) of the coefficients
    labels       (k,) the blocks that they belong to
    scales       (k,) prior standard deviations of the coefficients, in their own units
    shape        (k,) which columns only let the form adapt
    textbook     prior share of the form without these
    """

    effect: str
    constants: Mapping[str, float]
    columns: Array
    names: tuple[str, ...]
    labels: tuple[str, ...]
    scales: Array
    shape: Mask
    textbook: float

    def take(self, chosen: Mask) -> Signature:
        """The signature of the chosen (k,) columns alone."""
        numbers = np.flatnonzero(chosen)
        return dataclasses.replace(
            self,
            columns=self.columns[:, numbers],
            names=tuple(self.names[k] for k in numbers),
            labels=tuple(self.labels[k] for k in numbers),
            scales=self.scales[numbers],
            shape=self.shape[numbers],
        )

    def columns_of(self, names: Sequence[str]) -> Array:
        """Columns (N, k) of some coefficients; 0 of those that change no reading."""
        columns = np.zeros((len(self.columns), len(names)))
        for k, name in enumerate(names):
            if name in self.names:
                columns[:, k] = self.columns[:, self.names.index(name)]
        return columns


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
    """The effect's signature in the readings of all series, at its `constants`.

    sigma       (N,) noise of the readings, SI; the measurement's by default
    textbook    leave out the columns that only let the form adapt
    """
    counts = [int(np.prod(response.nuisances.shape[:2])) for response in responses]
    ends = np.cumsum([0, *counts])
    columns: dict[str, Column] = {}
    values: dict[str, Array] = {}
    parts = zip(states, responses, series, strict=True)
    for k, (state, response, s) in enumerate(parts):
        rows = slice(ends[k], ends[k + 1])
        for column in effect.columns(state, **constants):
            if textbook and column.shape:
                continue
            name = column.name
            if name not in values:
                columns[name] = column
                values[name] = np.zeros(ends[-1])
            if columns[name].label != column.label:  # set-ups share it: it is of none
                columns[name] = dataclasses.replace(columns[name], label="")
            change = _read(column, response, measurement, s)
            values[name][rows] += column.scale * change
    sigma = measurement.sigma(series) if sigma is None else sigma
    names = [n for n, v in values.items() if np.linalg.norm(v / sigma) > NOTHING]
    table = np.array([values[n] for n in names]).reshape(len(names), ends[-1]).T
    return Signature(
        effect=effect.name,
        constants=dict(constants),
        columns=table,
        names=tuple(names),
        labels=tuple(columns[n].label for n in names),
        scales=np.array([columns[n].scale for n in names]),
        shape=np.array([columns[n].shape for n in names], dtype=bool),
        textbook=effect.textbook_share,
    )


def _read(
    column: Column,
    response: Response,
    measurement: Measurement,
    series: Series,
) -> Array:
    """Change (n channels,) of a series' readings per unit of a coefficient."""
    setup = measurement.setups[series.setup]
    total = np.zeros(response.nuisances.shape[:2])
    index = measurement.machine.index
    parameters = _known_parameters(column, measurement)
    for j, place in enumerate(series.index.T):
        for limb, change in column.joints.items():
            slopes = response.joints[j][:, :, limb]
            total += slopes * change[place, None]
        for name, change in parameters:
            slopes = response.parameters[j][:, :, index(name)]
            total += slopes * change[place, None]
    read = series.index[:, 0]
    for k, nuisance in enumerate(setup.nuisances):
        if nuisance.name in column.nuisances:
            shift = column.nuisances[nuisance.name][read, None]
            total += response.nuisances[:, :, k] * shift
    for k, change in _direct_changes(column, measurement, series):
        total[:, k] += change[read]
    return total.ravel()


def _known_parameters(
    column: Column,
    measurement: Measurement,
) -> list[tuple[str, Array]]:
    """Names and changes of the column's parameters that this machine has."""
    if not column.parameters:
        return []
    known = {p.name for p in measurement.machine.parameters}
    return [(n, change) for n, change in column.parameters.items() if n in known]


def _direct_changes(
    column: Column,
    measurement: Measurement,
    series: Series,
) -> Iterator[tuple[int, Array]]:
    """Numbers of the channels that a column changes directly, and the changes (m,)."""
    channels = measurement.setups[series.setup].instrument.channels
    for k, channel in enumerate(channels):
        for name in ("*", channel.name):
            if name in column.reading:
                yield k, column.reading[name]


def exact_readings(
    measurement: Measurement,
    series: Sequence[Series],
    theta: Array,
    states: Sequence[State],
    acting: Iterable[tuple[Effect, Mapping[str, float], Mapping[str, float]]],
) -> Array:
    """Noise-free readings (N,) of a machine with effects, through the exact closure.

    theta     (n,) parameters of the machine
    acting    for each effect its constants and its coefficients by name, as factors on
              their prior standard deviations
    """
    acting = list(acting)
    parts = []
    for state, s in zip(states, series, strict=True):
        columns = [
            (column, factors[column.name])
            for effect, constants, factors in acting
            for column in effect.columns(state, **constants)
            if column.name in factors
        ]
        parts.append(_exact_series(measurement, s, theta, columns))
    return np.concatenate(parts)


def _exact_series(
    measurement: Measurement,
    series: Series,
    theta: Array,
    columns: list[tuple[Column, float]],
) -> Array:
    """Noise-free readings of one series with columns at factors on their scales."""
    setup, machine = measurement.setups[series.setup], measurement.machine
    poses, count = len(series.q), len(series)
    joints = np.zeros(series.q.shape)
    parameters = np.zeros((poses, len(machine.parameters)))
    nuisances = np.zeros((count, len(setup.nuisances)))
    direct = np.zeros((count, len(setup.instrument.channels)))
    read = series.index[:, 0]
    for column, factor in columns:
        size = factor * column.scale
        for limb, change in column.joints.items():
            joints[:, limb] += size * change
        for name, change in _known_parameters(column, measurement):
            parameters[:, machine.index(name)] += size * change
        for k, nuisance in enumerate(setup.nuisances):
            if nuisance.name in column.nuisances:
                nuisances[:, k] += size * column.nuisances[nuisance.name][read]
        for k, change in _direct_changes(column, measurement, series):
            direct[:, k] += size * change[read]
    readings = measurement.of(series).perturbed(
        series, theta, joints, parameters, nuisances
    )
    return readings + direct.ravel()


def untestable(effect: Effect, states: Sequence[State]) -> str | None:
    """Why these readings cannot test an effect; None where they can.

    The reason is what is missing, in words.
    """
    reason = effect.unfit(states[0].machine)
    if reason is not None:
        return reason
    if not effect.is_offered([s.instrument for s in states]):
        return f"it is an error of {', '.join(effect.instruments)} alone"
    missing = [
        need
        for need in effect.needs
        if not any(_recorded(part.strip(), states) for part in need.split(" or "))
    ]
    return LACKS + ", ".join(missing) if missing else None


def _recorded(need: str, states: Sequence[State]) -> bool:
    """Whether a covariate is recorded with as many values as needed.

    A need states a number of distinct values, "both" for two, or none for one.
    """
    name, _, wanted = need.partition(":")
    if name.startswith("temp_"):
        body, unknown = name.removeprefix("temp_"), np.array([np.nan])
        values = np.concatenate([s.temperature.get(body, unknown) for s in states])
    else:
        values = np.concatenate([getattr(s, name) for s in states])
    values = values[np.isfinite(values)]
    if name == "time":
        return len(np.unique(values)) > 1
    largest = float(np.abs(values).max(initial=0.0))
    distinct = np.unique(np.round(values / (largest or 1.0), 9))
    number = re.search(r"\d+", wanted.replace("both", "2"))
    return len(distinct) >= (int(number.group()) if number else 1)
