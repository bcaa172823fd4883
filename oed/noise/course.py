"""A course through the session: what the readings of a channel share over all runs.

A cup creeps, a frame warms, a zero wanders. With the session's progress t from 0 to 1 the
course is a Wiener process, by its first Karhunen-Loeve terms

    sum_k  x_k sqrt(2) sin(w_k t) / w_k,    w_k = (k - 1/2) pi,    x_k ~ N(0, 1),

of variance t. A straight drift is nearly the first term, and what is faster than the last
one is left to what runs share and carry along.
"""

from __future__ import annotations

import numpy as np

from oed.base.arrays import Array, Index

#: most terms; they leave a twentieth of the variance
TERMS = 4
#: readings of a channel for each term
READINGS_A_TERM = 5


def course_terms(group: Index, progress: Array) -> Array:
    """Terms (N, c) of the course of each group of readings, few of a small group.

    group     (N,) numbers of the groups
    progress  (N,) of the session at each reading, 0 to 1
    """
    frequency = (np.arange(TERMS) + 0.5) * np.pi
    terms = np.sqrt(2.0) * np.sin(progress[:, None] * frequency) / frequency
    columns = [np.zeros((len(group), 0))]
    for number, count in enumerate(np.bincount(group)):
        few = min(TERMS, count // READINGS_A_TERM)
        columns.append(terms[:, :few] * (group == number)[:, None])
    return np.hstack(columns)
