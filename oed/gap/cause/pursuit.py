"""Matching pursuit: an unknown of several processes at once, and the noise law with it.

An unknown need not be one process: a wave has overtones, a swelling frame moves several
legs. A noise law that was fitted with nothing in the model holds what the unknown did:
an error carried along a run, say, in place of a wave. So the strongest process is
selected, the noise law fitted again with it in the model, the next process selected
under that noise, and so on (Mallat and Zhang 1993).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.cause.remainder import UNKNOWN_SIZES
from oed.gap.data import evidence, noise
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Atom, Library
from oed.noise.law import NoiseLaw

#: name of several processes together, and the most of them
NAME, MOST = "several processes", 3


def pursue(
    processes: Library,
    problem: GapProblem,
    starts: Sequence[NoiseLaw],
    *,
    known: bool = False,
) -> tuple[Library, list[tuple[NoiseLaw, float]]]:
    """Processes together with the strongest two, three, ... combined.

    Processes are added as long as the next one is more likely to act than not.

    starts    noise laws under which the strongest is selected. What shifts whole runs
              is noise where runs may differ, and shows only where they may not
    known     whether the noise is as they state, whatever acts

    The second result has, for each start, the noise law with all selected processes in
    the model, and its log prior.
    """
    atoms, pairs = list(processes.atoms), []
    for start in starts if processes.atoms else ():
        combined, pair = _pursue(processes, problem, start, known)
        for atom in combined:
            if not any(np.array_equal(atom.columns, a.columns) for a in atoms):
                atoms.append(atom)
        pairs.append(pair)
    return dataclasses.replace(processes, atoms=tuple(atoms)), pairs


def _pursue(
    processes: Library,
    problem: GapProblem,
    start: NoiseLaw,
    known: bool,
) -> tuple[list[Atom], tuple[NoiseLaw, float]]:
    """Several processes together, two and more, from one noise law on.

    The second result is the noise law with all of them in the model, and its log prior.
    """
    choices = [atom.columns for atom in processes.atoms]
    log_weights = _log_weights(processes)
    law, pair = start, (start, 0.0)
    selected: list[int] = []
    sizes: list[float] = []
    atoms: list[Atom] = []
    while len(selected) < MOST:
        grams = evidence.grams(problem, Metric(problem, law), processes.columns)
        for k, size in zip(selected, sizes, strict=True):
            grams = grams.select(choices[k], size)
        table = grams.log_evidences(choices, UNKNOWN_SIZES)
        table = table + log_weights[:, None]
        table[selected] = -np.inf
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        if selected and table[row, column] < 0.0:
            break
        selected.append(int(row))
        sizes.append(float(UNKNOWN_SIZES[column]))
        if not known:
            pair = noise.fit_law(problem, _columns(processes, selected, sizes), law)
            law = pair[0]
        if len(selected) > 1:
            atoms.append(_combined(processes, selected, log_weights))
    return atoms, pair


def _log_weights(processes: Library) -> Array:
    """Log prior (atoms,) of each process at one size."""
    log_weights = np.array([atom.log_weight for atom in processes.atoms])
    count = len(processes.effects) * len(UNKNOWN_SIZES)
    return np.asarray(log_weights - np.log(count))


def _combined(
    processes: Library,
    selected: Sequence[int],
    log_weights: Array,
) -> Atom:
    """Several processes as one form.

    The first one's share among all processes is part of the prior where these are
    compared.
    """
    atoms = [processes.atoms[k] for k in selected]
    others = log_weights[list(selected)].sum() - log_weights[selected[0]]
    numbers = {f"process {n}": float(k) for n, k in enumerate(selected, start=1)}
    return Atom(
        effect=NAME,
        constants={**numbers, "processes": float(len(selected))},
        columns=np.unique(np.concatenate([atom.columns for atom in atoms])),
        log_weight=float(others + atoms[0].log_weight),
        about=", and ".join(dict.fromkeys(atom.about for atom in atoms)),
    )


def _columns(
    processes: Library,
    selected: Sequence[int],
    sizes: Sequence[float],
) -> Array:
    """Columns (N, k) of the selected processes at their sizes."""
    pairs = zip(selected, sizes, strict=True)
    return np.hstack([processes.scaled_columns(k, size) for k, size in pairs])
