"""An unknown of several processes at once, and the noise beside it (a matching pursuit, Mallat and Zhang 1993).

What nobody thought of need not be one process: a wave has overtones, a swelling frame moves several legs. And noise
that was told with nothing beside it holds what the unknown did: an error carried along a run, say, in place of a wave.
So the strongest process is taken, the noise told anew beside it, the next one looked for under that noise, and so on.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.batch import Array
from oed.gap import evidence, scatter
from oed.gap.law import Law, Metric
from oed.gap.library import Atom, Library
from oed.gap.problem import Index, Problem
from oed.gap.which import UNKNOWN_SIZES

#: name of several processes together, and most of them
NAME, MOST = "several processes", 3


def pursued(processes: Library, problem: Problem, start: Law) -> tuple[Library, list[tuple[Law, float]]]:
    """The processes with the strongest two, three, ... together beside them; and the noise laws, with their log priors,
    beside the strongest, the strongest two, ..."""
    choices = [a.columns for a in processes.atoms]
    weights = np.array([a.log_weight for a in processes.atoms]) - np.log(max(len(processes.effects), 1))
    law, laws = start, []
    chosen: list[int] = []
    sizes: list[float] = []
    atoms: list[Atom] = []
    while choices and len(chosen) < MOST:
        found = evidence.grams(problem, Metric(problem, law), processes.columns)
        for k, size in zip(chosen, sizes, strict=True):
            found = found.given(choices[k], size)
        told = found.log_evidences(choices, UNKNOWN_SIZES) + weights[:, None]
        told[chosen] = -np.inf
        row, column = np.unravel_index(int(np.argmax(told)), told.shape)
        chosen.append(int(row))
        sizes.append(float(UNKNOWN_SIZES[column]))
        columns = _columns(processes, [choices[k] for k in chosen], sizes)
        law, prior = _beside(problem, columns, law)
        laws.append((law, prior))
        if len(chosen) > 1:
            both = np.unique(np.concatenate([choices[k] for k in chosen]))
            weight = float(weights[chosen].sum()) + np.log(max(len(processes.effects), 1))
            atoms.append(Atom(NAME, {"processes": float(len(chosen))}, both, weight))
    return dataclasses.replace(processes, atoms=(*processes.atoms, *atoms)), laws


def _columns(processes: Library, choices: list[Index], sizes: list[float]) -> Array:
    return np.hstack([s * processes.columns[:, c] for c, s in zip(choices, sizes, strict=True)])


def _beside(problem: Problem, columns: Array, law: Law) -> tuple[Law, float]:
    if not np.isfinite(law.tails):
        return scatter.fit(problem, columns, law)
    ordinary = dataclasses.replace(law, variance=np.ones_like(law.variance), tails=np.inf)
    return scatter.robust(problem, columns, start=ordinary)
