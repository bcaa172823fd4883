"""Confusion of effects: principal angles, imitated combinations, classes.

`gram` is the Gram matrix (K, K) of the columns of all forms, after calibration has
absorbed what it can (`oed.gap.before.detect`).

Combinations of an effect's coefficients are put into words, in prior standard deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse import csgraph

from oed.base import Array, Index, Mask
from oed.gap.before.forms import Form
from oed.gap.before.power import needed_lambda
from oed.gap.data.evidence import separated
from oed.linear_algebra import by_size, canonical_rows, eigenvectors, first_largest
from oed.result import RivalRecord, SharedRecord

#: sqrt(lambda_k|j) below which the two cannot be distinguished
SEPARATED = 5.0
#: share of lambda_k that a rival must absorb to count as one
HALF = 0.5
#: principal angle, deg, below which a combination of one effect is a combination of the
#: other to these readings
SAME = 1.0
#: share of the mean by which coefficients that are common may differ
COMMON = 0.1
#: share of the largest below which a coefficient is not mentioned
MINOR = 0.2


def effect_rival(
    gram: Array, forms: Sequence[Form], rivals: Sequence[Form]
) -> RivalRecord:
    """How well an effect is distinguished from a rival at its most absorbing constants.

    `forms` are the effect's, `rivals` are the rival's. The separation is a mean over
    the effect's forms, the angle the smallest of all. Combinations are those of the
    form that is absorbed most.
    """
    rest = [[np.trace(_left(gram, f, r)) for r in rivals] for f in forms]
    remaining = np.array(rest)
    least = remaining.min(axis=1)
    hardest = int(np.argmin(least))
    nearest = int(np.argmin(remaining[hardest]))
    return RivalRecord(
        name=rivals[0].signature.effect,
        separation=max(float(least.mean()), 0.0) ** 0.5,
        angle_deg=_smallest_angle(gram, forms, rivals),
        shared=_shared(gram, forms[hardest], rivals[nearest]),
    )


def _left(gram: Array, form: Form, rival: Form) -> Array:
    return separated(gram, form.at, rival.at, rival.precision)


def _smallest_angle(
    gram: Array, forms: Sequence[Form], rivals: Sequence[Form]
) -> float:
    """Smallest principal angle, deg, of any form with any rival; 90 without any."""
    at, rival_at = (
        [form.at[form.textbook] for form in several] for several in (forms, rivals)
    )
    roots = [_visible_root(gram, columns) for columns in at]
    rival_roots = [_visible_root(gram, columns) for columns in rival_at]
    largest = 0.0
    for columns, root in zip(at, roots, strict=True):
        for others, other in zip(rival_at, rival_roots, strict=True):
            cross = root.T @ gram[np.ix_(columns, others)] @ other
            cosine = np.linalg.svd(cross, compute_uv=False)
            largest = max(largest, float(cosine.max(initial=0.0)))
    return float(np.rad2deg(np.arccos(min(largest, 1.0))))


def _principal_angles(gram: Array, form: Form, rival: Form) -> tuple[Array, Array]:
    """Principal angles (r,), deg ascending, of the textbook columns.

    The second result are the combinations (k, r) of unit length.
    """
    at, rival_at = form.at[form.textbook], rival.at[rival.textbook]
    root, rival_root = _visible_root(gram, at), _visible_root(gram, rival_at)
    cross = root.T @ gram[np.ix_(at, rival_at)] @ rival_root
    u, cosine, _ = np.linalg.svd(cross)
    missing = np.zeros(u.shape[1] - len(cosine))
    cosine = np.append(np.minimum(cosine, 1.0), missing)
    vectors = root @ canonical_rows(u.T, cosine).T
    lengths = np.linalg.norm(vectors, axis=0)
    return np.rad2deg(np.arccos(cosine)), vectors / lengths


def _visible_root(gram: Array, at: Index) -> Array:
    """R (k, r) with R^T A R = 1 over the directions that can be seen.

    These have the energy of the noise at a prior standard deviation, or a hundredth of
    the largest.
    """
    block = gram[np.ix_(at, at)]
    return inverse_root(block, lambda largest: min(1.0, 0.01 * max(largest, 1e-300)))


def _shared(gram: Array, form: Form, rival: Form) -> list[SharedRecord]:
    """Combinations of the textbook coefficients that the rival imitates.

    They are visible and not distinguished from it, or the same as its.
    """
    angles, vectors = _principal_angles(gram, form, rival)
    at, block = form.at[form.textbook], np.ix_(form.textbook, form.textbook)
    inner, separated = gram[np.ix_(at, at)], _left(gram, form, rival)[block]
    names = [form.signature.names[k] for k in form.textbook]
    shared = []
    for angle, v in zip(angles, vectors.T, strict=True):
        whole = float(v @ inner @ v)
        distinct = float(max(v @ separated @ v, 0.0))
        visible = whole >= needed_lambda(1)
        imitated = distinct < min(SEPARATED**2, HALF * whole)
        if angle < SAME or (visible and imitated):
            shares = v / v[first_largest(v)]
            combination = dict(zip(names, shares.tolist(), strict=True))
            record = SharedRecord(
                words=in_words(combination),
                combination=combination,
                detectability=float(np.sqrt(whole)),
                separation=float(np.sqrt(distinct)),
                angle_deg=float(angle),
            )
            shared.append(record)
    return shared


def indistinguishable(
    names: Sequence[str], separation: Array, visible: Mask
) -> tuple[list[list[str]], list[list[str]]]:
    """Connected groups of visible effects, and pairs (k, j) of k absorbed by j.

    separation    (K, K) sqrt(lambda_k|j), sqrt(lambda_k) on the diagonal

    A rival counts where it absorbs half of lambda_k at least: what is hardly seen is
    near every rival.
    """
    detectability = np.diag(separation)[:, None]
    least = np.minimum(SEPARATED, np.sqrt(HALF) * detectability)
    others = ~np.eye(len(names), dtype=bool)
    both_visible = visible[:, None] & visible[None, :]
    close = (separation < least) & both_visible & others
    _, label = csgraph.connected_components(sparse.csr_matrix(close), directed=False)
    groups: dict[int, list[str]] = {}
    for name, number in zip(names, label, strict=True):
        groups.setdefault(int(number), []).append(name)
    classes = [members for members in groups.values() if len(members) > 1]
    return classes, [[names[k], names[j]] for k, j in np.argwhere(close)]


# -- root ------------------------------------------------------------------------------


def inverse_root(gram: Array, least: Callable[[float], float]) -> Array:
    """R (k, m) with R R^T the pseudo-inverse of a Gram matrix (k, k).

    Directions of less energy than `least`, a function of the largest energy, are left
    out.
    """
    values, vectors = eigenvectors(gram)
    visible = values > least(float(values.max(initial=0.0)))
    return vectors[:, visible] / np.sqrt(values[visible])


def in_words(combination: Mapping[str, float]) -> str:
    """A combination of coefficients, its largest share 1, in words."""
    values = np.array(list(combination.values()))
    names = list(combination)
    if len(values) == 1:
        return names[0]
    mean = values.mean()
    if np.all(np.abs(values - mean) < COMMON * abs(mean)):
        return f"common to {', '.join(names[:-1])} and {names[-1]}"
    terms = []
    for k in by_size(values):
        if abs(values[k]) >= MINOR:
            terms.append(_term(float(values[k]), names[k]))
    return " ".join(terms).removeprefix("+ ")


def _term(value: float, name: str) -> str:
    """A term with its sign; a factor of 1 is not written."""
    sign = "-" if value < 0 else "+"
    size = f"{abs(value):.2g}"
    return f"{sign} {name}" if size == "1" else f"{sign} {size} {name}"
