"""Another noise than stated: it is stated in another unit, or commands are rounded in the
file while the machine stood where finer numbers said.

Of rounding, each reading has an error more, its slope over the coordinate times a number
that is uniform over the step.
"""

from collections.abc import Iterator
from functools import partial

import numpy as np
import scipy

from oed.base import Array, Mask
from oed.checks.mistakes.moved import commanded, pose_table, shifted
from oed.checks.mistakes.pose import RANGE_SLACK
from oed.checks.mistakes.suspect import Scope, Suspect
from oed.checks.mistakes.trial import (
    MistakeTrial,
    mistakes_of_scopes,
    mistakes_of_values,
    value_trial,
)
from oed.dataset import ReadingsColumn

DECIMALS = range(-1, 4)  #: decimals that a column has where it is rounded, from tens on
MIN_VALUES = 4  #: values of which a rounded column has more than so many
STEP_SHARE = 1e-3  #: share of a rounding step that is looked at for slopes
MIN_ROUNDING_ERROR = 3.0  #: error of rounding, over the noise, from which on it matters
ROUNDING_LOG_PRIOR = -2.0  #: log prior: most columns of whole numbers were driven so
#: noise over that which is stated: another unit, by SI unit
OTHER_NOISE = {"m": (1e3, 1e-3, 1e6, 1e-6), "rad": (3600.0, 1.0 / 3600.0, 1e3, 1e-3)}
#: level at which residuals depend on the pose, so that they are no noise
TREND_LEVEL = 1e-4
#: log prior of another unit: misfits of an effect look like noise as well
UNIT_LOG_PRIOR = -3.0


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Each column of whole numbers, or of few decimals, whose decimals were lost, and noise
    in another unit.
    """
    yield from noise_trials(data)
    measurement = data.session.measurement
    for k, (name, values) in enumerate(data.columns.items()):
        decimals = _decimals(values)
        if decimals is None:
            continue
        step = 10.0**-decimals
        change = shifted(k, STEP_SHARE * step * ReadingsColumn.parse(name).factor)
        table = pose_table(data, commanded(measurement, change, slack=RANGE_SLACK))
        if table is None:
            continue
        slope = np.nan_to_num(table.predicted - data.predicted) / STEP_SHARE
        error = np.abs(slope) / np.sqrt(12.0)
        if (error > MIN_ROUNDING_ERROR * data.sigma).any():
            text = f"{name}{{}} is rounded to {step:g}: finer numbers were driven"
            on = partial(_rounded, text, error)
            yield from mistakes_of_scopes(data.scopes, on)


def noise_trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Noise that is stated in another unit."""
    for si, factors in OTHER_NOISE.items():
        for factor in factors:
            yield from mistakes_of_values(data, partial(_other_noise, si, factor))


def _decimals(values: Array) -> int | None:
    """Decimals of a column (n,) in its unit; None where it has many, or few values."""
    if not np.isfinite(values).all() or len(np.unique(values)) <= MIN_VALUES:
        return None
    for decimals in DECIMALS:
        if np.allclose(values, np.round(values, decimals), rtol=0.0, atol=1e-9):
            return decimals
    return None


def _rounded(text: str, error: Array, scope: Scope) -> MistakeTrial:
    more = np.hypot(1.0, error / scope.data.sigma)
    factor = np.where(scope.values, more, 1.0)
    sentence = text.format(scope.within)
    return value_trial(
        scope, "rounded", sentence, noise=factor, log_prior=ROUNDING_LOG_PRIOR
    )


# -- noise -----------------------------------------------------------------------------
def _other_noise(si: str, factor: float, scope: Scope) -> MistakeTrial | None:
    """All readings of a unit with another noise than stated."""
    data, session, values = scope.data, scope.session, scope.values
    of_unit = data.shown & (data.unit == si)
    if scope.level != "file" or not np.array_equal(values, of_unit):
        return None
    if factor > 1.0 and _depends_on_pose(data, values, factor):
        return None
    stated = session.fine(scope.channels[0], float(np.median(data.sigma[values])))
    sentence = (
        f"the noise of {scope.columns} is stated in another unit: {factor:g} times"
        f" the {stated} that are stated explain the readings"
    )
    factors = np.where(values, factor, 1.0)
    return value_trial(
        scope, "noise", sentence, noise=factors, log_prior=UNIT_LOG_PRIOR
    )


def _depends_on_pose(data: Suspect, values: Mask, factor: float) -> bool:
    """F test: is what a fit leaves a second-order polynomial of the commands?"""
    base = data.bases(values).get("the nominal machine")
    if base is None:
        return False
    sigma = factor * data.sigma[values]
    white = data.slopes[values] / sigma[:, None]
    away = (data.session.y - base)[values] / sigma
    precision = np.eye(white.shape[1]) + white.T @ white
    residual = away - white @ np.linalg.solve(precision, white.T @ away)
    channels = data.channel[values]
    commands = data.command[data.session.reading_of_value[values]]
    return any(
        _trend_p_value(commands[of_channel], residual[of_channel]) < TREND_LEVEL
        for of_channel in (channels == name for name in dict.fromkeys(channels))
    )


def _trend_p_value(commands: Array, residual: Array) -> float:
    """p-value of a polynomial in commands (n, n_dof) as large as in residuals (n,)."""
    varied = commands[:, np.ptp(commands, axis=0) > 0.0]
    scaled = (varied - varied.mean(axis=0)) / np.maximum(varied.std(axis=0), 1e-300)
    i, j = np.triu_indices(scaled.shape[1])
    terms = np.column_stack([np.ones(len(scaled)), scaled, scaled[:, i] * scaled[:, j]])
    basis = np.linalg.svd(terms, full_matrices=False)[0][
        :, : np.linalg.matrix_rank(terms)
    ]
    freedom = len(residual) - basis.shape[1]
    if freedom < basis.shape[1]:
        return 1.0
    explained = float(np.sum((basis.T @ residual) ** 2))
    rest = float(residual @ residual) - explained
    ratio = explained / basis.shape[1] / max(rest / freedom, 1e-300)
    return float(scipy.special.fdtrc(basis.shape[1], freedom, ratio))
