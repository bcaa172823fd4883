"""Recursions along chains for many laws at once, by blocks of steps side by side.

Step after step, a recursion takes a loop as long as the chain. The recursions here can
be composed: a block of S steps is one step of the same kind. Blocks run side by side,
what one hands on to the next follows in T / S steps, and nothing is approximated
(Blelloch 1990, Prefix sums and their applications, section 1.4).

Arrays in blocks are (S, ..., B): step within the block, then whatever, then the block.
"""

from __future__ import annotations

import math

import numpy as np

from oed.base.arrays import Array

#: steps of a chain that are one block: a loop over them costs no more than blocks do
ONE_BLOCK = 40
#: steps after which products of matrices are scaled, far from underflow
SCALED_EVERY = 8


def block_shape(steps: int) -> tuple[int, int]:
    """Steps of a block, and blocks, of a chain: about as many of the one as of the other."""
    length = max(steps, 1) if steps <= ONE_BLOCK else math.isqrt(steps - 1) + 1
    return length, -(-max(steps, 1) // length)


def in_blocks(values: Array, fill: float = 0.0) -> Array:
    """Values (..., T) as blocks (S, ..., B), filled up at the end."""
    steps = values.shape[-1]
    length, count = block_shape(steps)
    padded = np.full((*values.shape[:-1], count * length), fill)
    padded[..., :steps] = values
    blocks = padded.reshape(*values.shape[:-1], count, length)
    return np.ascontiguousarray(np.moveaxis(blocks, -1, 0))


def out_of_blocks(blocks: Array, steps: int) -> Array:
    """Blocks (S, ..., B) as values (..., T): the inverse of `in_blocks`."""
    values = np.ascontiguousarray(np.moveaxis(blocks, 0, -1))
    return np.asarray(values.reshape(*values.shape[:-2], -1)[..., :steps])


def next_steps(blocks: Array) -> Array:
    """The next step's values (S, ..., B) at each step; 0 at the last."""
    after = np.zeros_like(blocks)
    after[:-1] = blocks[1:]
    after[-1, ..., :-1] = blocks[0, ..., 1:]
    return after


def states_at_starts(pole: Array, drive: Array) -> Array:
    """States s (..., B) before the first step of each block, of s_k+1 = a_k s_k + b_k.

    pole   (S, ..., B) a, of axes that broadcast to those of the drive
    drive  (S, ..., B) b

    The first state of a chain is 0.
    """
    starts: Array = np.zeros_like(drive[0])
    blocks = starts.shape[-1]
    if blocks == 1:
        return starts
    ends = drive[0].copy()
    for k in range(1, len(drive)):
        ends *= pole[k]
        ends += drive[k]
    whole = np.prod(pole, axis=0)
    for b in range(blocks - 1):
        starts[..., b + 1] = whole[..., b] * starts[..., b] + ends[..., b]
    return starts


def carried_variances(decay: Array, carried: Array) -> Array:
    """Variances p of what is carried to a reading, given the readings before it.

    decay    (S, L, C, B) d_k of what is carried along, from the reading before
    carried  (L,) share f of what is carried along

        p_k = f (1 - d_k^2) + d_k^2 u_k-1,    u_k = (1 - f) p_k / (p_k + 1 - f),

    u_-1 = 0: Riccati's recursion of the filter. It is a fraction of linear functions of
    u_k-1, which 2 x 2 matrices compose; their entries are positive, so that products lose
    no digits.
    """
    share = carried[:, None, None]
    alone, square = 1.0 - share, decay**2
    fresh = share * (1.0 - square)
    unknown = _variances_at_starts(square, fresh, alone)
    variance = np.empty_like(decay)
    for k in range(len(decay)):
        variance[k] = fresh[k] + square[k] * unknown
        unknown = alone * variance[k] / (variance[k] + alone)
    return variance


def _variances_at_starts(square: Array, fresh: Array, alone: Array) -> Array:
    """u (L, C, B) before the first step of each block."""
    starts: Array = np.zeros_like(square[0])
    blocks = starts.shape[-1]
    if blocks == 1:
        return starts
    # columns of the product of a block's matrices: what u = infinity and u = 0 become
    high, low = np.ones_like(starts), np.zeros_like(starts)
    high_over, low_over = np.zeros_like(starts), np.ones_like(starts)
    for k in range(len(square)):
        for top, over in ((high, high_over), (low, low_over)):
            carried = square[k] * top + fresh[k] * over
            np.multiply(alone, carried, out=top)
            over *= alone
            over += carried
        if k % SCALED_EVERY == 0:
            size = high + high_over + low + low_over
            for part in (high, high_over, low, low_over):
                part /= size
    for b in range(blocks - 1):
        u = starts[..., b]
        top = high[..., b] * u + low[..., b]
        starts[..., b + 1] = top / (high_over[..., b] * u + low_over[..., b])
    return starts
