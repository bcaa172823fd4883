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

from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg

from oed import units
from oed.base import Array, Index
from oed.effect_model import Effect
from oed.gap.before.confusion import SAME, effect_rival, indistinguishable
from oed.gap.before.forms import Form, effect_forms
from oed.gap.before.power import FALSE_ALARM, needed_lambda, power
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement
from oed.noise import NoiseLaw
from oed.result import DetectabilityRecord, DetectabilityTable

#: draws from an effect's prior for its median least size
DRAWS = 400
#: sizes from here on are not given: nothing physical is so large
UNBOUNDED = 1e6


def detect(
    problem: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
    rng: np.random.Generator,
) -> DetectabilityTable:
    """What planned readings (`oed.gap.data.problem.assemble`) could find.

    Sizes of readings are in the fine unit of their channel (`fine_units`). Raises
    ValueError for no effect, or effects of one name.
    """
    given = [effect.name for effect in effects]
    if not given or len(set(given)) < len(given):
        raise ValueError(f"give at least one effect, each once, not {given}")
    forms = effect_forms(problem, effects)
    metric = Metric(problem, law)
    white = metric.whiten(forms.columns)
    remaining = metric.remaining(white)
    gram = remaining.T @ remaining
    records = []
    for effect in effects:
        if effect.name in forms.reasons:
            record = _untestable(effect, forms.reasons[effect.name])
        else:
            record = _record(problem, gram, white, effect, forms.by_effect, rng)
        records.append(record)
    testable = [record for record in records if record.not_testable is None]
    names = [record.name for record in testable]
    separation = np.diag([record.detectability for record in testable])
    angles = np.zeros_like(separation)
    for k, record in enumerate(testable):
        for rival in record.rivals:
            j = names.index(rival.name)
            separation[k, j], angles[k, j] = rival.separation, rival.angle_deg
    visible = np.array([record.visible for record in testable], dtype=bool)
    classes, absorbed = indistinguishable(names, separation, visible)
    same = np.argwhere(np.triu(angles < SAME, 1))
    return DetectabilityTable(
        readings=len(problem),
        effects=records,
        names=names,
        separation=separation.tolist(),
        angles_deg=angles.tolist(),
        classes=classes,
        absorbed=absorbed,
        exact=[[names[k], names[j]] for k, j in same],
    )


def fine_units(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel, in which the sizes of readings are given."""
    fine: dict[str, str] = {}
    for setup in measurement.setups.values():
        fine |= {c.name: units.FINE[c.unit] for c in setup.instrument.channels}
    return fine


def _untestable(effect: Effect, reason: str) -> DetectabilityRecord:
    return DetectabilityRecord(
        name=effect.name,
        about=effect.about,
        columns=0,
        detectability=0.0,
        low=0.0,
        high=0.0,
        power=FALSE_ALARM,
        visible=False,
        signature={},
        absorbed=0.0,
        least={},
        median={},
        sizes={},
        rivals=[],
        not_testable=reason,
    )


def _record(
    problem: GapProblem,
    gram: Array,
    white: Array,
    effect: Effect,
    by_effect: Mapping[str, Sequence[Form]],
    rng: np.random.Generator,
) -> DetectabilityRecord:
    """Detectability of one effect.

    gram         (K, K) of the columns of all forms
    white        (N, K) these columns before calibration absorbs
    by_effect    {effect: its forms}
    """
    forms = by_effect[effect.name]
    grams = [gram[np.ix_(form.at, form.at)] for form in forms]
    traces = np.array([max(float(np.trace(g)), 0.0) for g in grams])
    raw = np.array([np.sum(white.take(form.at, axis=1) ** 2) for form in forms])
    remaining = traces / np.maximum(raw, 1e-300)
    columns = max(len(g) for g in grams)
    needed, mean = needed_lambda(columns), float(traces.mean())
    detectability = float(np.sqrt(mean))
    count = -(-DRAWS // len(forms))
    draws = [rng.standard_normal((len(g), count)) for g in grams]
    signature, least, median = {}, {}, {}
    fine = fine_units(problem.measurement)
    for channel, rows in problem.rows.groupby("channel", sort=False).indices.items():
        spreads = [_spread(form, rows) for form in forms]
        mean_square = np.mean([np.trace(spread) for spread in spreads])
        pairs = zip(spreads, grams, strict=True)
        best = min(_least_rms(*pair, needed) for pair in pairs)
        typical = _median_rms(spreads, grams, draws, needed)
        unit = units.factor(fine[channel])
        signature[channel] = float(np.sqrt(mean_square)) / unit
        least[channel] = _bounded(best / unit)
        median[channel] = _bounded(typical / unit)
    others = [by_effect[name] for name in by_effect if name != effect.name]
    rivals = [effect_rival(gram, forms, other) for other in others]
    return DetectabilityRecord(
        name=effect.name,
        about=effect.about,
        columns=columns,
        detectability=detectability,
        low=float(np.sqrt(traces.min())),
        high=float(np.sqrt(traces.max())),
        power=power(mean, columns),
        visible=detectability**2 >= needed,
        signature=signature,
        absorbed=float(1.0 - np.sqrt(np.mean(remaining))),
        least=least,
        median=median,
        sizes=_least_sizes(forms, grams, needed),
        rivals=sorted(rivals, key=lambda rival: rival.separation),
        not_testable=None,
    )


def _spread(form: Form, rows: Index) -> Array:
    """S (k, k) with beta^T S beta the mean square of a channel's readings, SI."""
    columns = form.signature.columns[rows]
    return columns.T @ columns / len(rows)


def _median_rms(
    spreads: Sequence[Array],
    grams: Sequence[Array],
    draws: Sequence[Array],
    needed: float,
) -> float:
    """Root mean square, SI, that is found: median over draws (k, d) from the prior."""
    rms = []
    for spread, gram, beta in zip(spreads, grams, draws, strict=True):
        lam = np.maximum(_quadratic(gram, beta), 1e-300)
        rms.append(np.sqrt(needed / lam) * np.sqrt(_quadratic(spread, beta)))
    return float(np.median(np.concatenate(rms)))


def _quadratic(matrix: Array, draws: Array) -> Array:
    """Quadratic forms (d,) of draws (k, d)."""
    forms = np.einsum("kd,kl,ld->d", draws, matrix, draws)
    return np.asarray(np.maximum(forms, 0.0))


def _least_rms(spread: Array, gram: Array, needed: float) -> float:
    """Smallest RMS, SI, over all combinations of coefficients with lambda = needed."""
    size = float(np.trace(spread))
    if size <= 0.0:
        return 0.0
    ridge = 1e-12 * size * np.eye(len(spread))
    best = linalg.eigh(gram, spread + ridge, eigvals_only=True)[-1]
    return float(np.sqrt(needed / best)) if best > 0.0 else float("inf")


def _least_sizes(
    forms: Sequence[Form], grams: Sequence[Array], needed: float
) -> dict[str, float | None]:
    """Least size of each textbook coefficient alone, at its most visible constants."""
    least: dict[str, float] = {}
    for form, gram in zip(forms, grams, strict=True):
        signature = form.signature
        for k in np.flatnonzero(~signature.shape):
            name, lam = signature.names[k], float(gram[k, k])
            size = float("inf")
            if lam > 1e-12:
                size = (needed / lam) ** 0.5 * float(signature.scales[k])
            least[name] = min(size, least.get(name, float("inf")))
    return {name: _bounded(size) for name, size in least.items()}


def _bounded(size: float) -> float | None:
    """A size; None where no reading could bound it."""
    return size if size < UNBOUNDED else None
