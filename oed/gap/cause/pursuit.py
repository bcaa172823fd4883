"""Matching pursuit: an unknown of several processes at once (Mallat and Zhang 1993).

An unknown need not be one process: a wave has overtones, a swelling frame moves several
legs. So the strongest process is selected, then the next one with it in the model, and
so on.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.cause.remainder import UNKNOWN_SIZES
from oed.gap.data import evidence
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Atom, Library
from oed.noise.law import NoiseLaw

#: name of several processes together, and the most of them
NAME, MOST = "several processes", 3


def pursue(
    processes: Library, problem: GapProblem, laws: Sequence[NoiseLaw]
) -> Library:
    """Processes together with the strongest two, three, ... combined.

    Processes are added as long as the next one is more likely to act than not, under
    each of some noise laws: what shifts whole runs is noise where runs may differ, and
    shows only where they may not.
    """
    atoms = list(processes.atoms)
    for law in laws if processes.atoms else ():
        for atom in _pursue(processes, problem, law):
            if not any(np.array_equal(atom.columns, a.columns) for a in atoms):
                atoms.append(atom)
    return dataclasses.replace(processes, atoms=tuple(atoms))


def _pursue(processes: Library, problem: GapProblem, law: NoiseLaw) -> list[Atom]:
    """Several processes together, two and more, under one noise law."""
    choices = [atom.columns for atom in processes.atoms]
    log_weights = _log_weights(processes)
    grams = evidence.grams(problem, Metric(problem, law), processes.columns)
    selected: list[int] = []
    atoms: list[Atom] = []
    while len(selected) < MOST:
        table = grams.log_evidences(choices, UNKNOWN_SIZES)
        table = table + log_weights[:, None]
        table[selected] = -np.inf
        row, column = np.unravel_index(int(np.argmax(table)), table.shape)
        if selected and table[row, column] < 0.0:
            break
        selected.append(int(row))
        grams = grams.select(choices[row], float(UNKNOWN_SIZES[column]))
        if len(selected) > 1:
            atoms.append(_combined(processes, selected, log_weights))
    return atoms


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
