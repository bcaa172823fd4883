"""Stepwise regression, a baseline: forward selection by BIC over the library.

By least squares over the library's signatures with the parameters in the model, noise
as stated to within a common level. Source: Schwarz 1978, Ann. Stat. 6, 461-464, for
BIC.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from benchmarks.harness.diagnosis import Record, prepare
from oed.base import Array, Index
from oed.gap import GapProblem, Metric
from oed.gap.forms import library as library_of
from oed.gap.forms.library import Library

MOST = 5  #: effects that the stepwise selection may take
LEAST = 1e-5  #: share of a column's size that must survive the calibration
SINGULAR = 1e-6  #: energy of a direction of unit columns below which it is none


def stepwise_record(study: Path, readings: Path) -> Record:
    """What the selection names, as the record of a diagnosis that is certain of it."""
    problem, effects = prepare(study, readings)
    names = stepwise(problem, library_of.build(problem, effects))
    answers = [{"effects": names, "probability": 1.0}]
    verdict = "effect" if names else "none"
    return {"verdict": verdict, "answers": answers, "set95": answers}


def stepwise(problem: GapProblem, library: Library) -> list[str]:
    """Effects of a library that forward selection by BIC takes, in its order.

    BIC = N log(RSS / N) + k log N; k counts a form's columns and its effect's
    constants.
    """
    metric = Metric(problem, problem.stated_law)
    columns = library.columns.all()
    scores = metric.scores(np.column_stack([problem.residual, columns]))
    full = scores.T @ scores
    raw = np.sqrt((columns**2).sum(axis=0))
    size = np.sqrt(np.maximum(np.diag(full)[1:], 0.0))
    scale = np.where(size > LEAST * raw, 1.0 / np.maximum(size, 1e-300), 0.0)
    gram, b = full[1:, 1:] * np.outer(scale, scale), full[1:, 0] * scale
    squares = float(full[0, 0])
    count = len(problem)
    selected: list[str] = []
    for _ in range(MOST):
        atoms = [a for a in library.atoms if a.effect not in selected]
        if not atoms:
            break
        gains = _gains(gram, b, [atom.columns for atom in atoms])
        parameters = [len(atom.columns) + len(atom.constants) for atom in atoms]
        penalty = np.array(parameters) * math.log(count)
        share = np.minimum(gains / squares, 1.0 - 1e-12)
        bic = count * np.log1p(-share) + penalty
        best = int(np.argmin(bic))
        if bic[best] >= 0.0:
            break
        selected.append(atoms[best].effect)
        gram, b, squares = _project_out(gram, b, squares, atoms[best].columns)
    return selected


def _gains(gram: Array, b: Array, choices: Sequence[Index]) -> Array:
    """What each choice of columns takes off the residual sum of squares."""
    gains = np.zeros(len(choices))
    counts = np.array([len(c) for c in choices])
    for count in np.unique(counts):
        at = np.flatnonzero(counts == count)
        rows = np.array([choices[int(k)] for k in at])
        values, vectors = np.linalg.eigh(gram[rows[:, :, None], rows[:, None, :]])
        energy = np.einsum("akj,ak->aj", vectors, b[rows]) ** 2
        regular = values > SINGULAR
        by_direction = energy / np.where(regular, values, 1.0)
        gains[at] = np.where(regular, by_direction, 0.0).sum(axis=1)
    return gains


def _project_out(
    gram: Array, b: Array, squares: float, columns: Index
) -> tuple[Array, Array, float]:
    """Gram matrix, projections and residual sum of squares without some columns."""
    values, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
    regular = values > SINGULAR
    root = vectors[:, regular] / np.sqrt(values[regular])
    half, projected = root.T @ gram[columns], root.T @ b[columns]
    gain = float(projected @ projected)
    return gram - half.T @ half, b - half.T @ projected, squares - gain
