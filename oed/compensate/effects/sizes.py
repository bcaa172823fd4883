"""Sizes of effects and of their groups, as the readings show them in a joint estimate.

A group is what belongs together: the coefficients of one leg, say. They are N(0, t^2).
An estimate made with some t, divided by its prior, is what the readings alone tell of a
group; with it t is estimated again:

- the groups of an effect share a size, its expected one or larger (`oed.model.size_prior`);
- one group in ten is of any larger size, so that one leg whose conversion is wrong is not
  pulled to zero, and the others are not set free.

Sizes are posterior medians: where the readings tell nothing, the expected one.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array, Index
from oed.compensate.effects.forms import ChosenForm
from oed.model.size_prior import EFFECT_SIZES, FAR_SHARE

#: least precision that readings may add to a prior's, as a share of it
LEAST = 1e-6
#: sizes from the expected one on; those below it count as it
SIZES = EFFECT_SIZES.values[EFFECT_SIZES.values >= 1.0]

#: numbers of the coefficients of each group of an effect, among those of all effects
Groups = Sequence[Index]


def groups_by_effect(forms: Sequence[ChosenForm]) -> list[Groups]:
    """The groups of each effect: the coefficients of one label together."""
    effects: list[Groups] = []
    count = 0
    for form in forms:
        members: dict[str, list[int]] = {}
        for label in form.signature.labels:
            members.setdefault(label, []).append(count)
            count += 1
        every = members.values()
        effects.append([np.array(numbers, dtype=np.intp) for numbers in every])
    return effects


def updated_sizes(
    effects: Sequence[Groups], sizes: Array, values: Array, covariance: Array
) -> Array:
    """Sizes (k,) after an estimate (k,) of the coefficients that was made with others.

    sizes       (k,) prior standard deviations of the estimate
    covariance  (k, k) of the estimate
    """
    updated = sizes.copy()
    for groups in effects:
        table = []
        for members in groups:
            of_group = covariance[np.ix_(members, members)]
            prior = float(sizes[members[0]])
            likelihood = _by_readings_alone(values[members], of_group, prior)
            table.append(_log_evidences(*likelihood))
        for members, size in zip(groups, _group_sizes(np.array(table)), strict=True):
            updated[members] = size
    return updated


def _by_readings_alone(
    values: Array, covariance: Array, prior: float
) -> tuple[Array, Array]:
    """An estimate divided by its prior N(0, prior^2): values (k,), variances (k,).

    Both are along the principal axes of the covariance (k, k).
    """
    variance, axes = np.linalg.eigh(covariance)
    variance = np.maximum(variance, np.finfo(float).tiny)
    precision = np.maximum(1.0 / variance - prior**-2, LEAST * prior**-2)
    return axes.T @ values / variance / precision, 1.0 / precision


def _log_evidences(values: Array, variances: Array) -> Array:
    """Log evidence (S,) of each size for a group's values (k,)."""
    total = variances + SIZES[:, None] ** 2
    return np.asarray(-0.5 * (np.log(total) + values**2 / total).sum(axis=1))


def _group_sizes(table: Array) -> Array:
    """Sizes (g,) of the groups of an effect, from their log evidences (g, S)."""
    log_shares = EFFECT_SIZES.log_shares
    larger = log_shares[-len(SIZES) + 1 :]
    log_common = np.append(special.logsumexp(log_shares[: -len(larger)]), larger)
    common = _median(log_common + _log_mixtures(table).sum(axis=0))
    far = np.full(len(SIZES), -np.inf)
    far[common] = np.log1p(-FAR_SHARE)
    beyond = len(SIZES) - common - 1
    if beyond:
        far[common + 1 :] = np.log(FAR_SHARE / beyond)
    return SIZES[[_median(far + row) for row in table]]


def _log_mixtures(table: Array) -> Array:
    """Log evidence (g, S) of groups at a common size, each with its chance to be far."""
    mixtures = table.copy()
    for k in range(len(SIZES) - 1):
        beyond = special.logsumexp(table[:, k + 1 :], axis=1)
        far = np.log(FAR_SHARE / (len(SIZES) - k - 1)) + beyond
        mixtures[:, k] = np.logaddexp(np.log1p(-FAR_SHARE) + table[:, k], far)
    return mixtures


def _median(log_weights: Array) -> int:
    """Number of the median size."""
    shares = np.cumsum(special.softmax(log_weights))
    return int(np.searchsorted(shares, 0.5))
