"""An unknown of several processes at once, and the noise beside it (a matching pursuit,
Mallat and Zhang 1993).

What nobody thought of need not be one process: a wave has overtones, a swelling frame
moves several legs. And noise that was told with nothing beside it holds what the
unknown did: an error carried along a run, say, in place of a wave. So the strongest
process is taken, the noise told anew beside it, the next one looked for under that
noise, and so on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.gap.cause.which import UNKNOWN_SIZES
from oed.gap.data import evidence, noise
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Atom, Library
from oed.noise.law import NoiseLaw

#: name of several processes together, and most of them
NAME, MOST = "several processes", 3


def pursued(
    processes: Library,
    problem: GapProblem,
    starts: Sequence[NoiseLaw],
    *,
    known: bool = False,
) -> tuple[Library, list[tuple[NoiseLaw, float]]]:
    """The processes with the strongest two, three, ... together beside them, as long as
    the next one is likelier to act than not; and the noise laws beside the strongest or
    all of these, with their log priors.

    starts: laws under which the strongest is looked for. What shifts whole runs is
    noise where runs are said not to
    repeat, and is seen only where they are said to.  known: the noise is as they say,
                                                      whatever acts
    """
    atoms, pairs = list(processes.atoms), []
    for start in starts if processes.atoms else ():
        more, pair = _pursued(processes, problem, start, known)
        atoms += [
            a
            for a in more
            if not any(np.array_equal(a.columns, b.columns) for b in atoms)
        ]
        pairs.append(pair)
    return dataclasses.replace(processes, atoms=tuple(atoms)), pairs


def _pursued(
    processes: Library, problem: GapProblem, start: NoiseLaw, known: bool
) -> tuple[list[Atom], tuple[NoiseLaw, float]]:
    """Several processes together, two and more, and the noise law beside all of them,
    begun at one law.
    """
    choices = [a.columns for a in processes.atoms]
    weights = np.array([a.log_weight for a in processes.atoms]) - np.log(
        len(processes.effects) * len(UNKNOWN_SIZES)
    )
    law, pair = start, (start, 0.0)
    chosen: list[int] = []
    sizes: list[float] = []
    atoms: list[Atom] = []
    while len(chosen) < MOST:
        found = evidence.grams(problem, Metric(problem, law), processes.columns)
        for k, size in zip(chosen, sizes, strict=True):
            found = found.select(choices[k], size)
        told = found.log_evidences(choices, UNKNOWN_SIZES) + weights[:, None]
        told[chosen] = -np.inf
        row, column = np.unravel_index(int(np.argmax(told)), told.shape)
        if chosen and told[row, column] < 0.0:
            break
        chosen.append(int(row))
        sizes.append(float(UNKNOWN_SIZES[column]))
        if not known:
            pair = noise.fit_law(
                problem, _columns(processes, [choices[k] for k in chosen], sizes), law
            )
            law = pair[0]
        if len(chosen) > 1:
            both = np.unique(np.concatenate([choices[k] for k in chosen]))
            # the first one's share among all is told where these are compared
            weight = float(
                weights[chosen].sum()
                - weights[chosen[0]]
                + processes.atoms[chosen[0]].log_weight
            )
            which = {f"process {n}": float(k) for n, k in enumerate(chosen, start=1)}
            which["processes"] = float(len(chosen))
            about = ", and ".join(
                dict.fromkeys(processes.atoms[k].about for k in chosen)
            )
            atoms.append(Atom(NAME, which, both, weight, about))
    return atoms, pair


def _columns(processes: Library, choices: list[Index], sizes: list[float]) -> Array:
    return np.hstack(
        [s * processes.columns[:, c] for c, s in zip(choices, sizes, strict=True)]
    )
