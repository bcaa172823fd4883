"""Confusion of effects: principal angles, imitated combinations, classes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oed.arrays import Array, Index, Mask
from oed.gap.before.combinations import in_words
from oed.gap.before.detection import EffectRival, SharedSignature
from oed.gap.before.power import needed_lambda
from oed.gap.before.table import Form, GramTable
from oed.gap.data.root import inverse_root

#: share of lambda_k that a rival must absorb to count as one
HALF = 0.5
#: principal angle, deg, below which a combination of one effect is a combination of the
#: other to these readings
SAME = 1.0


def effect_rival(
    table: GramTable,
    name: str,
    other: str,
    threshold: float,
) -> EffectRival:
    """How well an effect is distinguished from another.

    `threshold` is the sqrt(lambda_k|j) below which a combination is not.
    """
    forms = table.forms[name]
    nearest = [table.worst(form, other) for form in forms]
    pairs = list(zip(forms, nearest, strict=True))
    traces = [float(np.trace(table.separated(*pair))) for pair in pairs]
    smallest = min(
        _smallest_angle(table, form, rival)
        for form in forms
        for rival in table.forms[other]
    )
    shared = _shared(table, *pairs[int(np.argmin(traces))], threshold)
    separation = max(float(np.mean(traces)), 0.0) ** 0.5
    return EffectRival(other, separation, smallest, shared)


def _smallest_angle(table: GramTable, form: Form, rival: Form) -> float:
    """Smallest principal angle, deg; 90 where nothing can be seen."""
    angles, _ = _principal_angles(table, form, rival)
    return float(angles[0]) if len(angles) else 90.0


def _principal_angles(
    table: GramTable,
    form: Form,
    rival: Form,
) -> tuple[Array, Array]:
    """Principal angles (r,), deg ascending, of the textbook columns.

    The second result are the combinations (k, r) of unit length.
    """
    root = _visible_root(table, form.textbook)
    rival_root = _visible_root(table, rival.textbook)
    cross = root.T @ table.block(form.textbook, rival.textbook) @ rival_root
    u, cosine, _ = np.linalg.svd(cross)
    missing = np.zeros(u.shape[1] - len(cosine))
    cosine = np.append(np.minimum(cosine, 1.0), missing)
    vectors = root @ u
    lengths = np.linalg.norm(vectors, axis=0)
    return np.rad2deg(np.arccos(cosine)), vectors / lengths


def _visible_root(table: GramTable, at: Index) -> Array:
    """R (k, r) with R^T A R = 1 over the directions that can be seen.

    These have the energy of the noise at a prior standard deviation, or a hundredth of
    the largest.
    """
    gram = table.block(at, at)
    return inverse_root(gram, lambda largest: min(1.0, 0.01 * max(largest, 1e-300)))


def _shared(
    table: GramTable,
    form: Form,
    rival: Form,
    threshold: float,
) -> tuple[SharedSignature, ...]:
    """Combinations of the textbook coefficients that the rival imitates.

    They are visible and not distinguished from it, or the same as its.
    """
    angles, vectors = _principal_angles(table, form, rival)
    place = np.searchsorted(form.at, form.textbook)
    block = np.ix_(place, place)
    gram = table.gram(form)[block]
    separated = table.separated(form, rival)[block]
    names = [form.signature.names[k] for k in place]
    shared = []
    for angle, v in zip(angles, vectors.T, strict=True):
        whole = float(v @ gram @ v)
        distinct = float(max(v @ separated @ v, 0.0))
        visible = whole >= needed_lambda(1)
        imitated = distinct < min(threshold**2, HALF * whole)
        if angle < SAME or (visible and imitated):
            largest = v[np.argmax(np.abs(v))]
            shares = [float(share) for share in v / largest]
            combination = dict(zip(names, shares, strict=True))
            signature = SharedSignature(
                combination=combination,
                words=in_words(combination),
                detectability=float(np.sqrt(whole)),
                separation=float(np.sqrt(distinct)),
                angle=float(angle),
            )
            shared.append(signature)
    return tuple(shared)


def indistinguishable(
    names: Sequence[str],
    separation: Array,
    visible: Mask,
    threshold: float,
) -> tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, str], ...]]:
    """Connected groups of visible effects, and pairs (k, j) of k absorbed by j.

    A rival counts where it absorbs half of lambda_k at least: what is hardly seen is
    near every rival.
    """
    detectability = np.diag(separation)[:, None]
    least = np.minimum(threshold, np.sqrt(HALF) * detectability)
    others = ~np.eye(len(names), dtype=bool)
    both_visible = visible[:, None] & visible[None, :]
    close = (separation < least) & both_visible & others
    graph = sparse.csr_matrix(close)
    _, label = csgraph.connected_components(graph, directed=False)
    groups = []
    for number in np.unique(label):
        members = [name for name, g in zip(names, label, strict=True) if g == number]
        if len(members) > 1:
            groups.append(tuple(members))
    edges = tuple((names[k], names[j]) for k, j in np.argwhere(close))
    return tuple(groups), edges
