"""Test of which legs carry a selected effect, from its coefficients' posterior."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.data.diagnosis import Block
from oed.gap.data.tail import log_tail


def effect_legs(
    labels: Sequence[str],
    mean: Array,
    covariance: Array,
    *,
    scale: float | Array = 1.0,
) -> tuple[Block, ...]:
    """Blocks (`leg 1`) that carry an effect, the clearest first.

    labels        (k,) block of each coefficient; those without ("") are not reported,
                  but taken into account
    mean          (k,) posterior mean of the coefficients
    covariance    (k, k) posterior covariance of the coefficients
    scale         prior standard deviation, one or (k,)

    A block's posterior is N(m, V), its prior N(0, S): W = (V^-1 - S^-1)^-1 is the
    variance of the estimate b = W V^-1 m that the readings give with the other
    coefficients under their prior. b^T W^-1 b is a chi-square of as many degrees of
    freedom as the block has columns where it carries nothing. Holm's rule (1979)
    corrects the p-values. `strength` is the block's share of the signatures' energies
    m^T G^T M G m. Raises ValueError for shapes that differ.
    """
    prior = np.broadcast_to(np.asarray(scale, dtype=float), mean.shape)
    count = len(mean)
    if covariance.shape != (count, count) or len(labels) != count:
        raise ValueError(
            f"{len(labels)} labels, mean {mean.shape} and covariance {covariance.shape}"
            " do not fit"
        )
    m, V = mean / prior, covariance / np.outer(prior, prior)
    information = np.linalg.inv(V) - np.eye(count)
    names = [n for n in dict.fromkeys(labels) if n]
    log_p, energy = [], []
    for name in names:
        at = [k for k, label in enumerate(labels) if label == name]
        block, block_mean = np.ix_(at, at), m[at]
        log_p.append(_log_p(V[block], block_mean))
        by_block = float(block_mean @ information[block] @ block_mean)
        energy.append(max(by_block, 0.0))
    total = max(sum(energy), 1e-300)
    running, blocks = 0.0, []
    for rank, k in enumerate(np.argsort(log_p, kind="stable")):
        log_holm = log_p[k] + np.log(len(names) - rank)
        running = max(running, float(np.exp(min(log_holm, 0.0))))
        blocks.append(Block(names[k], running, energy[k] / total))
    return tuple(blocks)


def _log_p(covariance: Array, mean: Array) -> float:
    """Log p-value of no effect, from a block's posterior in prior standard deviations."""
    inverse = np.linalg.inv(covariance)
    values, vectors = np.linalg.eigh(inverse - np.eye(len(mean)))
    largest = np.abs(values).max(initial=1.0)
    informed = values > 1e-9 * largest
    turned = (vectors.T @ (inverse @ mean))[informed]
    energy = np.array(turned**2 / values[informed]).sum()
    return float(log_tail(energy, float(informed.sum())))
