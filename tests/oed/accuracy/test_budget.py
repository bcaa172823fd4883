"""The uncertainty budget: sums, and each source by its own random numbers."""

import dataclasses

import numpy as np
import pytest

from kernel import a3_plans, budget_machines
from oed import identifiability
from oed.accuracy import BudgetModel, ErrorMaps, variance_over_machines
from oed.accuracy.budget import mean_products, mean_variance
from oed.accuracy.maps import maps_by_reference
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.noise import Laws


@pytest.fixture(scope="module")
def plan() -> tuple[Measurement, Series]:
    return budget_machines.measured()


@pytest.fixture(scope="module")
def model(plan: tuple[Measurement, Series]) -> BudgetModel:
    m, series = plan
    return BudgetModel.of(m, [series], m.nominal)


@pytest.fixture(scope="module")
def maps(plan: tuple[Measurement, Series]) -> ErrorMaps:
    return ErrorMaps.of(plan[0].kinematics, a3_plans.workspace()[::5])


def all_errors(plan: tuple[Measurement, Series]) -> Laws:
    """A law with every error that the noise model knows."""
    structure = reading_structure(plan[0], [plan[1]], plan[0].nominal)
    groups = len(structure.names)
    one = np.ones(1)
    scale = 1.4 * np.ones((1, groups))
    return Laws(scale, 0.3 * one, 4.0 * one, 0.7 * one, 0.5 * one, course=0.6 * one)


def test_the_parts_add_up_to_the_posterior_covariance(plan, model):
    m, series = plan
    h = identifiability.scaled(m, [series], m.nominal, "tolerance")
    wanted = identifiability.posterior_covariance(h) * np.outer(
        m.tolerance, m.tolerance
    )
    scale = np.abs(wanted[:24, :24]).max()
    assert model.covariance() == pytest.approx(wanted[:24, :24], abs=1e-6 * scale)
    parts = model.parts()
    assert [p.source for p in parts] == [
        "unknown set-up",
        "error shared by a run",
        "noise of ball_bar",
        "combinations that no reading determines",
        "pull of the tolerances",
    ]
    total = np.sum([p.covariance for p in parts], axis=0)
    assert total == pytest.approx(model.covariance(), abs=1e-6 * scale)
    for part in parts:
        values = np.linalg.eigvalsh(part.covariance)
        # the information squares condition numbers, and each part is a difference
        assert values[0] > -1e-7 * scale, part.source


def test_every_error_of_an_estimated_law_has_its_line(plan, maps):
    m, series = plan
    laws = all_errors(plan)
    model = BudgetModel.of(m, [series], m.nominal, laws=laws)
    estimated = 1.1 * model.covariance()
    predicted = 1.2 * mean_variance(mean_products(maps.raw), model.covariance())
    budget = model.budget(maps, estimated=estimated, predicted=predicted)
    assert [line.source for line in budget.lines] == [
        "unknown set-up",
        "run-to-run level",
        "error shared by a run",
        "set-up seated anew",
        "correlated noise of a run",
        "drift through the session",
        "noise beyond the stated one",
        "noise of ball_bar",
        "combinations that no reading determines",
        "pull of the tolerances",
        "estimated noise",
        "linearisation",
    ]
    total = np.sum([line.variance for line in budget.lines], axis=0)
    assert total == pytest.approx(budget.variance, rel=1e-6)
    assert budget.variance == pytest.approx(predicted)
    for of_sources in budget.shares().values():
        assert sum(of_sources.values()) == pytest.approx(1.0, abs=1e-6)


def realised(model, maps, errors, known):
    """Rms (k,) of ridge estimates of drawn parameters from drawn errors (d, N)."""
    rng = np.random.default_rng(7)
    covariance = np.cov(errors.T)
    truth = rng.standard_normal((len(errors), len(model.names)))
    free = ~model.setup if known else np.ones(len(model.names), dtype=bool)
    h = model.slopes[:, free]
    y = truth[:, free] @ h.T + errors
    weighed = np.linalg.solve(covariance, h)
    inner = h.T @ weighed + np.eye(h.shape[1])
    estimate = np.zeros_like(truth)
    estimate[:, free] = np.linalg.solve(inner, weighed.T @ y.T).T
    estimate[:, ~free] = truth[:, ~free]
    delta = ((truth - estimate) @ model.root.T)[:, model.used]
    poses = np.einsum("nkp,dp->dnk", maps.raw, delta)
    return np.asarray(np.sqrt(np.mean(poses**2, axis=(0, 1))))


@pytest.mark.parametrize("source", ["all", "run", "noise", "set-up"])
def test_without_a_source_ridge_estimates_are_as_good_as_stated(source, model, maps):
    rng, count = np.random.default_rng(3), 6000
    single = rng.standard_normal((count, len(model.slopes)))
    level = rng.standard_normal((count, 5)).repeat(budget_machines.POINTS, axis=1)
    lines = {line.source: line for line in model.budget(maps).lines}
    size = {"noise": 0.5, "run": 1.0}.get(source, 1.0)
    shared = 0.0 if source == "run" else budget_machines.SHARED
    errors = size * single + shared * level
    wanted = {
        "all": np.sqrt(model.budget(maps).variance),
        "run": lines["error shared by a run"].without,
        "noise": lines["noise of ball_bar"].halved,
        "set-up": lines["unknown set-up"].without,
    }[source]
    got = realised(model, maps, errors, known=source == "set-up")
    assert got == pytest.approx(wanted, rel=0.05)


def test_variance_over_machines_is_that_about_each_of_them(plan, monkeypatch):
    """One drawn machine: slopes about it, of a machine that has it as its nominal."""
    m, series = plan
    monkeypatch.setattr("oed.accuracy.budget.N_MACHINES", 1)
    command = a3_plans.workspace()[::20]
    got = variance_over_machines(
        m, [series], command, ("home", "best_fit"), np.random.default_rng(4)
    )
    truth = draw_parameters(m, np.random.default_rng(4), 1)[0]
    shifted = [
        dataclasses.replace(p, nominal=float(value))
        for p, value in zip(m.machine.parameters, truth, strict=False)
    ]
    other = Measurement(m.machine.with_parameters(shifted), list(m.setups.values()))
    covariance = BudgetModel.of(m, [series], truth).covariance()
    for reference, variance in got.items():
        maps = ErrorMaps.of(other.kinematics, command, reference)
        wanted = np.einsum("nkp,pq,nkq->nk", maps.raw, covariance, maps.raw)
        assert variance == pytest.approx(wanted, rel=1e-6)


def test_home_moves_with_the_tool(plan):
    kinematics = plan[0].kinematics
    machine, tool = kinematics.machine, np.array([0.0, 0.0, 0.1])
    near_home = machine.home_command[None] + [0.0, 0.4, 1e-3]
    moved = machine.with_tool(near_home, tool)
    assert moved[0, 0] == near_home[0, 0] + 0.1
    maps = maps_by_reference(kinematics, moved, ("home", "absolute"), tool)
    zeroed, absolute = (np.abs(maps[r].raw[:, :3]).max() for r in maps)
    assert zeroed < 3e-3 * absolute
