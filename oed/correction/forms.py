"""Chooses each effect's constants and prior size by the evidence of the readings.

With prior N(0, 1) on the coefficients and a free noise level, the log evidence of
columns U is -1/2 log |A| - N/2 log(r^T M r - b^T A^-1 b), A = 1 + U^T M U, b = U^T M r;
M takes out what the machine's parameters can explain (`oed.gap.data.metric`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg

from oed.arrays import Array
from oed.effect import Effect
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature
from oed.noise.law import NoiseLaw

#: factors on an effect's prior standard deviations between which the readings choose
SIZES = (0.3, 1.0, 3.0)
#: constants beyond which textbook forms alone are scanned
LARGE_GRID = 64
#: passes over the effects
PASSES = 2


@dataclasses.dataclass(frozen=True)
class ChosenForm:
    """The form of an effect that suits the readings best.

    effect     the effect
    constants  {constant: value}
    size       factor on its prior standard deviations
    signature  change of the readings per prior standard deviation
    """

    effect: Effect
    constants: Mapping[str, float]
    size: float
    signature: Signature


def choose_forms(
    problem: GapProblem, effects: Sequence[Effect]
) -> tuple[ChosenForm, ...]:
    """The forms of effects that act together; effects that change nothing are absent."""
    evidence = form_evidence(problem)
    chosen: dict[str, ChosenForm] = {}
    for _ in range(PASSES):
        for effect in effects:
            others = [f for name, f in chosen.items() if name != effect.name]
            best = _best_form(problem, evidence, effect, others)
            if best is not None:
                chosen[effect.name] = best
    return tuple(chosen.values())


def _best_form(
    problem: GapProblem,
    evidence: FormEvidence,
    effect: Effect,
    others: Sequence[ChosenForm],
) -> ChosenForm | None:
    """The form of one effect of highest evidence, next to others; None without any."""
    fixed = [problem.in_noise_units(f.signature.columns * f.size) for f in others]
    grid = effect.constant_grid()
    textbook = len(grid) > LARGE_GRID
    best, best_value = None, -np.inf
    for constants in grid:
        signature = problem.signature(effect, constants, textbook=textbook)
        if not signature.names:
            continue
        columns = problem.in_noise_units(signature.columns)
        for size in SIZES:
            both = np.hstack([*fixed, size * columns])
            value = evidence.log_evidence(both, problem.residual)
            if value > best_value:
                best_value = value
                best = ChosenForm(effect, constants, size, signature)
    if best is None or not textbook:
        return best
    adapted = problem.signature(effect, best.constants)
    return dataclasses.replace(best, signature=adapted)


@dataclasses.dataclass(frozen=True)
class FormEvidence:
    """Evidence of columns for a residual, the noise level profiled out."""

    metric: Metric

    def log_evidence(self, columns: Array, residual: Array) -> float:
        """Log evidence of columns (N, k) for a residual (N,), in noise units."""
        log_det, unexplained = self._solve(columns, residual)
        return -0.5 * log_det - 0.5 * len(residual) * float(np.log(unexplained))

    def unexplained(self, columns: Array, residual: Array) -> float:
        """Sum of squares that columns with their prior leave of a residual."""
        return self._solve(columns, residual)[1]

    def _solve(self, columns: Array, residual: Array) -> tuple[float, float]:
        metric = self.metric
        inner = metric.gram(columns, columns) + np.eye(columns.shape[1])
        b = metric.gram(columns, residual[:, None])[:, 0]
        total = float(metric.gram(residual[:, None], residual[:, None])[0, 0])
        root = linalg.cholesky(inner, lower=True)
        explained = float(np.sum(linalg.solve_triangular(root, b, lower=True) ** 2))
        log_det = 2.0 * float(np.log(np.diag(root)).sum())
        return log_det, max(total - explained, 1e-12 * total)


def form_evidence(problem: GapProblem) -> FormEvidence:
    """Evidence of columns under independent noise of the stated ratios."""
    law = NoiseLaw(
        run_sd=0.0, ar1_sd=0.0, ar1_length=1.0, variance=np.ones(len(problem))
    )
    return FormEvidence(Metric(problem, law))
