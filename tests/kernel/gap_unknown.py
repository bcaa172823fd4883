"""Processes for tests of unknown effects, and sums of orthogonal parts."""

from __future__ import annotations

import numpy as np

from oed.gap.data.problem import GapProblem
from oed.gap.forms.processes.catalogue import PROCESSES
from oed.noise.law import stated_law

SMOOTH = [
    p
    for p in PROCESSES
    if p.name in ("over time", "over the pose", "over the travel", "along the runs")
]


def orthogonal_sum(
    problem: GapProblem, parts: list[np.ndarray], energies: list[float]
) -> np.ndarray:
    """The sum (N,) of parts, each without what those before it hold, at energies r^T M
    r (dense).
    """
    noise = problem.slopes @ problem.slopes.T
    for k, members in enumerate(problem.members):
        noise[np.ix_(members, members)] += stated_law(problem).block(problem, k)
    inverse, orthogonal = np.linalg.inv(noise), []
    for part, energy in zip(parts, energies, strict=True):
        for other in orthogonal:
            part = part - other * (other @ inverse @ part) / (other @ inverse @ other)
        orthogonal.append(part * np.sqrt(energy / (part @ inverse @ part)))
    return np.asarray(sum(orthogonal))
