"""Predicted accuracy of a machine compensated for parameters and effects.

The pose error of the compensated machine is A delta + E epsilon, with delta and epsilon
the errors of parameters and coefficients, jointly normal, and E the twist per
coefficient in the states of the session. Without the effects' compensation E beta_hat
stays as well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from oed import prediction
from oed.arrays import Array
from oed.compensate import error_model
from oed.correction.fit import CorrectedEstimate
from oed.effect import State
from oed.error_maps import ErrorMaps, Reference, error_maps
from oed.gap.data import state as states_of
from oed.measurement import Series
from oed.prediction import Prediction, Spread

if TYPE_CHECKING:
    import pandas as pd


@dataclasses.dataclass(frozen=True)
class CorrectedAccuracy:
    """Residual accuracy over workspace poses, in states drawn from the session.

    compensated      with parameters and effects compensated
    parameters_only  {component: Spread} with the effects left as they are
    """

    compensated: Prediction
    parameters_only: Mapping[str, Spread]


def predict_corrected(
    corrected: CorrectedEstimate,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    draws: Array | None = None,
) -> CorrectedAccuracy:
    """Predict the residual accuracy at commands (n, n_dof), SI.

    draws  (m, n_all) posterior draws of theta; the normal approximation by default
    """
    machine = corrected.readings.measurement.machine
    count, setups = len(machine.parameters), corrected.parameters
    state = _workspace_state(corrected, command, rng)
    maps = error_maps(corrected.readings.measurement.kinematics, command, reference)
    effect_maps = _effect_maps(corrected, state, command, reference)
    both = ErrorMaps(
        command=command,
        names=maps.names,
        raw=np.concatenate([maps.raw, effect_maps.raw], axis=2),
        remaining=np.concatenate([maps.remaining, effect_maps.remaining], axis=2),
    )
    theta = corrected.estimate.theta
    used = np.r_[0:count, setups : len(theta)]
    nominal = corrected.measurement.nominal
    mean, covariance = (theta - nominal)[used], corrected.estimate.covariance
    covariance = covariance[np.ix_(used, used)]
    changes = None
    if draws is not None:
        changes = (draws - theta)[:, used]
        covariance = changes.T @ changes / len(changes)
    tolerance = corrected.measurement.tolerance[used]

    def predicted(of: ErrorMaps) -> Prediction:
        return prediction.predict(
            of,
            np.diag(tolerance**2),
            covariance,
            rng,
            mean=mean,
            draws=changes,
            reference=reference,
        )

    compensated = predicted(both)
    effects_stay = np.concatenate([maps.remaining, effect_maps.raw], axis=2)
    uncorrected = predicted(dataclasses.replace(both, remaining=effects_stay))
    return CorrectedAccuracy(compensated, uncorrected.after)


def _workspace_state(
    corrected: CorrectedEstimate, command: Array, rng: np.random.Generator
) -> State:
    """The machine's state at commands, then at home, in drawn states of the session.

    At home the states are those of the session's first reading.
    """
    readings, session = corrected.readings, corrected.states[0]
    measurement = readings.measurement
    setup = corrected.series[0].setup
    home = measurement.machine.home_command[None]
    poses = np.vstack([command, home])
    tool = np.array(measurement.setups[setup].tool)
    x, q = measurement.kinematics.inverse(poses, None, tool)
    index = np.arange(len(poses))[:, None]
    run = np.array(["1"] * len(poses))
    series = Series(setup, q, x, poses, index, run)
    rows = readings.covariates.iloc[rng.integers(len(readings.covariates), size=len(q))]
    rows = rows.assign(run="1", order=np.arange(len(q), dtype=float))
    rows.iloc[-1] = _first_row(readings.covariates, rows)
    (state,) = states_of.states(
        measurement,
        (series,),
        rows.reset_index(drop=True),
        corrected.estimate.theta[: corrected.parameters],
        readings.gravity,
    )
    progress = state.session_progress
    low, high = session.session_span
    if np.isfinite(state.time).all() and high > low:
        progress = (state.time - low) / (high - low)
    return dataclasses.replace(
        state,
        session_progress=progress,
        max_payload=session.max_payload,
        session_times=session.session_times,
        start_temperature=session.start_temperature,
        joint_range=session.joint_range,
        session_span=session.session_span,
    )


def _first_row(covariates: pd.DataFrame, rows: pd.DataFrame) -> pd.Series:
    """The session's first reading, at the place of the last of `rows`."""
    first = covariates
    if "time" in covariates and covariates["time"].notna().any():
        first = covariates.sort_values("time")
    row = first.iloc[0].copy()
    row["run"], row["order"] = "1", rows["order"].iloc[-1]
    return row[rows.columns]


def _effect_maps(
    corrected: CorrectedEstimate, state: State, command: Array, reference: Reference
) -> ErrorMaps:
    """Pose errors per prior standard deviation of each coefficient (n, k, m)."""
    kinematics = corrected.readings.measurement.kinematics
    machine = kinematics.machine
    home = machine.home_command[None]
    model = error_model(kinematics, np.vstack([command, home]))
    tools = kinematics.frames(state.pose, np.zeros(3))[2]
    p = corrected.estimate.theta[: len(machine.parameters)]
    by_joint = tools @ kinematics.joint_sensitivity(state.pose, state.joints, p)
    raw, remaining = [], []
    for form in corrected.forms:
        columns = {c.name: c for c in form.effect.columns(state, **form.constants)}
        for name in form.signature.names:
            twist = np.zeros((len(state.pose), 6))
            fixed = np.zeros_like(twist)
            column = columns.get(name)
            if column is not None:
                for joint, change in column.joints.items():
                    twist += by_joint[:, :, joint] * change[:, None]
                for parameter, change in column.parameters.items():
                    if any(q.name == parameter for q in machine.parameters):
                        k = machine.index(parameter)
                        twist += model.raw[:, :, k] * change[:, None]
                        fixed += model.remaining[:, :, k] * change[:, None]
                twist, fixed = twist * column.scale, fixed * column.scale
            raw.append(twist)
            remaining.append(fixed)
    return error_maps(
        kinematics,
        command,
        reference,
        further=(np.stack(raw, axis=2), np.stack(remaining, axis=2)),
    )
