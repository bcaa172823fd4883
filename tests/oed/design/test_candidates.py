"""Candidates of a plan: information of readings and of runs, and the rules over them."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from kernel import a3_plans
from oed.design import Candidates
from oed.design.forms.determinant import Determinant

M = a3_plans.measurement()
SERIES = a3_plans.circles(M, 6)
(NAME,) = M.setups


def exact_information(rows: np.ndarray) -> np.ndarray:
    """Over the free parameters in tolerances, of white readings."""
    jacobian = M.jacobian([SERIES], M.nominal)[rows] * M.tolerance
    white = jacobian[:, M.free] / M.sigma([SERIES])[rows, None]
    return white.T @ white


def test_single_readings_add_up_to_the_information_of_all():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    assert len(candidates) == len(SERIES)
    assert candidates.shared_errors == 0
    assert candidates.prior is None
    some = np.array([0, 3, 7])
    total = np.einsum("ckn,ckm->nm", *[candidates.blocks[some]] * 2)
    assert total == pytest.approx(exact_information(some), rel=1e-9)
    (part,) = candidates.readings_of(some)
    assert part.q[part.index[:, 0]] == pytest.approx(SERIES.q[SERIES.index[some, 0]])
    commands = SERIES.command[SERIES.index[:, 0]]
    assert candidates.command == pytest.approx(commands)


def test_a_whole_run_has_the_information_of_its_readings():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance", whole_runs=True)
    runs = list(dict.fromkeys(SERIES.run))
    assert len(candidates) == len(runs)
    for block, run in zip(candidates.blocks, runs, strict=True):
        rows = np.flatnonzero(SERIES.run == run)
        assert block.T @ block == pytest.approx(exact_information(rows), rel=1e-9)
    seconds = M.reading_seconds(NAME)
    count = np.array([(SERIES.run == run).sum() for run in runs])
    assert candidates.cost == pytest.approx(seconds * count)


def test_prior_information_is_added_on_the_parameters():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    n = candidates.columns
    twice = candidates.add_prior(np.eye(n)).add_prior(2.0 * np.eye(n))
    assert twice.prior == pytest.approx(3.0 * np.eye(n))
    assert candidates.prior is None
    assert isinstance(candidates.criterion("D"), Determinant)


def test_readings_too_near_each_other_are_nearer_than_one():
    candidates = Candidates.build(M, [SERIES], M.nominal, "tolerance")
    apart = np.array([0.0, 0.5, 0.0])
    distance = candidates.rules(size=4, apart=apart).distance
    assert distance.least == 1.0
    assert distance.position[:, 1] == pytest.approx(candidates.command[:, 1] / 0.5)
    assert (distance.position[:, [0, 2]] == 0.0).all()
    time = candidates.rules(budget=100.0).time
    assert time.cost == pytest.approx(candidates.cost)


def test_candidates_are_counted_through_their_series():
    series = [["a", "b", "c"], ["d", "e"], ["f"]]
    pool: Any = SimpleNamespace(members=np.arange(6)[:, None], series=series)
    found = (Candidates.reading(pool, k) for k in range(6))
    assert [rows[k] for rows, k in found] == list("abcdef")
