"""Predicted accuracy of a machine compensated for parameters and effects.

The pose error of the compensated machine is A delta + E epsilon, with delta and epsilon
the errors of parameters and coefficients, jointly normal, and E the twist per
coefficient in the states of the session. Without the effects' compensation E beta_hat
stays as well.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from oed.accuracy import prediction
from oed.accuracy.budget import Budget, budget_model, budget_of
from oed.accuracy.maps import (
    ErrorMaps,
    Reference,
    controller_errors,
    error_maps,
)
from oed.accuracy.prediction import Prediction, Spread
from oed.base.arrays import Array, Index
from oed.compensate.effects.effect_maps import (
    ActingForm,
    SessionStates,
    effect_maps,
    workspace_state,
)
from oed.compensate.effects.fit import CorrectedEstimate
from oed.noise.law_noise import LawNoise


@dataclasses.dataclass(frozen=True)
class CorrectedAccuracy:
    """Residual accuracy over workspace poses, in states drawn from the session.

    compensated      with parameters and effects compensated
    parameters_only  {component: Spread} with the effects left as they are
    budget           sources of the errors that remain
    """

    compensated: Prediction
    parameters_only: Mapping[str, Spread]
    budget: Budget


def predict_corrected(
    corrected: CorrectedEstimate,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    draws: Array | None = None,
    worth: float | None = None,
) -> CorrectedAccuracy:
    """Predict the residual accuracy at commands (n, n_dof), SI.

    draws  (m, n_all) posterior draws of theta; the normal approximation by default
    worth  number of independent draws that these are worth; m by default
    """
    machine = corrected.readings.measurement.machine
    count, setups = len(machine.parameters), corrected.parameters
    kinematics = corrected.readings.measurement.kinematics
    maps = error_maps(kinematics, command, reference)
    of_effects = _effect_maps(corrected, command, reference, rng)
    both = ErrorMaps(
        command=command,
        names=maps.names,
        raw=np.concatenate([maps.raw, of_effects.raw], axis=2),
        remaining=np.concatenate([maps.remaining, of_effects.remaining], axis=2),
    )
    theta = corrected.estimate.theta
    used = np.r_[0:count, setups : len(theta)]
    nominal = corrected.measurement.drawn
    mean, covariance = (theta - nominal)[used], corrected.estimate.covariance
    covariance = covariance[np.ix_(used, used)]
    changes = None
    if draws is not None:
        changes = (draws - theta)[:, used]
        covariance = changes.T @ changes / len(changes)
    prior = corrected.measurement.prior_covariance[np.ix_(used, used)]
    before = None
    if kinematics.controller is not None:
        before = controller_errors(kinematics, command, theta[:count], reference)
        before = before + of_effects.raw @ mean[count:]

    compensated = prediction.predict(
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
    effects_stay = np.concatenate([maps.remaining, of_effects.raw], axis=2)
    uncorrected = dataclasses.replace(both, remaining=effects_stay)
    parameters_only = prediction.spread_after(
        uncorrected, covariance, rng, mean, changes, worth
    )
    budget = _budget(corrected, both, compensated, used)
    return CorrectedAccuracy(compensated, parameters_only, budget)


def _budget(
    corrected: CorrectedEstimate, maps: ErrorMaps, predicted: Prediction, used: Index
) -> Budget:
    """Sources of what remains, over the `used` entries of theta."""
    estimate = corrected.estimate
    noise = estimate.noise
    model = budget_model(
        corrected.measurement,
        corrected.series,
        estimate.theta,
        laws=noise.law if isinstance(noise, LawNoise) else None,
        coefficients=len(corrected.scales),
    )
    spreads = predicted.fully_corrected
    return budget_of(
        model,
        maps,
        estimated=estimate.covariance[np.ix_(used, used)],
        predicted=np.array([spreads[name].rms ** 2 for name in predicted.names]),
    )


def _effect_maps(
    corrected: CorrectedEstimate,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
) -> ErrorMaps:
    """Pose errors per prior standard deviation of each coefficient (n, k, m)."""
    readings = corrected.readings
    measurement = readings.measurement
    session = SessionStates(
        measurement, readings.covariates, corrected.states, readings.gravity
    )
    theta = corrected.estimate.theta[: corrected.parameters]
    state = workspace_state(session, theta, command, rng)
    forms = [
        ActingForm(f.effect, f.constants, f.signature.names) for f in corrected.forms
    ]
    parameters = theta[: len(measurement.machine.parameters)]
    kinematics = measurement.kinematics
    return effect_maps(kinematics, forms, state, parameters, command, reference)
