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


def pursued(processes: Library, problem: Problem, start: Law) -> tuple[Library, tuple[Law, float] | None]:
    """The processes with the strongest two, three, ... together beside them, as long as the next one is likelier to act
    than not; and the noise law beside the strongest or all of these, with its log prior (None where there is none)."""
    choices = [a.columns for a in processes.atoms]
    if not choices:
        return processes, None
    weights = np.array([a.log_weight for a in processes.atoms]) - np.log(len(processes.effects) * len(UNKNOWN_SIZES))
    law, pair = start, None
    chosen: list[int] = []
    sizes: list[float] = []
    atoms: list[Atom] = []
    while len(chosen) < MOST:
        found = evidence.grams(problem, Metric(problem, law), processes.columns)
        for k, size in zip(chosen, sizes, strict=True):
            found = found.given(choices[k], size)
        told = found.log_evidences(choices, UNKNOWN_SIZES) + weights[:, None]
        told[chosen] = -np.inf
        row, column = np.unravel_index(int(np.argmax(told)), told.shape)
        if chosen and told[row, column] < 0.0:
            break
        chosen.append(int(row))
        sizes.append(float(UNKNOWN_SIZES[column]))
        pair = scatter.fit(problem, _columns(processes, [choices[k] for k in chosen], sizes), law)
        law = pair[0]
        if len(chosen) > 1:
            both = np.unique(np.concatenate([choices[k] for k in chosen]))
            # the first one's share among all is told where these are compared
            weight = float(weights[chosen].sum() - weights[chosen[0]] + processes.atoms[chosen[0]].log_weight)
            about = ", and ".join(dict.fromkeys(processes.atoms[k].about for k in chosen))
            atoms.append(Atom(NAME, {"processes": float(len(chosen))}, both, weight, about))
    if np.isfinite(law.tails):
        pair = scatter.anew(problem, _columns(processes, [choices[k] for k in chosen], sizes), law)
    return dataclasses.replace(processes, atoms=(*processes.atoms, *atoms)), pair


def _columns(processes: Library, choices: list[Index], sizes: list[float]) -> Array:
    return np.hstack([s * processes.columns[:, c] for c, s in zip(choices, sizes, strict=True)])
