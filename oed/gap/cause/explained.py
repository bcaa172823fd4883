"""What the best hypothesis explains of the residual: coefficients, sizes, remainder."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import Size
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.noise.law import stated_law
from oed.result.gap import CoefficientRecord


@dataclasses.dataclass(frozen=True)
class Explained:
    """Parts of the residual, in units of the stated noise.

    coefficients    of the named effects
    sizes           of the named effects
    explained       (N,) by the named effects
    unexplained     (N,) by what else is in the hypothesis
    before          (N,) residuals of the calibration without the effects
    after           (N,) residuals of the calibration with the named effects, both fitted
                    by the stated noise, as an identification leaves them
    level           noise level
    """

    coefficients: tuple[CoefficientRecord, ...]
    sizes: tuple[Size, ...]
    explained: Array
    unexplained: Array
    before: Array
    after: Array
    level: float


def explain(
    problem: GapProblem,
    search: Search,
    h: Hypothesis,
    named: Collection[str],
) -> Explained:
    """Parts of the residual by a hypothesis.

    Effects that are not `named` count with what is unknown. `problem` has the
    residuals with their outliers, `search` without.
    """
    metric, library = Metric(problem, search.law), search.library
    residual, level = search.problem.residual, search.noise_level(h)
    columns = h.columns(library, search.processes)
    mean, covariance = _posterior(metric, columns, residual)
    by_effects = np.zeros(len(problem))
    coefficients: list[CoefficientRecord] = []
    sizes, start = [], 0
    stated = Metric(search.problem, stated_law(problem))
    forms = zip(h.effects, h.atoms, h.sizes, strict=True)
    for effect, atom, size in forms:
        rows = library.atoms[atom].columns
        at = slice(start, start + len(rows))
        start = at.stop
        if effect not in named:
            continue
        signal = library.scaled_columns(atom, size) @ mean[at]
        by_effects = by_effects + signal
        unit = size * library.scales[rows]
        sd = level * np.sqrt(np.diag(covariance)[at]) * unit
        coefficients += _coefficients(library, effect, rows, mean[at] * unit, sd)
        energy = float(metric.gram(signal[:, None], signal[:, None])[0, 0])
        detectability = float(np.sqrt(max(energy, 0.0))) / level
        rms = _rms_by_channel(problem, signal)
        remaining = _rms_by_channel(problem, _after_fit(problem, stated, signal))
        sizes.append(Size(effect, rms, remaining, detectability))
    outlying = problem.residual - residual
    corrected = residual - by_effects
    return Explained(
        coefficients=tuple(coefficients),
        sizes=tuple(sizes),
        explained=by_effects,
        unexplained=columns @ mean - by_effects,
        before=_after_fit(problem, stated, residual) + outlying,
        after=_after_fit(problem, stated, corrected) + outlying,
        level=level,
    )


def _posterior(
    metric: Metric,
    columns: Array,
    residual: Array,
) -> tuple[Array, Array]:
    """Mean (k,) and covariance (k, k) of coefficients of prior N(0, 1)."""
    precision = metric.gram(columns, columns) + np.eye(columns.shape[1])
    b = metric.gram(columns, residual[:, None])[:, 0]
    mean = np.asarray(np.linalg.solve(precision, b))
    return mean, np.asarray(linalg.inv(precision))


def _coefficients(
    library: Library,
    effect: str,
    rows: Index,
    means: Array,
    sds: Array,
) -> list[CoefficientRecord]:
    """Coefficients of an effect from their means (k,) and sds (k,)."""
    coefficients: list[CoefficientRecord] = []
    for c, mean, sd in zip(rows, means, sds, strict=True):
        name, label = library.names[c], library.labels[c]
        coefficients.append(
            CoefficientRecord(
                effect, name, label, float(mean), float(sd), unit="SI", prior_sd=None
            )
        )
    return coefficients


def _rms_by_channel(problem: GapProblem, signal: Array) -> dict[str, float]:
    """Root mean square, SI, of a change of the readings in each channel."""
    values = signal * problem.sigma
    channels: Sequence[str] = problem.rows["channel"].to_numpy()
    rms = {}
    for name in dict.fromkeys(channels):
        squares = values[channels == name] ** 2
        rms[str(name)] = float(np.sqrt(np.mean(squares)))
    return rms


def _after_fit(problem: GapProblem, metric: Metric, residual: Array) -> Array:
    """A residual (N,) less what the parameters explain when fitted to it."""
    return residual - problem.slopes @ metric.fit(residual)
