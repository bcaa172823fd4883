"""Parameters and effects, estimated together: accuracy, tables for a controller, senses of runs.

The pose error of the compensated machine is A delta + E epsilon, with delta and epsilon
the errors of parameters and coefficients, jointly normal, and E the twist per
coefficient in the states of the session. Without the effects' compensation E beta_hat
stays as well.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed.accuracy import (
    Budget,
    BudgetModel,
    ErrorMaps,
    Prediction,
    Reference,
    Spread,
    driven_errors,
    predict,
    spread_after,
)
from oed.base import Array, Index, Mask
from oed.corrected.forms import ChosenForm, FormEvidence
from oed.effect_model import State
from oed.effects import ExpectedColumns, SessionStates
from oed.estimation import Discrepancy, Estimate
from oed.gap import GapProblem
from oed.measurement import Series
from oed.mechanism import ErrorModel
from oed.noise import LawNoise

if TYPE_CHECKING:
    from oed.corrected.fit import EffectReadings, MeasurementWithEffects

SEPARATOR = ": "  #: name of a coefficient in theta: `effect: coefficient`


@dataclasses.dataclass(frozen=True)
class CorrectedEstimate:
    """Parameters and effects, estimated together."""

    readings: EffectReadings  #: what was fitted
    #: with the effects' coefficients at the end of theta
    measurement: MeasurementWithEffects
    series: tuple[Series, ...]  #: the readings' series, each reading with its pose
    #: of theta = [parameters, coefficients]; a coefficient is in prior standard
    #: deviations of its effect
    estimate: Estimate
    forms: tuple[ChosenForm, ...]  #: of the effects, with their constants
    #: (k,) prior standard deviations of the coefficients, in their own units
    scales: Array
    states: tuple[State, ...]  #: of the machine, one a series

    @property
    def parameters(self) -> int:
        """Number of leading entries of theta that are not coefficients."""
        return len(self.estimate.theta) - len(self.scales)

    @property
    def session(self) -> SessionStates:
        """States in which the readings were taken."""
        of = self.readings
        return SessionStates(of.measurement, of.covariates, self.states, of.gravity)

    @property
    def coefficient_names(self) -> tuple[str, ...]:
        """Names (k,) of the coefficients, `effect: coefficient`."""
        return self.measurement.names[self.parameters :]

    @property
    def columns(self) -> ExpectedColumns:
        """Effects in the forms of the fit, one column a coefficient."""
        count = len(self.scales)
        discrepancy = Discrepancy(
            columns=np.hstack([form.signature.columns for form in self.forms]),
            group=np.arange(count, dtype=np.intp),
            names=self.coefficient_names,
            unknown=np.zeros(count, dtype=bool),
        )
        return ExpectedColumns(discrepancy, self.forms, np.eye(count))

    def moves_machine(self, form: ChosenForm) -> bool:
        """Whether an effect changes joints or parameters of the machine."""
        columns = [
            column
            for state in self.states
            for column in form.effect.columns(state, **form.constants)
        ]
        names_of_machine = {p.name for p in self.measurement.machine.parameters}
        joints = any(np.any(v) for c in columns for v in c.joints.values())
        return joints or any(
            n in names_of_machine for c in columns for n in c.parameters
        )

    def predict(
        self,
        command: Array,
        reference: Reference,
        rng: np.random.Generator,
        draws: Array | None = None,
        worth: float | None = None,
        plain: Array | None = None,
    ) -> CorrectedAccuracy:
        """Predict the residual accuracy at commands (n, n_dof), SI.

        draws  (m, n_all) of theta; the normal approximation by default, `worth` as many
        plain  (np,) other parameters to compare with, as those of a fit without effects
        """
        kinematics = self.readings.measurement.kinematics
        count = len(kinematics.machine.parameters)
        setups = self.parameters
        maps = ErrorMaps.of(kinematics, command, reference)
        theta = self.estimate.theta
        of_effects = self.columns.workspace_maps(
            self.session, theta[:setups], command, reference, rng
        )
        both = ErrorMaps(
            command=command,
            names=maps.names,
            raw=np.concatenate([maps.raw, of_effects.raw], axis=2),
            remaining=np.concatenate([maps.remaining, of_effects.remaining], axis=2),
        )
        used = np.r_[0:count, setups : len(theta)]
        nominal = self.measurement.drawn
        mean, covariance = (theta - nominal)[used], self.estimate.covariance
        covariance = covariance[np.ix_(used, used)]
        changes = None
        if draws is not None:
            changes = (draws - theta)[:, used]
            covariance = changes.T @ changes / len(changes)
        prior = self.measurement.prior_covariance[np.ix_(used, used)]
        by_effects = of_effects.raw @ mean[count:]
        before = None
        if kinematics.controller is not None:
            before = driven_errors(kinematics, command, theta[:count], reference)
            before = before + by_effects
        compensated = predict(
            both,
            prior,
            covariance,
            rng,
            mean=mean,
            before=before,
            draws=changes,
            worth=worth,
            reference=reference,
        )
        known_errors = maps.remaining @ mean[:count] + by_effects
        spreads = functools.partial(
            spread_after, both, covariance, rng, draws=changes, worth=worth
        )
        parameters_only = spreads(known_errors)
        of_plain = {}
        if plain is not None:
            change = (maps.raw - maps.remaining) @ (theta[:count] - plain)
            of_plain = spreads(known_errors + change)
        budget = self._budget(both, compensated, used)
        return CorrectedAccuracy(compensated, parameters_only, of_plain, budget)

    def _budget(self, maps: ErrorMaps, predicted: Prediction, used: Index) -> Budget:
        """Sources of what remains, over the `used` entries of theta."""
        estimate = self.estimate
        noise = estimate.noise
        model = BudgetModel.of(
            self.measurement,
            self.series,
            estimate.theta,
            laws=noise.law if isinstance(noise, LawNoise) else None,
            coefficients=len(self.scales),
        )
        spreads = predicted.fully_corrected
        return model.budget(
            maps,
            estimated=estimate.covariance[np.ix_(used, used)],
            predicted=np.array([spreads[name].rms ** 2 for name in predicted.names]),
        )

    def tables(self, command: Array) -> TabledEffects:
        """Tables of all effects at commands (n, n_dof), SI. Raises AssemblyError."""
        neutral = _neutral_state(self, command)
        model = ErrorModel.of(self.readings.measurement.kinematics, command)
        tables: list[StateTable] = []
        missing: dict[str, str] = {}
        for form in self.forms:
            name = form.effect.name
            rest = _correction(self, form, neutral, model)
            late = _correction(self, form, _late(neutral), model)
            of_effect = list(_tables_of(self, form, neutral, rest, model))
            every = [rest, late, *(table.joints for table in of_effect)]
            if not all(np.isfinite(joints).all() for joints in every):
                missing[name] = "it moves no joint of the machine in a known state"
                continue
            if np.abs(late - rest).max() > MIN_CORRECTION:
                missing[name] = "it follows the time of that session, not a state"
                continue
            if np.abs(rest).max() > MIN_CORRECTION:
                of_effect.append(StateTable(name, POSE, False, np.zeros(1), rest[None]))
            tables += of_effect
            if not of_effect:
                missing[name] = (
                    "it moves no joint of the machine, or follows the feed or tensions"
                )
        return TabledEffects(tuple(tables), missing)

    def turned_runs(self) -> TurnedRuns | None:
        """Runs that fit clearly better driven the other way; None: there are none."""
        as_stated = self.readings.problem(self.estimate.theta[: self.parameters])
        columns = _columns(as_stated, self)
        turned_columns = _columns(as_stated.with_reversed_runs(), self)
        change = turned_columns - columns
        felt = [k for k in as_stated.members if np.linalg.norm(change[k]) > MIN_CHANGE]
        if len(felt) < MIN_RUNS:
            return None
        search = _Search(FormEvidence(as_stated), columns, turned_columns, felt)
        turned = search.best()
        if turned.sum() > len(felt) / 2:
            turned = ~turned
        none = np.zeros(len(felt), dtype=bool)
        gain = search.value(turned) - search.value(none)
        if not turned.any() or gain < MIN_GAIN:
            return None
        firsts = [rows[0] for rows, is_one in zip(felt, turned, strict=True) if is_one]
        names = as_stated.rows.iloc[firsts]
        return TurnedRuns(
            runs=tuple(zip(names["setup"], names["run"], strict=True)),
            before=search.ratio(none),
            after=search.ratio(turned),
            gain=gain,
        )


@dataclasses.dataclass(frozen=True)
class CorrectedAccuracy:
    """Residual accuracy over workspace poses, in states drawn from the session."""

    compensated: Prediction  #: with parameters and effects compensated
    #: {component: Spread} with the effects left as they are
    parameters_only: Mapping[str, Spread]
    #: {component: Spread} with other parameters sent, the effects as they are; empty
    #: where none are given
    plain: Mapping[str, Spread]
    budget: Budget  #: sources of the errors that remain


# Tables of joint corrections by state, with which a controller corrects effects.
#
# In each state of an axis (direction of travel, temperature of a body, payload) an
# effect's estimated coefficients move joints by dq and parameters by dp. The controller
# adds -dq, and -(C X)^-1 C A dp for the parameters (Tian et al. 2016, Eq. 24). A
# correction is that of the state less that of the neutral one, which has a table of its
# own where it is not zero. The corrections of all tables add up.

POSE = "pose"  #: axis of what depends on the pose alone
DIRECTION = "direction"
PAYLOAD = "payload"
TEMPERATURE = "temp_"  #: beginning of the axis of a body's temperature
MIN_CORRECTION = 1e-10  #: corrections up to here, m or rad, are nothing


@dataclasses.dataclass(frozen=True, eq=False)
class StateTable:
    """Joint corrections of one effect over one state, SI."""

    effect: str  #: its name
    axis: str  #: `pose`, `direction`, `payload` or `temp_<body>`
    #: whether each joint's correction is read at that joint's own state
    joint_wise: bool
    values: Array  #: (s,) of the state; temperatures in K above the session's start
    joints: Array  #: (s, n, nq) to add to the joints at n commands

    @property
    def column(self) -> str:
        """Name of the state's column in a file: its axis, with the unit."""
        if self.axis == PAYLOAD:
            return f"{PAYLOAD}_N"
        return f"{self.axis}_C" if self.axis.startswith(TEMPERATURE) else self.axis


@dataclasses.dataclass(frozen=True)
class TabledEffects:
    """Tables of an estimate, and the effects that they do not hold."""

    tables: tuple[StateTable, ...]  #: over the same commands
    missing: Mapping[str, str]  #: {effect: why}

    def corrections(self, other: TabledEffects) -> Array:
        """Corrections (n, s, nq) of `other` in all states of these tables, in a row."""
        of = {(t.effect, t.axis): t.joints for t in other.tables}
        count = next(iter(of.values())).shape[1]
        states = []
        for table in self.tables:
            nothing = np.zeros((len(table.values), count, table.joints.shape[2]))
            states.append(of.get((table.effect, table.axis), nothing))
        return np.swapaxes(np.concatenate(states), 0, 1)

    def largest(self, errors: Array) -> list[Array]:
        """For each table the largest (k,) of errors (s, k) in all states over its own."""
        ends = np.cumsum([len(table.values) for table in self.tables])
        return [part.max(axis=0) for part in np.split(errors, ends[:-1])]


def _neutral_state(corrected: CorrectedEstimate, command: Array) -> State:
    """The machine at commands, at rest, without payload or tension, as warm as at first."""
    session = corrected.session
    theta = corrected.estimate.theta[: corrected.parameters]
    rng = np.random.default_rng(0)
    state = session.workspace_state(theta, command, rng, still=True)
    count, still = len(state), np.zeros_like(state.joints)
    started = np.full(count, session.states[0].session_span[0])
    return dataclasses.replace(
        state,
        motion_sign=still,
        travel_since_reversal=np.full_like(still, np.inf),
        rate=still,
        acceleration=still,
        direction=np.zeros(count),
        payload=np.zeros(count),
        tension=np.zeros_like(still),
        time=started,
        session_progress=np.zeros(count),
        temperature={
            body: np.full(count, start)
            for body, start in state.start_temperature.items()
        },
    )


def _late(state: State) -> State:
    """The same at the end of the session."""
    return dataclasses.replace(
        state,
        time=np.full(len(state), state.session_span[1]),
        session_progress=np.ones(len(state)),
    )


def _tables_of(
    corrected: CorrectedEstimate,
    form: ChosenForm,
    neutral: State,
    rest: Array,
    model: ErrorModel,
) -> Iterator[StateTable]:
    """The tables of one effect over each state that it depends on, or that is unknown."""
    for axis, values in _axes(corrected, neutral):
        states = [_with_state(neutral, axis, float(value)) for value in values]
        changes = [_correction(corrected, form, state, model) for state in states]
        joints = np.array(changes) - rest
        is_nothing = np.abs(joints).max() <= MIN_CORRECTION  # nor where it is NaN
        if not is_nothing:
            name = form.effect.name
            yield StateTable(name, axis, axis == DIRECTION, values, joints)


def _axes(corrected: CorrectedEstimate, state: State) -> Iterator[tuple[str, Array]]:
    """States of the session, and the values at which they are tabled."""
    yield DIRECTION, np.array([-1.0, 1.0])
    if state.max_payload > 0.0:
        yield PAYLOAD, np.array([0.0, state.max_payload])
    for body, start in state.start_temperature.items():
        indices = [
            s.temperature[body] for s in corrected.states if body in s.temperature
        ]
        rise = np.concatenate(indices) - start
        rise = rise[np.isfinite(rise)]
        if rise.size and np.ptp(rise) > 0.0:
            low, high = min(float(rise.min()), 0.0), max(float(rise.max()), 0.0)
            yield f"{TEMPERATURE}{body}", np.array([low, high])


def _with_state(state: State, axis: str, value: float) -> State:
    """The state with another value along an axis."""
    count = len(state)
    if axis == DIRECTION:
        return dataclasses.replace(
            state,
            motion_sign=np.full_like(state.joints, value),
            direction=np.full(count, value),
        )
    if axis == PAYLOAD:
        return dataclasses.replace(state, payload=np.full(count, value))
    body = axis.removeprefix(TEMPERATURE)
    warm = np.full(count, state.start_temperature[body] + value)
    return dataclasses.replace(state, temperature={**state.temperature, body: warm})


def _correction(
    corrected: CorrectedEstimate, form: ChosenForm, state: State, model: ErrorModel
) -> Array:
    """Joint corrections (n, nq) of one effect in a state; not finite where it is unknown."""
    values = corrected.estimate.theta[corrected.parameters :] * corrected.scales
    amounts = dict(zip(corrected.coefficient_names, values, strict=True))
    machine = corrected.readings.measurement.machine
    indices = {p.name: k for k, p in enumerate(machine.parameters)}
    total = np.zeros_like(state.joints[:-1])
    for column in form.effect.columns(state, **form.constants):
        name = f"{form.effect.name}{SEPARATOR}{column.name}"
        amount = amounts.get(name, 0.0)
        for joint, change in column.joints.items():
            total[:, joint] -= amount * change[:-1]
        for parameter, change in column.parameters.items():
            if parameter in indices:
                gradient = model.joints[:, :, indices[parameter]]
                total += amount * gradient * change[:-1, None]
    return total


# Runs that were driven the other way than their rows say, as far as readings can tell.
#
# Play and friction follow the sense of travel, which the order of a run's rows states.
# With U the columns of the effects and U' those of the same runs driven the other way, a
# set of turned runs takes its rows from U'. Sets are compared by the log evidence of their
# columns (`oed.corrected.forms`). All runs turned at once only change the sign of the
# effects, so the smaller of two complementary sets is reported.

MIN_GAIN = 20.0  #: least gain of the log evidence
#: least change of a run's columns by turning it, in units of the noise
MIN_CHANGE = 1.0
#: fewest runs with a sense: of one run alone, turning only changes the effects' sign
MIN_RUNS = 2


@dataclasses.dataclass(frozen=True)
class TurnedRuns:
    """Runs whose rows are in the opposite order of their travel."""

    runs: tuple[tuple[str, str], ...]  #: (set-up, run) of each
    #: residuals with the effects over the stated noise, of the readings as given
    before: float
    after: float  #: the same with these runs turned
    gain: float  #: of the log evidence


@dataclasses.dataclass(frozen=True)
class _Search:
    """Columns (N, k) of the runs as given and turned, in noise units."""

    evidence: FormEvidence
    as_stated: Array
    turned: Array
    runs: Sequence[Index]  #: (R,) readings of each run

    def value(self, turned: Mask) -> float:
        """Log evidence with some of the runs (R,) turned."""
        return self.evidence.log_evidence(self._columns(turned))

    def ratio(self, turned: Mask) -> float:
        """Residuals over the stated noise with some of the runs (R,) turned."""
        unexplained = self.evidence.unexplained(self._columns(turned))
        return float(np.sqrt(unexplained / len(self.evidence.residual)))

    def _columns(self, turned: Mask) -> Array:
        columns = self.as_stated.copy()
        for rows, is_turned in zip(self.runs, turned, strict=True):
            if is_turned:
                columns[rows] = self.turned[rows]
        return columns

    def best(self) -> Mask:
        """Turned runs (R,): the one that gains most is turned, until none does."""
        turned = np.zeros(len(self.runs), dtype=bool)
        value = self.value(turned)
        while True:
            changed = turned ^ np.eye(len(turned), dtype=bool)
            values = [self.value(one) for one in changed]
            k = int(np.argmax(values))
            if values[k] <= value + 1e-9:
                return turned
            turned, value = changed[k], values[k]


def _columns(problem: GapProblem, corrected: CorrectedEstimate) -> Array:
    """Columns (N, k) of the effects at their estimated sizes, in noise units."""
    parts = []
    for form in corrected.forms:
        signature = problem.signature(form.effect, form.constants)
        columns = signature.columns_of(form.names)
        parts.append(problem.noise_units(columns))
    sizes = corrected.measurement.tolerance[corrected.parameters :]
    return np.hstack(parts) * sizes
