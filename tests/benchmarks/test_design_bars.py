"""What designs must reach: the problems of `benchmarks/design.py`, without their
timing, and the A3 head's criteria.

Values are computed here from the chosen rows; bounds of D are drawn here from the
weights alone.
"""

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import hexapod, peer_runs, peers
from oed import identifiability
from oed.design import choose, relax
from pkm_studies import study
from pkm_studies.resolve import resolve

ROOT = Path(__file__).resolve().parents[2]


def rows_a(count: int = 2000) -> np.ndarray:
    return np.random.default_rng(0).standard_normal((count, 21))


def log_det(blocks: np.ndarray, weights: np.ndarray) -> float:
    flat = blocks.reshape(-1, blocks.shape[-1])
    each = np.repeat(weights, len(flat) // len(blocks))
    return float(np.linalg.slogdet((flat.T * each) @ flat)[1])


def ceiling(blocks: np.ndarray, weights: np.ndarray, size: int) -> float:
    """No `size` different candidates have a larger log det: with d_i = tr(M^-1 A_i),
    log det M' is at most log det M + n log(sum of the `size` largest d_i / n), by the
    means of M^-1 M's eigenvalues.
    """
    n = blocks.shape[-1]
    flat = blocks.reshape(-1, n)
    each = np.repeat(weights, len(flat) // len(blocks))
    m = (flat.T * each) @ flat
    slopes = (
        np.sum(flat * np.linalg.solve(m, flat.T).T, axis=1)
        .reshape(len(blocks), -1)
        .sum(axis=1)
    )
    return float(
        np.linalg.slogdet(m)[1] + n * np.log(np.sort(slopes)[-size:].sum() / n)
    )


# -- rows of random numbers ------------------------------------------------------------
def test_problem_a_by_d():
    """30 of 2000 x 21: plan, bound, and how tight the bound is as a relaxation."""
    rows = rows_a()
    choice = choose(rows, 30, np.random.default_rng(1), rounds=100)
    reached = log_det(rows[choice.indices], np.ones(30))
    assert len(set(choice.indices.tolist())) == 30
    assert choice.value == pytest.approx(reached, abs=1e-9)
    assert reached >= 80.146
    relaxed = relax(rows, 30)
    upper = ceiling(rows, relaxed.weights, 30)
    assert choice.bound == pytest.approx(upper, abs=1e-6)
    assert upper == pytest.approx(log_det(rows, relaxed.weights), abs=1e-6)
    assert reached <= choice.bound <= 81.85880
    assert choice.efficiency == pytest.approx(np.exp((reached - upper) / 21), abs=1e-6)


def test_twenty_thousand_candidates_are_certified():
    rows = rows_a(20_000)
    relaxed = relax(rows, 30)
    reached = log_det(rows, relaxed.weights)
    assert relaxed.weights.sum() == pytest.approx(30.0)
    assert relaxed.weights.max() <= 1.0
    assert 21 * relaxed.value == pytest.approx(reached, abs=1e-8)
    assert reached - 1e-8 <= 21 * relaxed.bound <= reached + 1e-4
    assert ceiling(rows, relaxed.weights, 30) - reached <= 1e-4


# -- poses of a hexapod ----------------------------------------------------------------
#: the relaxation by Clarabel through cvxpy, from columns turned to the
#: unit matrix
CLARABEL = 263.13586


@pytest.mark.slow
def test_problem_c():
    """10 of 2000 poses for 42 parameters."""
    blocks = hexapod.blocks(0)
    assert blocks.shape == (2000, 6, 42)
    choice = choose(blocks, 10, np.random.default_rng(1), rounds=20)
    reached = log_det(blocks[choice.indices], np.ones(10))
    assert len(set(choice.indices.tolist())) == 10
    assert choice.directions == 42
    assert choice.value == pytest.approx(reached, abs=1e-6)
    assert choice.efficiency >= 0.88
    assert choice.efficiency == pytest.approx(
        np.exp((reached - choice.bound) / 42), abs=1e-6
    )
    upper = ceiling(blocks, relax(blocks, 10).weights, 10)
    assert choice.bound == pytest.approx(upper, abs=1e-5)
    assert choice.bound == pytest.approx(CLARABEL, abs=1e-4)


def test_problem_cs_noise_is_full():
    """10 um and 5 arcsec, every pair correlated."""
    cov = hexapod.covariance(np.random.default_rng(0))
    sigma = np.sqrt(np.diag(cov))
    assert sigma == pytest.approx([10e-6] * 3 + [np.deg2rad(5 / 3600)] * 3)
    pairs = (cov / np.outer(sigma, sigma))[np.triu_indices(6, 1)]
    assert (np.abs(pairs) > 1e-3).all()
    assert np.abs(pairs).max() < 0.6


# -- the A3 head by several criteria ---------------------------------------------------
def of_a3(rows: np.ndarray) -> dict[str, float]:
    """A plan by each criterion, over the 18 directions seen."""
    s = np.linalg.svd(rows, compute_uv=False)[:18]
    return {
        "D": 2.0 * float(np.log(s).sum()),
        "E": float(s[-1] ** 2),
        "kappa": float(s[0] / s[-1]),
    }


@pytest.mark.slow
def test_a3_designs_are_best_in_their_own_criterion():
    """30 of 1512 readings of the taught cup, and the paper's two circles of 15."""
    resolved = resolve(
        study.Study.load(ROOT / "studies" / "a3_ball_bar.study.toml"), readings=()
    )
    m = resolved.measurement
    rows = identifiability.scaled(m, resolved.candidates, m.nominal, "length")[
        :, m.free
    ]
    assert len(rows) == 1512
    choices = {
        name: choose(rows, 30, np.random.default_rng(1), name, rounds=rounds)
        for name, rounds in {"D": 60, "E": 5, "kappa": 5}.items()
    }
    plans = {name: of_a3(rows[choice.indices]) for name, choice in choices.items()}
    paper = next(p for p in resolved.reference_plans if p.name == "paper 2 x 15")
    plans["paper"] = of_a3(
        identifiability.scaled(m, paper.series, m.nominal, "length")[:, m.free]
    )
    for name, choice in choices.items():
        assert choice.directions == 18
        assert choice.value == pytest.approx(plans[name][name], rel=1e-6)
        sign = -1.0 if name == "kappa" else 1.0
        assert all(sign * plan[name] <= sign * choice.bound for plan in plans.values())
    assert plans["E"]["E"] > 1.3 * plans["D"]["E"]
    assert plans["kappa"]["kappa"] < plans["D"]["kappa"] / 1.1
    assert plans["D"]["D"] > max(plans["E"]["D"], plans["kappa"]["D"])
    assert choices["D"].efficiency >= 0.97
    assert np.exp((plans["paper"]["D"] - plans["D"]["D"]) / 18) == pytest.approx(
        0.68, abs=0.005
    )


# -- other packages --------------------------------------------------------------------
def test_values_of_other_packages_are_computed_here():
    rows = rows_a()
    chosen = np.random.default_rng(5).permutation(2000)[:30]
    m = rows[chosen].T @ rows[chosen]
    assert peers.value("A, D", chosen.tolist()) == (
        pytest.approx(np.linalg.slogdet(m)[1]),
        "",
    )
    assert peers.value("A, E", chosen.tolist()) == (
        pytest.approx(np.linalg.eigvalsh(m)[0]),
        "",
    )
    assert peers.value("A, D", [*chosen[:-1], chosen[0]])[1] == "1 repeated"
    assert peers.value("A, D", chosen[:-1])[1] == "29 runs"
    assert peers.value("A, D", [int(chosen[0])] * 30)[0] == -np.inf


def test_a_packages_own_value_is_not_used(tmp_path):
    """A stand-in for a package's interpreter: it claims a value, which is ignored; it
    names rows, which are judged.
    """
    chosen = list(range(30))
    answer = json.dumps(
        {"indices": chosen, "seconds": 0.25, "version": "9", "value": 1e9}
    )
    python = peer_runs.interpreter(tmp_path, "doekit")
    python.parent.mkdir(parents=True)
    python.write_text(f"#!/bin/sh\necho '{answer}'\n", encoding="utf-8")
    python.chmod(0o755)
    task = peers.Task("A, D", "KL exchange", lambda rows: None)
    row = peer_runs.run_task(tmp_path, "doekit", 0, task, 10.0)
    assert row.value == pytest.approx(log_det(rows_a()[chosen], np.ones(30)))
    said = (0.25, "doekit 9, KL exchange", None)
    assert (row.seconds, row.method, row.bound) == said
    assert (
        peer_runs.run_task(tmp_path, "pydoe", 0, task, 10.0).note
        == "skipped: not installed"
    )


def test_adapters_are_pinned_and_need_nothing_to_be_listed():
    assert len(peers.PEERS) >= 8
    for peer in peers.PEERS.values():
        assert "==" in peer.requires[0]
        assert peer.tasks
        assert {task.problem for task in peer.tasks} <= {"A, D", "A, E"}
