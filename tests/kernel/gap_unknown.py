"""Discrepancies for tests of unknown effects, and sums of orthogonal parts."""

from __future__ import annotations

import dataclasses

import numpy as np

from kernel.dense_noise import law_covariance
from kernel.laws import STATED_LAW
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy
from oed.gap.forms.library import Library


def terms(problem: GapProblem, *names: str) -> Library:
    """The discrepancy's terms of some kinds."""
    every = discrepancy.build(problem)
    atoms = tuple(a for a in every.atoms if a.effect in names)
    return dataclasses.replace(every, atoms=atoms)


def smooth(problem: GapProblem) -> Library:
    """The discrepancy over time, the workspace and the runs."""
    return terms(problem, "over time", "over the workspace", "along the runs")


def some(library: Library, about: str, rng: np.random.Generator) -> np.ndarray:
    """A draw (N,) of the first term that is so in words."""
    atom = next(a for a in library.atoms if a.about.startswith(about))
    chosen = library.columns[:, atom.columns]
    return np.asarray(chosen @ rng.standard_normal(chosen.shape[1]))


def orthogonal_sum(
    problem: GapProblem, parts: list[np.ndarray], energies: list[float]
) -> np.ndarray:
    """The sum (N,) of parts, each without what those before it hold, at energies r^T M
    r (dense).
    """
    noise = problem.slopes @ problem.slopes.T
    for k, members in enumerate(problem.members):
        noise[np.ix_(members, members)] += law_covariance(
            STATED_LAW, problem, problem.members[k]
        )
    inverse, orthogonal = np.linalg.inv(noise), []
    for part, energy in zip(parts, energies, strict=True):
        for other in orthogonal:
            part = part - other * (other @ inverse @ part) / (other @ inverse @ other)
        orthogonal.append(part * np.sqrt(energy / (part @ inverse @ part)))
    return np.asarray(sum(orthogonal))
