"""Linearisation residual: what the slopes miss of the exact model after a stage.

With errors d' left after a stage, the residual of reading i is

    r_i = y_i(d') - y_i(0) - h_i d'.

The machine is identified by the exact model, so r is not noise. It belongs to the same
few unknowns in all readings and disturbs only combinations of readings like it. The
best linear estimate under y = h d + r + e has the covariance

    S' = ( S^-1 + H^T (1 + C)^-1 H )^-1,        C = cov(r) over drawn errors, whitened.

So each drawn r, minus their mean, over sqrt(m - 1), is a column of readings with an
unknown N(0, 1), which is profiled out. A fit by the exact model is at least as good.
Taken as independent noise of each reading, r would count many times over.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.linear_algebra import symmetric_root
from oed.measurement import reading_covariances
from oed.planning.knowledge import multiply_each
from oed.planning.option import Option

#: share of a reading's noise below which its residual is neglected
NEGLIGIBLE = 0.02


@dataclasses.dataclass(frozen=True, eq=False)
class LinearisationResidual:
    """Residuals over drawn machines.

    rms      (readings,) over the machines that give the reading, SI; inf where none
             of them reaches the pose
    columns  (G, readings, m) whitened, for each pattern of captured candidates; None
             where all residuals are negligible
    """

    rms: Array
    columns: Array | None


def estimate_residual(
    option: Option,
    chosen: Index,
    posterior: Array,
    posterior_of: Index,
    patterns: Array,
    rng: np.random.Generator,
) -> LinearisationResidual:
    """Residuals of the chosen candidates (N), with machines drawn after the stage.

    posterior     (K, w, w) covariances of all unknowns after the stage
    posterior_of  (G x draws,) covariance of each machine to draw, pattern by pattern
    patterns      (G, N) captured candidates
    """
    measurement = option.measurement
    series = option.series_of(chosen)
    draws = len(posterior_of) // len(patterns)
    errors = _draw_errors(option, posterior, posterior_of, rng)
    candidate_of = np.repeat(np.arange(len(chosen)), reading_counts(option, chosen))
    captured = np.repeat(patterns[:, candidate_of] > 0.0, draws, axis=0)
    exact = measurement.try_readings(series, measurement.nominal + errors, captured)
    numbers = option.numbers_of(chosen)
    linear = option.nominal_readings[numbers] + errors @ option.slopes[numbers].T
    residual = exact - linear
    valid = captured & np.isfinite(residual)
    residual_or_zero = np.where(valid, residual, 0.0)
    count = np.maximum(valid.sum(axis=0), 1)
    mean_square = np.sum(residual_or_zero**2, axis=0) / count
    unreachable = captured.any(axis=0) & ~valid.any(axis=0)
    rms = np.where(unreachable, np.inf, np.sqrt(mean_square))
    if not (rms > NEGLIGIBLE * measurement.sigma(series)).any():
        return LinearisationResidual(rms, None)
    white = whiten(option, chosen, residual_or_zero)
    return LinearisationResidual(rms, _columns(white, len(patterns), draws))


def _draw_errors(
    option: Option, posterior: Array, posterior_of: Index, rng: np.random.Generator
) -> Array:
    """Parameter errors (machines, p), SI, of machines drawn after the stage."""
    measurement = option.measurement
    normals = rng.standard_normal((len(posterior_of), posterior.shape[1]))
    scaled = multiply_each(symmetric_root(posterior), posterior_of, normals)
    free = np.flatnonzero(measurement.free)
    errors = np.zeros((len(scaled), len(measurement.nominal)))
    of_parameters = scaled[:, option.parameter_columns]
    errors[:, free] = of_parameters * measurement.tolerance[free]
    return errors


def _columns(white: Array, patterns: int, draws: int) -> Array:
    """Columns (G, readings, m) from whitened residuals (G x draws, readings)."""
    by_pattern = white.reshape(patterns, draws, -1)
    deviation = by_pattern - by_pattern.mean(axis=1, keepdims=True)
    rows = deviation / np.sqrt(draws - 1.0)
    # only R^T R counts, so the triangle has no more rows than there are readings
    if draws > rows.shape[2]:
        rows = np.linalg.qr(rows, mode="r")
    return np.ascontiguousarray(np.swapaxes(rows, 1, 2))


def reading_counts(option: Option, chosen: Index) -> Index:
    """Numbers (N,) that each chosen candidate reads, over all its channels."""
    candidates = option.candidates
    setups = option.measurement.setups
    channels = np.array([len(setups[name].sigma) for name in candidates.setups])
    counts = candidates.members[chosen, 1] * channels[candidates.setup[chosen]]
    return np.asarray(counts)


def whitened_rows(option: Option, chosen: Index) -> Array:
    """Whitened slopes (readings, w) of the chosen candidates, in tolerance units.

    They are those of the candidates' blocks, one row for each number that is read.
    """
    measurement, candidates = option.measurement, option.candidates
    every_slope = option.slopes[option.numbers_of(chosen)]
    slopes = (every_slope * measurement.tolerance)[:, measurement.free]
    rows = np.zeros((len(slopes), option.unknowns))
    rows[:, option.parameter_columns] = whiten(option, chosen, slopes.T).T
    nuisances = candidates.nuisances
    if nuisances is not None:
        of_effects = nuisances.columns[option.numbers_of(chosen)]
        end = option.machine_columns
        rows[:, end - option.effects : end] = whiten(option, chosen, of_effects.T).T
    of_runs = candidates.shared_errors - option.effects
    if of_runs:
        # candidates are single readings, with rows of blocks
        counts = reading_counts(option, chosen)
        is_reading = np.arange(candidates.blocks.shape[1]) < counts[:, None]
        block_rows = candidates.blocks[chosen][is_reading]
        rows[:, -of_runs:] = block_rows[:, -of_runs:]
    return rows


def whiten(option: Option, chosen: Index, values: Array) -> Array:
    """Values (m, readings) whitened as the candidates' blocks are.

    Whole runs are whitened with the noise that their readings share, single readings
    with their independent noise.
    """
    measurement, series = option.measurement, option.series_of(chosen)
    weight = option.weight[option.numbers_of(chosen)]
    if (option.candidates.members[:, 1] > 1).any():
        return measurement.noise(series).whiten_last(values) * weight
    parts = []
    start = 0
    for s in series:
        root = np.linalg.cholesky(reading_covariances(measurement.of(s), s))
        n, k = root.shape[:2]
        part = values[:, start : start + n * k].reshape(-1, n, k)
        white = np.linalg.solve(root, part.transpose(1, 2, 0))
        parts.append(white.transpose(2, 0, 1).reshape(len(values), -1))
        start += n * k
    return np.hstack(parts) * weight
