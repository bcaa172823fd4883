"""Machines of the oracles with a warm leg, play and a stretched scale, for the corrected
model.

Each machine has geometry of its own, readings with noise, and one to three effects,
written here by hand; none comes from the toolkit's effects. Its controller then takes
the estimated parameters and effects, with temperature and direction known.
"""

import dataclasses

import numpy as np
import pandas as pd

from kernel.corrected_cases import FINE, MachineCase
from oed import compensate
from oed.compensate.effects.effect_maps import SessionStates, workspace_state
from oed.compensate.effects.fit import (
    CorrectedEstimate,
    EffectReadings,
    estimate_with_effects,
)
from oed.compensate.effects.workspace import predict_corrected
from oed.estimation.identification import identify
from oed.measurement.measurement import Series
from oed.model.effect import Column, Effect, State
from pkm_models.effects import backlash, encoder_scale, leg_thermal

#: expected sizes of the effects, by which machines draw theirs
PER_KELVIN, PLAY, SCALE = 11.5e-6, 10e-6, 50e-6
EFFECTS = (leg_thermal.effect, backlash.effect, encoder_scale.effect)
#: passes of each run to and fro, warmth reached, K, and in which time, s
PASSES, WARMTH, WARMING = 4, 4.0, 1500.0
SECONDS = 10.0
#: ends of a normal interval of 95 %
WIDTH = 1.959963985


@dataclasses.dataclass(frozen=True)
class Acting:
    """Effects of one machine: growth per kelvin, play and scale of each joint."""

    per_kelvin: np.ndarray
    play: np.ndarray
    scale: np.ndarray

    def drive(self, q: np.ndarray, warm: np.ndarray, sense: np.ndarray) -> np.ndarray:
        """True joints (n, nq) where the scales show q, warm by (n, nq) K."""
        return q * (1.0 + self.per_kelvin * warm + self.scale) - self.play * sense / 2


def draw_acting(
    joints: int, rng: np.random.Generator
) -> tuple[Acting, tuple[Effect, ...]]:
    """One to three effects, each on all joints, with sizes drawn from what is expected."""
    count = int(rng.integers(1, 4))
    chosen = sorted(rng.choice(3, count, replace=False).tolist())
    sizes = [np.zeros(joints) for _ in range(3)]
    for k in chosen:
        sizes[k] = (PER_KELVIN, PLAY, SCALE)[k] * rng.standard_normal(joints)
    return Acting(*sizes), tuple(EFFECTS[k] for k in chosen)


# -- the session -----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Session:
    """Readings as planned.

    rows    one row a reading
    warmth  (n, nq) of each leg, K
    sense   (n, nq) in which each joint last moved
    """

    series: Series
    rows: pd.DataFrame
    warmth: np.ndarray
    sense: np.ndarray


def planned(case: MachineCase) -> Session:
    """All runs to and fro while the legs warm up."""
    joints = len(case.measurement.machine.joints)
    commands, rows, warmth, senses, clock = [], [], [], [], 0.0
    for turn in range(PASSES):
        way = 1 if turn % 2 == 0 else -1
        for number, path in enumerate(case.paths):
            commands.append(path[::FINE][::way])
            senses.append(arrival(case, path, way)[::way])
            for k in range(len(commands[-1])):
                clock += SECONDS
                share = -np.expm1(-clock / WARMING)
                warm = WARMTH * share * np.linspace(1.0, 0.3, joints)
                warmth.append(warm)
                rows.append((f"{number}-{turn}", k, clock, way, *warm))
    names = ["run", "order", "time", "direction"]
    names += [f"temp_leg{k + 1}" for k in range(joints)]
    setup = next(iter(case.measurement.setups))
    table = pd.DataFrame(rows, columns=names).assign(setup=setup)
    labels = table["run"].tolist()
    series = case.measurement.series(setup, np.vstack(commands), labels)
    return Session(series.separate_poses(), table, np.array(warmth), np.vstack(senses))


def arrival(case: MachineCase, path: np.ndarray, way: int) -> np.ndarray:
    """Sense (n, nq) in which each joint arrives at the readings of a closed path.

    It is that of the last small step, so also where the joint turns back at a reading.
    """
    _, q = case.measurement.kinematics.inverse(path)
    return np.asarray(np.sign(q - np.roll(q, way, axis=0))[::FINE])


@dataclasses.dataclass(frozen=True)
class Outcome:
    """One machine: errors (m, k) realised, and their predicted standard deviations."""

    error: np.ndarray
    sd: np.ndarray


def textbook(effect: Effect) -> Effect:
    """The effect without the columns that let its form depart from the textbook's."""

    def columns(state: State, **constants: float) -> list[Column]:
        return [c for c in effect.columns(state, **constants) if not c.shape]

    return dataclasses.replace(effect, columns=columns)


def outcome(
    case: MachineCase, rng: np.random.Generator, *, free_form: bool = False
) -> Outcome:
    """Draw a machine, read it, estimate, compensate, and compare over the workspace.

    The machine's effects have the textbook's form; `free_form` lets the estimate doubt
    it.
    """
    m = case.measurement
    count = len(m.machine.parameters)
    session = planned(case)
    series = session.series
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    acting, effects = draw_acting(len(m.machine.joints), rng)
    if not free_form:
        effects = tuple(textbook(e) for e in effects)
    warm, sense = np.zeros_like(series.q), np.zeros_like(series.q)
    warm[series.index[:, 0]] = session.warmth  # a cup was taught cold and at rest
    sense[series.index[:, 0]] = session.sense
    driven = acting.drive(series.q, warm, sense)
    y = case.read(truth, series, driven)
    y = y + m.sigma([series]) * rng.standard_normal(len(y))
    plain = identify(m, [series], y)
    readings = EffectReadings(m, (series,), y, session.rows)
    corrected = estimate_with_effects(readings, effects, plain.theta)
    assert corrected is not None
    seed = int(rng.integers(2**31))
    drawn = np.random.default_rng(seed)
    predicted = predict_corrected(corrected, case.command, "absolute", drawn)
    compensated = predicted.compensated
    columns = [compensated.names.index(name) for name in case.components]
    believed = corrected.estimate.theta[:count]
    state = states_of_workspace(corrected, case.command, seed)
    wanted = compensate.compensated_joints(m.kinematics, case.command, believed)
    scales = wanted - believed_changes(corrected, state)
    reached = acting.drive(scales, warmth_of(state), state.motion_sign[:-1])
    error = case.errors(truth[:count], reached, case.command)
    return Outcome(error, compensated.sd_after[:, columns])


def states_of_workspace(
    corrected: CorrectedEstimate, command: np.ndarray, seed: int
) -> State:
    """The states that the prediction drew with the same seed; home comes last."""
    readings = corrected.readings
    session = SessionStates(
        readings.measurement, readings.covariates, corrected.states, readings.gravity
    )
    theta = corrected.estimate.theta[: corrected.parameters]
    return workspace_state(session, theta, command, np.random.default_rng(seed))


def warmth_of(state: State) -> np.ndarray:
    """Temperature (n, nq) of each leg, without home's."""
    legs = range(1, state.joints.shape[1] + 1)
    return np.column_stack([state.temperature[f"leg{k}"] for k in legs])[:-1]


def believed_changes(corrected: CorrectedEstimate, state: State) -> np.ndarray:
    """Changes (n, nq) of the joints by the effects as estimated, without home's."""
    values = corrected.estimate.theta[corrected.parameters :] * corrected.scales
    size = dict(zip(corrected.coefficient_names, values, strict=True))
    changes = np.zeros_like(state.joints)
    for form in corrected.forms:
        for column in form.effect.columns(state, **form.constants):
            amount = size.get(f"{form.effect.name}: {column.name}", 0.0)
            for joint, change in column.joints.items():
                changes[:, joint] += amount * change
    return changes[:-1]


@dataclasses.dataclass(frozen=True)
class Coverage:
    """Outcomes of machines, by component.

    error, sd  (machines, poses, k) realised errors, predicted standard deviations
    """

    components: tuple[str, ...]
    error: np.ndarray
    sd: np.ndarray

    @property
    def inside(self) -> np.ndarray:
        """Share (k,) of poses and machines inside their predicted 95 % bands."""
        return np.asarray(self._inside.mean(axis=0))

    @property
    def inside_error(self) -> np.ndarray:
        """Standard error (k,) of that share, over machines."""
        return _standard_error(self._inside)

    @property
    def ratio(self) -> np.ndarray:
        """Realised over predicted rms (k,)."""
        return np.asarray(np.sqrt(self._squares[0] / self._squares[1]))

    @property
    def ratio_error(self) -> np.ndarray:
        """Standard error (k,) of that ratio, over machines."""
        realised, predicted = self._squares
        of_machine = (self.error**2).mean(axis=1) - (
            (self.sd**2).mean(axis=1) * realised / predicted
        )
        return _standard_error(of_machine) / predicted / (2.0 * self.ratio)

    @property
    def _inside(self) -> np.ndarray:
        return (np.abs(self.error) <= WIDTH * self.sd).mean(axis=1)

    @property
    def _squares(self) -> tuple[np.ndarray, np.ndarray]:
        return (self.error**2).mean(axis=(0, 1)), (self.sd**2).mean(axis=(0, 1))


def _standard_error(values: np.ndarray) -> np.ndarray:
    """Of the mean over the first axis."""
    return np.asarray(values.std(axis=0, ddof=1) / np.sqrt(len(values)))


def coverage(
    case: MachineCase, machines: int, seed: int, *, free_form: bool = False
) -> Coverage:
    """Outcomes of so many machines; the first ones are the same for any number."""
    outcomes = [
        outcome(case, np.random.default_rng([seed, k]), free_form=free_form)
        for k in range(machines)
    ]
    error = np.array([o.error for o in outcomes])
    sd = np.array([o.sd for o in outcomes])
    return Coverage(case.components, error, sd)
