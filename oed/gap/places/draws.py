"""Energy of what acts in each reading, in draws of the posterior over likely forms.

`ReversedForms` has the columns as if every run had been driven the other way, at the same
poses.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from oed.base import Array, Mask
from oed.effect_model import Effect
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.data import problem as problems
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as libraries
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw


@dataclasses.dataclass(frozen=True)
class LikelyForms:
    """Forms that what acts may have.

    share      posterior probability of these forms
    columns    (N, k) with coefficients N(0, 1), in units of the stated noise
    labels     (k,) `leg 1`, `set-up bar`, `channel dz in bar` or "", what each column
               belongs to
    timed      (k,) which columns vary with time or temperature; all by default
    other_way  (N, k) the columns in runs that are driven the other way; None where that
               is not known
    """

    share: float
    columns: Array
    labels: Sequence[str]
    timed: Mask | None = None
    other_way: Array | None = None


@dataclasses.dataclass(frozen=True)
class Draws:
    """Energy of what acts, in units of the stated noise, in D draws.

    timed        (N, D) of what varies with time in each reading, before the parameters
                 absorb
    other_way    (N, D) of all that acts, and `acting` (N, D) with the runs as they were
                 driven; None where the other way is not known
    remaining    (N, D) as calibration leaves it
    parts        {label: (D,)} of the columns of each label, as calibration leaves them
    """

    timed: Array
    acting: Array
    other_way: Array | None
    remaining: Array
    parts: dict[str, Array]


def draw_energies(
    problem: GapProblem,
    law: NoiseLaw,
    models: Sequence[LikelyForms],
    rng: np.random.Generator,
    draws: int,
) -> Draws:
    """Draws of which each model has its share."""
    metric = Metric(problem, law)
    shares = np.array([model.share for model in models])
    counts = rng.multinomial(draws, shares / shares.sum())
    drawn = [(model, n) for model, n in zip(models, counts, strict=True) if n]
    names = list(dict.fromkeys(label for model, _ in drawn for label in model.labels))
    energies = []
    for model, n in drawn:
        mean, precision = metric.posterior(model.columns, problem.residual)
        root = linalg.cholesky(precision, lower=True)
        normal = rng.standard_normal((len(mean), n))
        spread = linalg.solve_triangular(root, normal, lower=True, trans="T")
        beta = mean[:, None] + spread
        remaining = model.columns - problem.slopes @ metric.fit(model.columns)
        timed = slice(None) if model.timed is None else model.timed
        other_way = model.columns if model.other_way is None else model.other_way
        labels = np.array(model.labels)
        parts = [remaining[:, labels == name] @ beta[labels == name] for name in names]
        energies.append(
            (
                (model.columns[:, timed] @ beta[timed]) ** 2,
                (model.columns @ beta) ** 2,
                (other_way @ beta) ** 2,
                (remaining @ beta) ** 2,
                np.array([np.sum(part**2, axis=0) for part in parts]),
            )
        )
    is_known = all(model.other_way is not None for model, _ in drawn)
    every = [np.hstack(alike) for alike in zip(*energies, strict=True)]
    return Draws(
        timed=every[0],
        acting=every[1],
        other_way=every[2] if is_known else None,
        remaining=every[3],
        parts=dict(zip(names, every[4], strict=True)),
    )


class ReversedForms:
    """Columns of effects and of discrepancies in runs that are driven the other way."""

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        effects: Sequence[Effect],
    ) -> None:
        self._problem, self._library, self._processes = problem, library, processes
        self._effects = {effect.name: effect for effect in effects}
        self._known: dict[int, Array] = {}

    def columns(self, h: Hypothesis, factor: float) -> Array | None:
        """Columns (N, k) of a hypothesis at its sizes, times a factor.

        None where the readings do not say that they were driven both ways.
        """
        if not self._both_ways:
            return None
        parts = [np.zeros((len(self._problem), 0))]
        for atom, size in zip(h.atoms, h.sizes, strict=True):
            parts.append(factor * size * self._of_effect(atom))
        if h.process is not None:
            reversal = self._processes.atoms[h.process].reversal
            size = factor * h.process_size
            columns = self._processes.scaled_columns(h.process, size)
            parts.append(columns if reversal is None else columns * reversal)
        return np.hstack(parts)

    @functools.cached_property
    def _both_ways(self) -> bool:
        rows = self._problem.rows
        if "direction" not in rows.columns:
            return False
        direction = rows["direction"].to_numpy(dtype=float)
        return bool((direction > 0.0).any() and (direction < 0.0).any())

    def _of_effect(self, atom: int) -> Array:
        if atom not in self._known:
            self._known[atom] = self._rebuilt(atom)
        return self._known[atom]

    def _rebuilt(self, atom: int) -> Array:
        form = self._library.atoms[atom]
        effect = self._effects[form.effect]
        fixed = {name: (value,) for name, value in form.constants.items()}
        alone = dataclasses.replace(effect, constants=fixed)
        library = libraries.build(self._reversed, [alone])
        place = {name: k for k, name in enumerate(library.names)}
        columns = np.zeros((len(self._problem), len(form.columns)))
        for k, column in enumerate(form.columns):
            name = self._library.names[column]
            if name in place:
                columns[:, k] = library.columns[:, place[name]]
        return columns

    @functools.cached_property
    def _reversed(self) -> GapProblem:
        """The readings with the order of each run counted from its end."""
        problem = self._problem
        rows = problem.covariates
        other_way = problems.with_reversed_runs(rows)
        other_way["direction"] = -rows["direction"]
        return problems.assemble(
            problem.measurement,
            problem.series,
            other_way,
            problem.theta,
            problem.y,
            gravity=problem.gravity,
        )
