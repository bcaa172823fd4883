"""Residuals of a calibration in units of their noise, with what it may still absorb."""

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from oed.base import Array, Index, Mask
from oed.effect_model import Column, Effect, State
from oed.estimation import identify
from oed.gap.data import state as states_of
from oed.measurement import Measurement, Response, Series, reading_structure
from oed.noise import Laws, NoiseLaw, NoiseStatement, ReadingStructure

# Change of the readings by an effect's coefficients: to first order, and exactly.
#
# The signature of a coefficient is H delta p of its changes, summed over the poses that a
# reading sees:
#
# G = sum_j y_qj dq_j + y_pj dp_j  +  y_s ds  +  dy.
#
# The exact form serves virtual machines.

#: norm of a signature over all readings, in units of the noise, up to which a
#: coefficient changes nothing
MIN_NORM = 1e-6

#: start of the reason for which an effect cannot be tested where a covariate is missing
LACKING = "the readings do not have "


@dataclasses.dataclass(frozen=True)
class Signature:
    """An effect's columns in the readings, at one set of constants."""

    effect: str  #: name of the effect
    constants: Mapping[str, float]  #: {constant: value}
    columns: Array  #: (N, k) readings per standard deviation of each coefficient, SI
    names: tuple[str, ...]  #: (k,) of the coefficients
    labels: tuple[str, ...]  #: (k,) the blocks that they belong to
    #: (k,) prior standard deviations of the coefficients, in their own units
    scales: Array
    shape: Mask  #: (k,) which columns only let the form adapt
    textbook: float  #: prior share of the form without these

    def take(self, chosen: Mask) -> "Signature":
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

    @property
    def kinds(self) -> dict[str, list[int]]:
        """Columns by their names without the limb's."""
        kinds: dict[str, list[int]] = {}
        for k, (name, label) in enumerate(zip(self.names, self.labels, strict=True)):
            kinds.setdefault(name.removeprefix(label).strip(), []).append(k)
        return kinds

    def columns_of(self, names: Sequence[str]) -> Array:
        """Columns (N, k) of some coefficients; 0 of those that change no reading."""
        columns = np.zeros((len(self.columns), len(names)))
        for k, name in enumerate(names):
            if name in self.names:
                columns[:, k] = self.columns[:, self.names.index(name)]
        return columns


def _read(
    column: Column, response: Response, measurement: Measurement, series: Series
) -> Array:
    """Change (n channels,) of a series' readings per unit of a coefficient."""
    setup = measurement.setups[series.setup]
    total = np.zeros(response.nuisances.shape[:2])
    index = measurement.machine.index
    parameters = _known_parameters(column, measurement)
    for j, pose in enumerate(series.index.T):
        for limb, change in column.joints.items():
            slopes = response.joints[j][:, :, limb]
            total += slopes * change[pose, None]
        for name, change in parameters:
            slopes = response.parameters[j][:, :, index(name)]
            total += slopes * change[pose, None]
    read = series.index[:, 0]
    for k, nuisance in enumerate(setup.nuisances):
        if nuisance.name in column.nuisances:
            shift = column.nuisances[nuisance.name][read, None]
            total += response.nuisances[:, :, k] * shift
    for k, change in _direct_changes(column, measurement, series):
        total[:, k] += change[read]
    return total.ravel()


def _known_parameters(
    column: Column, measurement: Measurement
) -> list[tuple[str, Array]]:
    """Names and changes of the column's parameters that this machine has."""
    if not column.parameters:
        return []
    names = {p.name for p in measurement.machine.parameters}
    return [(n, change) for n, change in column.parameters.items() if n in names]


def _direct_changes(
    column: Column, measurement: Measurement, series: Series
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
    """Noise-free readings (N,) of a machine theta (n,) through the exact closure, with
    the constants of acting effects and coefficients as factors on prior sd.
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
    """What these readings lack to test an effect, in words; None where they can."""
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
    return LACKING + ", ".join(missing) if missing else None


def covariate(need: str) -> str:
    """The covariate that a need of an effect, or several in words, names first."""
    return re.split(r":| or ", need)[0]


def _recorded(need: str, states: Sequence[State]) -> bool:
    """Whether a covariate has as many values as needed: a number, "both" or any."""
    name, _, count = need.partition(":")
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
    number = re.search(r"\d+", count.replace("both", "2"))
    return len(distinct) >= (int(number.group()) if number else 1)


@dataclasses.dataclass(frozen=True, kw_only=True)
class GapProblem:
    """N readings in units of their stated noise, and the n parameters that absorb."""

    #: how the readings hang together, in these units; each channel of an instrument has
    #: a noise of its own, whatever set-up it is in
    structure: ReadingStructure
    measurement: Measurement  #: what was fitted
    series: tuple[Series, ...]  #: the readings' series
    covariates: pd.DataFrame  #: one row a reading of the series, as in a Dataset
    y: Array  #: (N,) the readings, SI
    gravity: tuple[float, float, float]  #: its direction in the base frame
    theta: Array  #: (n_all,) fitted parameters, SI
    states: tuple[State, ...]  #: the machine's state, one a series
    responses: tuple[Response, ...]  #: slopes of the readings, one a series
    sigma: Array  #: (N,) stated noise, SI
    residual: Array  #: (N,) r over sigma
    #: (N, n) H over sigma, per prior standard deviation of each parameter
    slopes: Array
    names: tuple[str, ...]  #: (n,) of those parameters
    #: one row a reading of a channel: setup, run, order, channel, covariates, phase
    rows: pd.DataFrame

    def __len__(self) -> int:
        return len(self.residual)

    @property
    def members(self) -> tuple[Index, ...]:
        """Readings of each run."""
        return self.structure.members

    @property
    def channel(self) -> Index:
        """Instrument channel (N,) of each reading."""
        return self.structure.group

    @property
    def statement(self) -> NoiseStatement:
        """What is stated of the noise."""
        return self.structure.statement

    @property
    def stated_law(self) -> NoiseLaw:
        """The law that is stated."""
        return NoiseLaw(Laws.stated(self.structure))

    def signature(
        self, effect: Effect, constants: Mapping[str, float], *, textbook: bool = False
    ) -> Signature:
        """The effect's signature in the readings of all series, at its constants, SI;
        `textbook` without the columns that only let the form adapt.
        """
        series, responses = self.series, self.responses
        counts = [int(np.prod(response.nuisances.shape[:2])) for response in responses]
        ends = np.cumsum([0, *counts])
        columns: dict[str, Column] = {}
        values: dict[str, Array] = {}
        parts = zip(self.states, responses, series, strict=True)
        for k, (state, response, s) in enumerate(parts):
            rows = slice(ends[k], ends[k + 1])
            for column in effect.columns(state, **constants):
                if textbook and column.shape:
                    continue
                name = column.name
                if name not in values:
                    columns[name] = column
                    values[name] = np.zeros(ends[-1])
                if (
                    columns[name].label != column.label
                ):  # set-ups share it: it is of none
                    columns[name] = dataclasses.replace(columns[name], label="")
                change = _read(column, response, self.measurement, s)
                values[name][rows] += column.scale * change
        names = [
            n for n, v in values.items() if np.linalg.norm(v / self.sigma) > MIN_NORM
        ]
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

    def noise_units(self, values: Array) -> Array:
        """Changes of the readings (N, ...), SI, in units of their stated noise."""
        trailing = [1] * (values.ndim - 1)
        return values / self.sigma.reshape(-1, *trailing)

    def about(self, theta: Array) -> "GapProblem":
        """The same readings at other parameters (n_all,), SI. Raises AssemblyError."""
        return self._assembled(theta, self.covariates)

    def with_covariates(self, covariates: pd.DataFrame) -> "GapProblem":
        """The same readings with other covariates, one row a reading of the series."""
        return self._assembled(self.theta, covariates)

    def with_reversed_runs(self) -> "GapProblem":
        """The same readings with the order of each run counted from its end."""
        return self.with_covariates(reversed_runs(self.covariates))

    def _assembled(self, theta: Array, covariates: pd.DataFrame) -> "GapProblem":
        series, y, gravity = self.series, self.y, self.gravity
        return assemble(self.measurement, series, covariates, theta, y, gravity=gravity)

    def with_residual(self, residual: Array) -> "GapProblem":
        """The same readings with other residuals (N,), in units of the stated noise."""
        return dataclasses.replace(self, residual=residual)


def prepare(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    covariates: pd.DataFrame,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
) -> GapProblem:
    """Fit the calibration to readings y (N,), SI, and assemble its residuals.

    `covariates` has one row a reading of the series, as in a Dataset: set-up, run and
    order, and direction, time, feed, payload and temperatures where they are known.
    Raises IdentificationError.

    >>> import numpy as np
    >>> import pandas as pd
    >>> from oed import Measurement, mount
    >>> from oed.gap import prepare
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> covariates = pd.DataFrame(
    ...     {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    ... )
    >>> problem = prepare(measurement, [series], y, covariates)
    >>> problem.residual.shape  # x, y and z of 25 readings, in units of the stated noise
    (75,)
    """
    series = tuple(series)
    theta = identify(measurement, series, y).theta
    return assemble(measurement, series, covariates, theta, y, gravity=gravity)


def assemble(
    measurement: Measurement,
    series: Sequence[Series],
    covariates: pd.DataFrame,
    theta: Array | None = None,
    y: Array | None = None,
    *,
    gravity: tuple[float, float, float] = states_of.DOWN,
) -> GapProblem:
    """The problem of readings y (N,) at parameters theta (n,).

    Parameters are nominal by default; without y the readings are only planned, and
    their residuals are 0.
    """
    series = tuple(s.separate_poses() for s in series)
    theta = measurement.nominal if theta is None else theta
    jacobian = measurement.jacobian(series, theta)
    y = measurement.readings(series, theta) if y is None else y
    sigma = measurement.sigma(series)
    free = np.flatnonzero(measurement.free)
    off_nominal = jacobian @ (theta - measurement.nominal)
    residual = y - measurement.readings(series, theta) + off_nominal
    states = tuple(states_of.states(measurement, series, covariates, theta, gravity))
    rows = _rows(measurement, series, covariates, states)
    return GapProblem(
        measurement=measurement,
        series=series,
        covariates=covariates,
        y=y,
        gravity=gravity,
        theta=theta,
        states=states,
        responses=tuple(measurement.of(s).response(s, theta) for s in series),
        sigma=sigma,
        residual=residual / sigma,
        slopes=measurement.in_prior_units(jacobian)[:, free] / sigma[:, None],
        names=tuple(measurement.names[k] for k in free),
        structure=_structure(measurement, series, theta, rows).rescaled(sigma),
        rows=rows,
    )


def _structure(
    measurement: Measurement,
    series: tuple[Series, ...],
    theta: Array,
    rows: pd.DataFrame,
) -> ReadingStructure:
    """Structure of the readings: by the order of their rows, without a course."""
    structure = reading_structure(measurement, series, theta)
    group, names = pd.factorize(rows["instrument"] + "." + rows["channel"])
    return dataclasses.replace(
        structure,
        names=tuple(names),
        group=group.astype(np.intp),
        position=rows["order"].to_numpy(dtype=float),
        course=np.zeros((len(group), 0)),
    )


def _rows(
    measurement: Measurement,
    series: tuple[Series, ...],
    covariates: pd.DataFrame,
    states: Sequence[State],
) -> pd.DataFrame:
    """One row a reading of a channel, in the order of y."""
    parts = []
    start = 0
    for s, state in zip(series, states, strict=True):
        stop = start + len(s)
        rows = covariates.iloc[start:stop].reset_index(drop=True)
        start = stop
        instrument = measurement.setups[s.setup].instrument
        rows = rows.assign(
            instrument=instrument.name,
            phase=state.phase[s.index[:, 0]],
            reading=np.arange(len(s)),
        )
        channels = [c.name for c in instrument.channels]
        repeated = rows.index.repeat(len(channels))
        table = rows.loc[repeated].reset_index(drop=True)
        parts.append(table.assign(channel=np.tile(channels, len(s))))
    return pd.concat(parts, ignore_index=True)


def reversed_runs(covariates: pd.DataFrame) -> pd.DataFrame:
    """The rows with the order of each run counted from its end."""
    orders = covariates.groupby(["setup", "run"], sort=False)["order"]
    ends = orders.transform("min") + orders.transform("max")
    return covariates.assign(order=ends - covariates["order"])


# Inner products of changes of the readings, less what the parameters absorb.
class Metric:
    """Inner products <u, v> = u^T M v with M = (Sigma + H Lambda H^T)^-1.

    u, v are (N, k) changes of the readings in units of the stated noise.
    """

    def __init__(
        self, problem: GapProblem, law: NoiseLaw, rows: Index | None = None
    ) -> None:
        """Factor M for the readings `rows`; vectors still have all N readings."""
        factor = law.factor(problem.structure, rows)
        self._slopes = problem.slopes
        self.size = len(factor.order)
        #: root of Sigma + H Lambda H^T, and the log of its determinant
        self.root = factor.widened(problem.slopes)
        self.log_det = self.root.log_det
        #: vectors s (N, k) of values u (N, k) with <u, v> = s_u^T s_v
        self.scores = self.root.whiten
        #: M Y (N, k), for values Y (N, k)
        self.precision = self.root.precision
        #: whitened values (N, k) less what the parameters absorb of them; what they
        #: absorb almost whole keeps its digits
        self.remaining = self.root.remaining

    def whiten(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened by the noise alone, run after run."""
        if values.ndim == 1:
            return self.root.alone.whiten(values[:, None])[:, 0]
        return self.root.alone.whiten(values)

    def fit(self, values: Array) -> Array:
        """Parameters (n,) or (n, k), in prior sd, that explain values (N,) or (N, k)."""
        columns = values[:, None] if values.ndim == 1 else values
        root, sizes = self.root, self.root.sizes[:, None]
        along = root.axes.T @ self.whiten(columns)
        fitted = root.turn.T @ (sizes / (1.0 + sizes**2) * along)
        return np.asarray(fitted[:, 0] if values.ndim == 1 else fitted)

    def fit_remainder(self, values: Array) -> Array:
        """Values (N,) less what the parameters explain when fitted to them."""
        return values - self._slopes @ self.fit(values)

    def gram(self, u: Array, v: Array) -> Array:
        """Inner products (k, l) of (N, k) and (N, l)."""
        return self.scores(u).T @ self.scores(v)

    def posterior(self, columns: Array, values: Array) -> tuple[Array, Array]:
        """Mean (k,) and precision (k, k) of coefficients of prior N(0, 1).

        They are of columns (N, k) that explain values (N,) with the parameters.
        """
        scores = self.scores(columns)
        precision = scores.T @ scores + np.eye(columns.shape[1])
        b = scores.T @ self.scores(values[:, None])[:, 0]
        return np.asarray(np.linalg.solve(precision, b)), precision
