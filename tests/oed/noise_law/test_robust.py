"""Residuals far off: replaced where neighbours contradict them, and else as they are."""

import numpy as np
import pytest

from oed.noise import Laws, ReadingStructure
from oed.noise_law import robust_residuals
from oed.noise_law.outliers import MIN_READINGS


def single_run(count: int) -> ReadingStructure:
    """Readings of one channel in one run, which share nothing."""
    nothing = np.zeros(count, dtype=np.intp)
    return ReadingStructure(
        names=("cup.length",), group=nothing, chain=nothing, run=nothing[:1],
        position=np.arange(float(count)), unit=np.ones(count), decouple=None,
        columns=np.zeros((count, 0)), kinds=nothing[:0],
    )  # fmt: skip


def test_a_reading_far_off_is_replaced_and_the_others_are_not():
    """The machine may do anything that is linear along the run."""
    structure = single_run(60)
    line = np.column_stack([np.ones(60), np.linspace(-1.0, 1.0, 60)])
    rng = np.random.default_rng(7)
    residual = line @ np.array([20.0, -35.0]) + rng.standard_normal(60)
    mistaken = residual.copy()
    mistaken[17] += 60.0
    clean = robust_residuals(structure, Laws.stated(structure), mistaken, 100.0 * line)
    assert abs(clean[17] - residual[17]) < 4.0
    others = np.arange(60) != 17
    assert np.abs(clean - residual)[others].max() < 1.0
    assert mistaken[17] == residual[17] + 60.0


@pytest.mark.parametrize(("seed", "size"), [(1, 100.0), (3, 1e9)])
def test_what_the_machine_may_do_is_no_outlier(seed, size):
    """A column of any size determines it: what is left of 1 - 1 is rounding."""
    structure = single_run(30)
    residual = np.random.default_rng(seed).standard_normal(30)
    residual[4] += 60.0
    slopes = size * np.eye(30)[:, [4]]
    clean = robust_residuals(structure, Laws.stated(structure), residual, slopes)
    assert np.abs(clean - residual).max() < 1.0


def test_few_readings_stay_as_they_are():
    structure = single_run(MIN_READINGS - 1)
    residual = np.zeros(MIN_READINGS - 1)
    residual[0] = 1e3
    clean = robust_residuals(
        structure, Laws.stated(structure), residual, np.zeros((MIN_READINGS - 1, 0))
    )
    assert clean is not residual
    assert (clean == residual).all()
