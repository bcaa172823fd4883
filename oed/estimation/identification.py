"""Identification: a fit of the exact nonlinear readings, with tolerance priors.

Minimised is |W (y - f(theta))|^2 + |z|^2 over the identifiable coordinates z (see
`oed.estimation.coordinates`), where W whitens the noise. Where asked for, the noise law is
estimated from the readings too and integrated over (`oed.noise_law.marginal`): theta is the
mean over laws, its covariance holds what is not known of the noise.

Many machines at once, with known noise, are fitted over u, theta = nominal + T u, T the
root of the prior covariance. The minimum is the same: where the gradient is zero, u has no
part in the directions that no reading determines.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.estimation.coordinates import ReadingsProblem
from oed.estimation.discrepancy import Discrepancy
from oed.estimation.effects_stage import stage_with_effects
from oed.estimation.estimate import Estimate, add_warnings
from oed.estimation.fit_stages import (
    IdentificationError,
    ReadingsFit,
    last_stage,
    preliminary_stage,
)
from oed.estimation.fitter import PRECISION, minimise
from oed.estimation.law_stage import (
    integrated_stage,
)
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.noise import Noise


def identify(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
    estimate_noise: bool = False,
    noise: Noise | Array | None = None,
    start: Array | None = None,
    near: Estimate | None = None,
    max_iterations: int = 100,
    discrepancy: Discrepancy | None = None,
    rng: np.random.Generator | None = None,
) -> Estimate:
    """Fit all readings y (N,), SI.

    stages          patterns of parameter names, freed in turn ("dq*", then "*"). Stages
                    before the last only find a start: large errors of few parameters
                    are gone before the others are free. The tolerances hold about
                    nominal in all of them
    estimate_noise  estimate the noise law from the readings, and integrate over it;
                    otherwise the noise is as stated
    noise           of the readings; as stated by default
    start           (n,) where to begin; by default nominal, or as the controller holds
    near            an estimate of the same parameters from these readings, as with other
                    effects: its noise law is where that of this fit is sought from
    max_iterations  of each solution
    discrepancy     what effects that the model lacks can do to the readings. They are
                    integrated over with the noise law, which is then estimated
    rng             for their draws; a fixed seed by default

    Raises IdentificationError, and AssemblyError where the start cannot be assembled.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> deviations = (estimate.theta - truth) / estimate.sd
    >>> bool(np.abs(deviations[measurement.free]).max() < 4.0)
    True
    """
    fit = ReadingsFit(measurement, series, y, max_iterations)
    fit.check_readings()
    stated = measurement.noise(series) if noise is None else Noise.of(noise)
    theta = measurement.start if start is None else start
    residuals_before = residuals = fit.residuals(theta)
    try:
        done = []
        for patterns in stages[:-1]:
            theta, residuals, stage = preliminary_stage(
                fit, stated, theta, residuals, patterns
            )
            done.append(stage)
        if discrepancy is not None:
            rng = np.random.default_rng(0) if rng is None else rng
            estimate = stage_with_effects(
                fit, stated, theta, residuals, stages[-1], discrepancy, rng, near
            )
        elif estimate_noise:
            estimate = integrated_stage(fit, stated, theta, residuals, stages[-1], near)
        else:
            estimate = last_stage(fit, stated, theta, residuals, stages[-1])
    except AssemblyError as error:
        raise IdentificationError(
            "every reading has a pose at the start, and after a step of the fit"
            f" {error.indices.size} poses do not close; give smaller tolerances, or free"
            " fewer parameters in a stage before"
        ) from error
    except np.linalg.LinAlgError as error:
        raise IdentificationError(
            "the fit went where readings or their slopes are not finite; give smaller"
            " tolerances, or free fewer parameters in a stage before"
        ) from error
    estimate = dataclasses.replace(
        estimate,
        residuals_before=residuals_before,
        stages=(*done, *estimate.stages),
    )
    return add_warnings(measurement, estimate)


#: distance to the minimum, in posterior standard deviations, at which a stage before the
#: last ends: it finds a start
START_PRECISION = 0.1
#: entries of the slopes of all machines that are computed at once: 32 MB
BATCH_ENTRIES = 4_000_000


def fit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
) -> Array:
    """Parameters theta (m, n), SI, of m machines with readings y (m, N), SI.

    stages  patterns of parameter names, freed in turn, as in `identify`

    Raises IdentificationError where a machine cannot be fitted.
    """
    size = max(1, BATCH_ENTRIES // (y.shape[1] * len(measurement.parameters)))
    parts = [
        _fit_together(measurement, series, y[start : start + size], stages)
        for start in range(0, len(y), size)
    ]
    return np.vstack(parts)


def _fit_together(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    stages: Sequence[Sequence[str]],
) -> Array:
    noise = measurement.noise(series)
    theta = np.repeat(measurement.nominal[None], len(y), axis=0)
    converged = np.ones(len(y), dtype=bool)
    for k, patterns in enumerate(stages, 1):
        freed = measurement.freed(patterns)
        basis = measurement.prior_root(freed)[:, freed]
        origin = np.where(freed, measurement.nominal, theta)
        offset = (theta - origin)[:, freed]
        start = np.asarray(np.linalg.solve(basis[freed], offset.T).T, dtype=float)
        problem = ReadingsProblem(measurement, series, noise, y, origin, basis)
        precision = PRECISION if k == len(stages) else START_PRECISION
        minima = minimise(problem, start, precision=precision)
        theta = origin + minima.z @ basis.T
        converged &= minima.converged
    # a fit of its own says what is wrong
    for row in np.flatnonzero(~converged):
        theta[row] = identify(measurement, series, y[row], stages=stages).theta
    return theta
