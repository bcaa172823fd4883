"""Weights in a study: D, A and E by each solver, against cvxpy's own atoms; refusals."""

from __future__ import annotations

import sys
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from design_sample import KNOWN, chosen, rows, section, text

from pkm_studies import stages, study
from pkm_studies.base import InputError

SOLVERS = ("built_in", "clarabel")


def oracle(x: np.ndarray, name: str, size: float) -> float:
    """The optimum of the conventional value over weights, with a prior of 1.

    In coordinates where the information at even weights is 1: entries near one for the
    solver.
    """
    n = x.shape[1]
    even = np.eye(n) + x.T @ x * (size / len(x))
    turn = np.linalg.inv(np.linalg.cholesky(even))
    turned, prior = x @ turn.T, turn @ turn.T
    weights, least = cp.Variable(len(x), nonneg=True), cp.Variable()
    m = prior + turned.T @ cp.diag(weights) @ turned
    limits = [weights <= 1, cp.sum(weights) == size]
    if name == "D":
        goal = cp.log_det(m) - 2.0 * np.linalg.slogdet(turn)[1]
    elif name == "A":
        goal = -cp.matrix_frac(turn, m)
    else:
        goal = least
        limits.append(m - least * prior >> 0)
    return float(cp.Problem(cp.Maximize(goal), limits).solve(solver="CLARABEL"))


def conventional(m: np.ndarray, name: str) -> float:
    """log det, minus the trace of the inverse, or the least eigenvalue."""
    if name == "D":
        return float(np.linalg.slogdet(m)[1])
    if name == "A":
        return -float(np.trace(np.linalg.inv(m)))
    return float(np.linalg.eigvalsh(m)[0])


@pytest.mark.parametrize("solver", SOLVERS)
@pytest.mark.parametrize("name", ["D", "A", "E"])
def test_weights_reach_the_optimum_and_the_plan_has_the_largest(
    name: str, solver: str
) -> None:
    design = f'criterion = "{name}"\nmethod = "relaxed"\nsolver = "{solver}"\n' + KNOWN
    resolved, plan = chosen(text(design))
    record = section(resolved, plan)
    relaxed, x = record.relaxed, rows(resolved)
    assert relaxed is not None
    assert relaxed.solver == solver
    best = oracle(x, name, 3.0)
    at_weights, above = relaxed.value, relaxed.bound
    accuracy = 1e-4 * max(abs(best), 1.0)
    assert at_weights == pytest.approx(best, abs=accuracy)
    assert above >= best - 1e-6 * max(abs(best), 1.0)
    assert above == pytest.approx(best, abs=accuracy)
    total = sum(candidate.weight for candidate in relaxed.weights)
    assert total == pytest.approx(3.0, abs=1e-4)
    m = np.eye(x.shape[1]) + x[plan.choice.indices].T @ x[plan.choice.indices]
    assert plan.choice.value == pytest.approx(conventional(m, name), rel=1e-6)
    assert plan.choice.bound == above
    assert plan.choice.value <= above
    heaviest = [c.command for c in relaxed.weights[:3]]
    planned = [reading.command for reading in record.poses]
    assert sorted(map(str, planned)) == sorted(map(str, heaviest))


def test_a_study_with_weights_runs(tmp_path: Path) -> None:
    path = tmp_path / "weights.study.toml"
    path.write_text(text('criterion = "D"\nmethod = "relaxed"\n' + KNOWN))
    result = stages.run_study(study.load(path), tmp_path / "out")
    design = result.design
    assert design is not None
    assert design.relaxed is not None
    assert design.relaxed.weights
    assert design.n == 3
    assert "largest of the relaxation's weights" in design.words


@pytest.mark.parametrize(
    ("design", "field", "words"),
    [
        ('method = "relaxed"\ncriterion = "kappa"\n', "method", "not kappa"),
        ('method = "relaxed"\nbranch_nodes = 5\n', "method", "branch_nodes"),
        ('method = "relaxed"\nequal = "setup"\n', "method", "equal"),
        ('method = "relaxed"\ncompare = ["A"]\n', "method", "compare"),
        ('solver = "scs"\n', "solver", 'method = "relaxed"'),
    ],
)
def test_what_weights_do_not_go_with_is_refused(
    design: str, field: str, words: str
) -> None:
    with pytest.raises(InputError) as error:
        chosen(text(design + KNOWN))
    assert f"design.{field}" in str(error.value)
    assert words in str(error.value)


def test_a_solver_that_is_not_installed_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "scs", None)
    with pytest.raises(InputError, match=r"pip install pkm-oed\[scs\]"):
        chosen(text('method = "relaxed"\nsolver = "scs"\n' + KNOWN))
