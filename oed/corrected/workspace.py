"""Predicted accuracy of a machine compensated for parameters and effects.

The pose error of the compensated machine is A delta + E epsilon, with delta and epsilon
the errors of parameters and coefficients, jointly normal, and E the twist per
coefficient in the states of the session. Without the effects' compensation E beta_hat
stays as well.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping

import numpy as np

from oed.accuracy import (
    Budget,
    ErrorMaps,
    Prediction,
    Reference,
    Spread,
    budget_model,
    driven_errors,
    error_maps,
    predict,
    spread_after,
)
from oed.base import Array, Index
from oed.corrected.fit import CorrectedEstimate
from oed.noise import LawNoise


@dataclasses.dataclass(frozen=True)
class CorrectedAccuracy:
    """Residual accuracy over workspace poses, in states drawn from the session.

    compensated      with parameters and effects compensated
    parameters_only  {component: Spread} with the effects left as they are
    plain            {component: Spread} with other parameters sent, the effects as they
                     are; empty where none are given
    budget           sources of the errors that remain
    """

    compensated: Prediction
    parameters_only: Mapping[str, Spread]
    plain: Mapping[str, Spread]
    budget: Budget


def predict_corrected(
    corrected: CorrectedEstimate,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    draws: Array | None = None,
    worth: float | None = None,
    plain: Array | None = None,
) -> CorrectedAccuracy:
    """Predict the residual accuracy at commands (n, n_dof), SI.

    draws  (m, n_all) posterior draws of theta; the normal approximation by default
    worth  number of independent draws that these are worth; m by default
    plain  (np,) other parameters to compare with, as those of a fit without effects
    """
    machine = corrected.readings.measurement.machine
    count, setups = len(machine.parameters), corrected.parameters
    kinematics = corrected.readings.measurement.kinematics
    maps = error_maps(kinematics, command, reference)
    theta = corrected.estimate.theta
    of_effects = corrected.columns.workspace_maps(
        corrected.session, theta[:setups], command, reference, rng
    )
    both = ErrorMaps(
        command=command,
        names=maps.names,
        raw=np.concatenate([maps.raw, of_effects.raw], axis=2),
        remaining=np.concatenate([maps.remaining, of_effects.remaining], axis=2),
    )
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
        before = driven_errors(kinematics, command, theta[:count], reference)
        before = before + of_effects.raw @ mean[count:]

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
    by_effects = of_effects.raw @ mean[count:]
    known_errors = maps.remaining @ mean[:count] + by_effects
    spreads = functools.partial(
        spread_after, both, covariance, rng, draws=changes, worth=worth
    )
    parameters_only, of_plain = spreads(known_errors), {}
    if plain is not None:
        change = (maps.raw - maps.remaining) @ (theta[:count] - plain)
        of_plain = spreads(known_errors + change)
    budget = _budget(corrected, both, compensated, used)
    return CorrectedAccuracy(compensated, parameters_only, of_plain, budget)


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
    return model.budget(
        maps,
        estimated=estimate.covariance[np.ix_(used, used)],
        predicted=np.array([spreads[name].rms ** 2 for name in predicted.names]),
    )
