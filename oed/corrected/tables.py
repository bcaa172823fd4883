"""Tables of joint corrections by state, with which a controller corrects effects.

In each state of an axis (direction of travel, temperature of a body, payload) an
effect's estimated coefficients move joints by dq and parameters by dp. The controller
adds -dq, and -(C X)^-1 C A dp for the parameters (Tian et al. 2016, Eq. 24). A
correction is that of the state less that of the neutral one, which has a table of its
own where it is not zero. The corrections of all tables add up.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from oed.base import Array
from oed.corrected.fit import SEPARATOR, CorrectedEstimate
from oed.corrected.forms import ChosenForm
from oed.effect_model import State
from oed.mechanism import ErrorModel, error_model

#: axis of what depends on the pose alone
POSE = "pose"
DIRECTION = "direction"
PAYLOAD = "payload"
#: beginning of the axis of a body's temperature
TEMPERATURE = "temp_"
#: corrections up to here, m or rad, are nothing
MIN_CORRECTION = 1e-10


@dataclasses.dataclass(frozen=True, eq=False)
class StateTable:
    """Joint corrections of one effect over one state, SI.

    effect      its name
    axis        `pose`, `direction`, `payload` or `temp_<body>`
    joint_wise  whether each joint's correction is read at that joint's own state
    values      (s,) of the state; temperatures in K above the session's start
    joints      (s, n, nq) to add to the joints at n commands
    """

    effect: str
    axis: str
    joint_wise: bool
    values: Array
    joints: Array

    @property
    def column(self) -> str:
        """Name of the state's column in a file: its axis, with the unit."""
        if self.axis == PAYLOAD:
            return f"{PAYLOAD}_N"
        return f"{self.axis}_C" if self.axis.startswith(TEMPERATURE) else self.axis


@dataclasses.dataclass(frozen=True)
class TabledEffects:
    """Tables of an estimate, and the effects that they do not hold.

    tables   over the same commands
    missing  {effect: why}
    """

    tables: tuple[StateTable, ...]
    missing: Mapping[str, str]


def tabled_effects(corrected: CorrectedEstimate, command: Array) -> TabledEffects:
    """Tables of all effects at commands (n, n_dof), SI. Raises AssemblyError."""
    neutral = _neutral_state(corrected, command)
    kinematics = corrected.readings.measurement.kinematics
    model = error_model(kinematics, command)
    tables: list[StateTable] = []
    missing: dict[str, str] = {}
    for form in corrected.forms:
        name = form.effect.name
        rest = _correction(corrected, form, neutral, model)
        late = _correction(corrected, form, _late(neutral), model)
        of_effect = list(_tables_of(corrected, form, neutral, model))
        if rest is None or late is None or any(t is None for t in of_effect):
            missing[name] = "it moves no joint of the machine in a known state"
            continue
        if np.abs(late - rest).max() > MIN_CORRECTION:
            missing[name] = "it follows the time of that session, not a state"
            continue
        tables += [t for t in of_effect if t is not None]
        if np.abs(rest).max() > MIN_CORRECTION:
            tables.append(StateTable(name, POSE, False, np.zeros(1), rest[None]))
        if not any(t.effect == name for t in tables):
            missing[name] = (
                "it moves no joint of the machine, or follows the feed or tensions"
            )
    return TabledEffects(tuple(tables), missing)


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
    model: ErrorModel,
) -> Iterator[StateTable | None]:
    """The tables of one effect over each state that it depends on."""
    rest = _correction(corrected, form, neutral, model)
    for axis, values in _axes(corrected, neutral):
        joints = []
        for value in values:
            state = _with_state(neutral, axis, float(value))
            change = _correction(corrected, form, state, model)
            if change is None or rest is None:
                yield None
                return
            joints.append(change - rest)
        if np.abs(joints).max() > MIN_CORRECTION:
            wise = axis == DIRECTION
            name = form.effect.name
            yield StateTable(name, axis, wise, values, np.array(joints))


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
) -> Array | None:
    """Joint corrections (n, nq) of one effect in a state; None where it is unknown."""
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
    return total if np.isfinite(total).all() else None
