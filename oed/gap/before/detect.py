"""Detectability of each effect by planned readings, and its separation from rivals.

With the metric M = (Sigma + H Lambda H^T)^-1, in which what calibration absorbs no
longer counts, and G_k the columns of effect k per prior standard deviation of each
coefficient, A_kl = G_k^T M G_l and

    lambda_k   = beta^T A_kk beta                                  (detectability),
    lambda_k|j = beta^T [A_kk - A_kj (A_jj + P)^-1 A_jk] beta      (separation from j).

A test with k columns finds lambda with the power of the noncentral chi-square. A
rival's textbook coefficients are as good as free (`ROOM` prior standard deviations), so
that size alone distinguishes no effects. Its columns that adapt the form keep their
prior; its constants have the most absorbing of their values. Source: Box and Hill 1967,
Atkinson and Fedorov 1975 (T-optimality); Bjorck and Golub 1973 (principal angles).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.effect import Effect
from oed.gap.before.confusion import SAME, effect_rival, indistinguishable
from oed.gap.before.detection import Detectability, Detection
from oed.gap.before.power import ideal_power, needed_lambda
from oed.gap.before.table import ROOM, Form, GramTable
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature
from oed.noise.law import NoiseLaw

#: sqrt(lambda_k|j) below which the two cannot be distinguished
SEPARATED = 5.0
#: draws from an effect's prior for its median least size
DRAWS = 400


def detect(
    problem: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    room: float = ROOM,
    threshold: float = SEPARATED,
) -> Detection:
    """What planned readings (`oed.gap.data.problem.assemble`) could find.

    room         prior standard deviations that a rival's textbook coefficients may go
                 to
    threshold    sqrt(lambda_k|j) below which two effects count as one class

    Raises ValueError for no effect, or effects of one name.
    """
    given = [effect.name for effect in effects]
    if not given or len(set(given)) < len(given):
        raise ValueError(f"give at least one effect, each once, not {given}")
    table = GramTable(problem, law, effects, room)
    names = tuple(table.forms)
    separation = np.zeros((len(names), len(names)))
    angles = np.zeros((len(names), len(names)))
    rows: dict[str, Detectability] = {}
    for k, name in enumerate(names):
        row = _row(problem, table, name, rng)
        separation[k, k] = row.detectability
        rivals = []
        for j, other in enumerate(names):
            if other != name:
                rival = effect_rival(table, name, other, threshold)
                separation[k, j], angles[k, j] = rival.separation, rival.angle
                rivals.append(rival)
        rivals.sort(key=lambda r: r.separation)
        rows[name] = dataclasses.replace(row, rivals=tuple(rivals))
    for name, why in table.refused.items():
        rows[name] = Detectability(effect=name, not_testable=why)
    visible = np.array([rows[name].visible for name in names], dtype=bool)
    classes, absorbed = indistinguishable(names, separation, visible, threshold)
    same = np.argwhere(np.triu(angles < SAME, 1))
    return Detection(
        effects=tuple(rows[name] for name in given),
        names=names,
        separation=separation,
        angles=angles,
        classes=classes,
        absorbed=absorbed,
        exact=tuple((names[k], names[j]) for k, j in same),
    )


def _row(
    problem: GapProblem,
    table: GramTable,
    name: str,
    rng: np.random.Generator,
) -> Detectability:
    """Detectability of one effect, without its rivals."""
    forms = table.forms[name]
    grams = [table.gram(form) for form in forms]
    traces = np.array([max(float(np.trace(gram)), 0.0) for gram in grams])
    columns = max(len(form.at) for form in forms)
    needed = needed_lambda(columns)
    spreads = {
        channel: [_spread(form.signature, rows) for form in forms]
        for channel, rows in _channels(problem).items()
    }
    median = _median_sizes(grams, spreads, needed, rng)
    signature, least = {}, {}
    for channel, by_form in spreads.items():
        mean_square = np.mean([np.trace(spread) for spread in by_form])
        signature[channel] = float(np.sqrt(mean_square))
        pairs = zip(by_form, grams, strict=True)
        least[channel] = min(_least_rms(*pair, needed) for pair in pairs)
    raw = np.maximum([form.raw for form in forms], 1e-300)
    mean = float(traces.mean())
    return Detectability(
        effect=name,
        columns=columns,
        detectability=float(np.sqrt(mean)),
        low=float(np.sqrt(traces.min())),
        high=float(np.sqrt(traces.max())),
        power=ideal_power(mean, columns),
        signature=signature,
        absorbed=float(1.0 - np.sqrt(np.mean(traces / raw))),
        least=least,
        median=median,
        sizes=_least_sizes(forms, grams, needed),
    )


def _channels(problem: GapProblem) -> dict[str, Index]:
    """Rows of each channel's readings."""
    rows = problem.rows.groupby("channel", sort=False).indices
    return {str(c): np.asarray(at, dtype=np.intp) for c, at in rows.items()}


def _spread(signature: Signature, rows: Index) -> Array:
    """S with beta^T S beta the mean square of a channel's readings, SI."""
    columns = signature.columns[rows]
    return np.asarray(columns.T @ columns / len(rows))


def _median_sizes(
    grams: Sequence[Array],
    spreads: dict[str, list[Array]],
    needed: float,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Root mean square, SI, that is found in each channel: median over the prior."""
    count = -(-DRAWS // len(grams))
    draws = [rng.standard_normal((len(gram), count)) for gram in grams]
    factors = []
    for gram, beta in zip(grams, draws, strict=True):
        lam = np.maximum(_quadratic(gram, beta), 1e-300)
        factors.append(np.sqrt(needed / lam))
    median = {}
    for channel, by_form in spreads.items():
        rms = []
        for factor, spread, beta in zip(factors, by_form, draws, strict=True):
            rms.append(factor * np.sqrt(_quadratic(spread, beta)))
        median[channel] = float(np.median(np.concatenate(rms)))
    return median


def _quadratic(matrix: Array, draws: Array) -> Array:
    """Quadratic forms (d,) of draws (k, d)."""
    forms = np.einsum("kd,kl,ld->d", draws, matrix, draws)
    return np.asarray(np.maximum(forms, 0.0))


def _least_rms(spread: Array, gram: Array, needed: float) -> float:
    """Smallest RMS over all combinations of coefficients with lambda = needed."""
    size = float(np.trace(spread))
    if size <= 0.0:
        return 0.0
    ridge = 1e-12 * size * np.eye(len(spread))
    best = linalg.eigh(gram, spread + ridge, eigvals_only=True)[-1]
    return float(np.sqrt(needed / best)) if best > 0.0 else float("inf")


def _least_sizes(
    forms: Sequence[Form],
    grams: Sequence[Array],
    needed: float,
) -> dict[str, float]:
    """Least size of each textbook coefficient alone, at its most visible constants."""
    least: dict[str, float] = {}
    for form, gram in zip(forms, grams, strict=True):
        signature = form.signature
        for k, name in enumerate(signature.names):
            if signature.shape[k]:
                continue
            lam, size = float(gram[k, k]), float("inf")
            if lam > 1e-12:
                size = (needed / lam) ** 0.5 * float(signature.scales[k])
            least[name] = min(size, least.get(name, float("inf")))
    return least
