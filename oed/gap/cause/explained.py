"""What the best hypothesis explains of the residual: coefficients, sizes, remainder."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from oed.base import Array
from oed.gap.cause.compare import RIVAL, posterior_mean
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data.diagnosis import Explained, Size
from oed.gap.data.evidence import WhitenedColumns
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.result import CoefficientRecord

#: share of an unknown remainder that an effect explains which comes near it
NEAR = 0.5
#: number of such effects that are named
MOST_NEAR = 4


def explain(
    problem: GapProblem, search: Search, h: Hypothesis, named: Collection[str]
) -> Explained:
    """Parts of the residual by a hypothesis.

    Effects that are not `named` count with what is unknown. `problem` has the
    residuals with their outliers, `search` without.
    """
    metric, library = Metric(problem, search.law), search.library
    residual, level = search.problem.residual, search.noise_level(h)
    columns = h.columns(library, search.processes)
    mean, precision = metric.posterior(columns, residual)
    sd = level * np.sqrt(np.diag(np.linalg.inv(precision)))
    by_effects = np.zeros(len(problem))
    constants, coefficients, sizes, start = {}, [], [], 0
    stated = Metric(search.problem, search.problem.stated_law)
    for effect, atom, size in zip(h.effects, h.atoms, h.sizes, strict=True):
        rows = library.atoms[atom].columns
        at = slice(start, start + len(rows))
        start = at.stop
        if effect not in named:
            continue
        constants[effect] = library.atoms[atom].constants
        signal = columns[:, at] @ mean[at]
        by_effects = by_effects + signal
        unit = size * library.scales[rows]
        for c, value, of_value in zip(
            rows, mean[at] * unit, sd[at] * unit, strict=True
        ):
            record = CoefficientRecord(
                effect=effect,
                name=library.names[c],
                label=library.labels[c],
                value=float(value),
                sd=float(of_value),
                unit="SI",
                prior_sd=None,
            )
            coefficients.append(record)
        energy = float(metric.gram(signal[:, None], signal[:, None])[0, 0])
        detectability = float(np.sqrt(max(energy, 0.0))) / level
        rms = _rms_by_channel(problem, signal)
        remaining = _rms_by_channel(problem, _after_fit(problem, stated, signal))
        sizes.append(Size(effect, rms, remaining, detectability))
    outlying = problem.residual - residual
    before = _after_fit(problem, stated, residual) + outlying
    after = _after_fit(problem, stated, residual - by_effects) + outlying
    return Explained(
        constants=constants,
        coefficients=tuple(coefficients),
        sizes=tuple(sizes),
        explained=by_effects * problem.sigma,
        unexplained=(columns @ mean - by_effects) * problem.sigma,
        before=before * problem.sigma,
        after=after * problem.sigma,
    )


def nearest_effects(search: Search, h: Hypothesis) -> tuple[str, ...]:
    """Effects that explain most of an unknown remainder, the nearest first.

    With s what the remainder changes, an effect's share is the largest s^T M G (G^T M G
    + 1 / t^2)^-1 G^T M s / s^T M s of its forms G, at the largest usual size t.
    """
    if h.process is None:
        return ()
    problem, library = search.problem, search.library
    metric = Metric(problem, search.law)
    columns = h.columns(library, search.processes)
    coefficients, _ = metric.posterior(columns, problem.residual)
    of_process = len(search.processes.atoms[h.process].columns)
    change = columns[:, -of_process:] @ coefficients[-of_process:]
    grams = WhitenedColumns(
        problem.with_residual(change), metric, library.columns
    ).grams()
    shares: dict[str, float] = {}
    for atom in library.atoms:
        mean = posterior_mean(grams, atom.columns, RIVAL)
        share = float(grams.b[atom.columns] @ mean) / grams.energy
        shares[atom.effect] = max(share, shares.get(atom.effect, 0.0))
    near = [name for name, share in shares.items() if share >= NEAR]
    return tuple(sorted(near, key=lambda name: -shares[name])[:MOST_NEAR])


def _rms_by_channel(problem: GapProblem, signal: Array) -> dict[str, float]:
    """Root mean square, SI, of a change of the readings in each channel."""
    values = signal * problem.sigma
    channels = problem.rows["channel"].to_numpy()
    return {
        str(name): float(np.sqrt(np.mean(values[channels == name] ** 2)))
        for name in dict.fromkeys(channels)
    }


def _after_fit(problem: GapProblem, metric: Metric, residual: Array) -> Array:
    """A residual (N,) less what the parameters explain when fitted to it."""
    return residual - problem.slopes @ metric.fit(residual)
