"""Stages of a plan: profiled unknowns, and what rounding may do."""

import dataclasses

import numpy as np
import pytest

from kernel.plan_catalogues import linear_option, searched, stage_after
from oed.design.forms.protocol import pairwise_traces
from oed.linear_algebra import symmetric_root
from oed.planning import Goal, Option
from oed.planning.prediction import profile


def test_profiled_unknowns_leave_the_rows_of_the_joint_inverse(rng):
    """S' [1, -K] are the first rows of the joint inverse, and M - K K^T the noise."""
    n, s = 4, 2
    rows = rng.standard_normal((2, 9, 7))
    information = np.swapaxes(rows, 1, 2) @ rows
    prior = np.diag(rng.uniform(1.0, 5.0, n))
    profiled = profile(information, n, n + s)
    for k in range(2):
        joint = information[k] + np.eye(7)
        joint[:n, :n] += prior - np.eye(n)
        gain = np.linalg.inv(joint)[:n]
        covariance = np.linalg.inv(prior + profiled.machine[k])
        assert covariance == pytest.approx(gain[:, :n], rel=1e-9, abs=1e-12)
        by_setup = -covariance @ profiled.by_setup[k]
        assert by_setup == pytest.approx(gain[:, n : n + s], rel=1e-9, abs=1e-12)
        # other unknowns N(0, 1) and the noise, N(0, M), of the normal equations
        others = gain[:, n + s :]
        scatter = gain @ information[k] @ gain.T + others @ others.T
        noise = covariance @ profiled.noise[k] @ covariance
        assert noise == pytest.approx(scatter, rel=1e-9, abs=1e-12)


def test_roots_do_not_turn_where_eigenvalues_are_equal(rng):
    covariance = np.diag([2.0, 2.0, 2.0, 0.5])
    change = 1e-14 * rng.standard_normal((4, 4))
    near = covariance + change + change.T
    one, other = symmetric_root(np.array([covariance, near]))
    assert one @ one == pytest.approx(covariance, abs=1e-14)
    assert np.abs(one - other).max() < 1e-12


def losing_options(rng: np.random.Generator) -> list[Option]:
    """A rough option, and two precise ones that lose readings of machines far off."""
    # all directions are known equally well after the rough readings
    rough = 3.0 * np.vstack([np.eye(4), np.eye(4)])
    rough, times = (
        np.column_stack([rough, np.zeros(8)]),
        {"mounting": 300.0, "seconds": 60.0},
    )
    options = [linear_option("rough", rough, 4, counts=(4, 8), **times)]
    for name in ("a", "b"):
        rows = 30.0 * rng.standard_normal((12, 4))
        rows = np.column_stack([rows, np.full(12, 3.0)])
        options.append(
            linear_option(name, rows, 4, counts=(3, 6), travel=10.0, **times)
        )
    return options


def test_rounding_does_not_decide_which_plan_is_found(rng):
    """Rows that differ in their last digit lead to the same plan."""
    options = losing_options(rng)
    factors = rng.standard_normal((2, 2, 4))
    goal = Goal(("a", "b"), factors, np.ones(2), has_targets=False)
    first = searched(options, goal, 1800.0, stages=3, beam=3)
    assert any((s.probability < 0.9).any() for s in first.best.stages)
    changed = [_in_the_last_digit(option, rng) for option in options]
    other = searched(changed, goal, 1800.0, stages=3, beam=3)
    assert other.best.names == first.best.names
    assert other.best.value == pytest.approx(first.best.value, rel=1e-6)


def _in_the_last_digit(option: Option, rng: np.random.Generator) -> Option:
    blocks = option.candidates.blocks
    factor = 1.0 + 2e-16 * rng.integers(-1, 2, blocks.shape)
    candidates = dataclasses.replace(option.candidates, blocks=blocks * factor)
    return dataclasses.replace(option, candidates=candidates)


def test_a_stage_never_takes_information_away(rng):
    """Not even where machines that lose readings are farther off than believed."""
    _, option, _ = losing_options(rng)
    everything = np.arange(len(option.candidates))
    for _ in range(10):
        stage = stage_after(option, everything, np.eye(4), rng, exact=False)
        assert stage.lost_share > 0.5
        least = np.linalg.eigvalsh(stage.information)[0]
        assert least >= -1e-9 * np.trace(stage.information)


def test_rows_of_zeros_add_nothing_to_traces(rng):
    """tr(A_i P A_j Q) by the definition, for blocks of one to three rows."""
    blocks = rng.standard_normal((6, 3, 4))
    blocks[:3, 1:] = 0.0
    blocks[3, 2] = 0.0
    roots = rng.standard_normal((2, 4, 4))
    first, second = roots @ np.swapaxes(roots, 1, 2)
    a = np.swapaxes(blocks, 1, 2) @ blocks
    expected = [[np.trace(x @ first @ y @ second) for y in a] for x in a]
    traces = pairwise_traces(blocks, first, second)
    assert traces == pytest.approx(np.array(expected), rel=1e-10)
