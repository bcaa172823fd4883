"""Recursions by blocks against the same step after step."""

from __future__ import annotations

import numpy as np
import pytest

from oed.noise import recursions

LENGTHS = [1, 7, 40, 41, 100, 137]


@pytest.mark.parametrize("steps", LENGTHS)
def test_blocks_have_all_values_in_their_order(
    steps: int, rng: np.random.Generator
) -> None:
    values = rng.standard_normal((3, steps))
    blocks = recursions.in_blocks(values)
    assert blocks.shape[0] * blocks.shape[-1] >= steps
    np.testing.assert_array_equal(recursions.out_of_blocks(blocks, steps), values)
    after = recursions.out_of_blocks(recursions.next_steps(blocks), steps)
    np.testing.assert_array_equal(after[:, :-1], values[:, 1:])


@pytest.mark.parametrize("steps", LENGTHS)
def test_states_before_each_block_are_those_of_the_loop(
    steps: int, rng: np.random.Generator
) -> None:
    pole, drive = rng.uniform(-0.9, 0.9, steps), rng.standard_normal(steps)
    states = [0.0]
    for a, b in zip(pole, drive, strict=True):
        states.append(a * states[-1] + b)
    blocks = recursions.in_blocks(pole), recursions.in_blocks(drive)
    starts = recursions.states_at_starts(*blocks)
    size = len(blocks[0])
    assert starts == pytest.approx([states[size * k] for k in range(len(starts))])


@pytest.mark.parametrize("steps", LENGTHS)
@pytest.mark.parametrize("share", [0.3, 1.0 - 1e-9])
def test_variances_are_those_of_the_filter(
    steps: int, share: float, rng: np.random.Generator
) -> None:
    """Conditional variances of an AR(1) process in white noise, by dense matrices."""
    decay = rng.uniform(0.2, 0.98, steps)
    decay[0] = 0.0
    log_products = np.cumsum(np.log(np.r_[1.0, decay[1:]]))
    apart = np.abs(log_products[:, None] - log_products)
    process = share * np.exp(-apart)
    readings = process + (1.0 - share) * np.eye(steps)
    wanted = np.empty(steps)
    for k in range(steps):
        gain = np.linalg.solve(readings[:k, :k], process[:k, k])
        wanted[k] = process[k, k] - process[k, :k] @ gain
    blocks = recursions.in_blocks(decay)[:, None, None]
    variances = recursions.carried_variances(blocks, np.array([share]))
    told = recursions.out_of_blocks(variances, steps)[0, 0]
    assert told == pytest.approx(wanted, rel=1e-6, abs=1e-12)
