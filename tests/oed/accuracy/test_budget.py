"""The uncertainty budget: sums, each source by its own random numbers, dense covariances."""

import dataclasses

import numpy as np
import pytest
from reference import tian_2016 as paper
from shipped_models import a3_head, ball_bar

from kernel import a3_plans, bar_circles
from oed import identifiability
from oed.accuracy import BudgetModel, ErrorMaps, budget, variance_over_machines
from oed.accuracy.budget import (
    BEYOND,
    CARRIED,
    LEVELS,
    SEAT,
    errors_of_readings,
    instrument_source,
    mean_products,
    mean_variance,
)
from oed.accuracy.maps import maps_by_reference
from oed.instrument import mount
from oed.measurement import Measurement, Series, draw_parameters, reading_structure
from oed.noise import Laws, ReadingStructure, SharedError
from oed.noise_law import NoisePrior

SIGMA, CUP_TOLERANCE = 0.5e-6, 20e-6
SHARED = 2.0  #: error of a run, over the noise of single readings
STROKES = (0.04, 0.08, 0.12, 0.16, 0.20)
POINTS = 12


def measured() -> tuple[Measurement, Series]:
    """Five circles, their levels errors of their runs."""
    channel = dataclasses.replace(ball_bar.CHANNEL, sigma=SIGMA, shared=SHARED)
    instrument = dataclasses.replace(ball_bar.instrument, channels=(channel,))
    tolerances = {f"cup_{n}": CUP_TOLERANCE for n in "xyz"}
    teach = (paper.TEACH_Z, 0.0, 0.0)
    setup = mount(instrument, "cup", teach=teach, tolerances=tolerances)
    m = Measurement(a3_head.machine, [setup])
    psi = np.tile(2 * np.pi * np.arange(POINTS) / POINTS, len(STROKES))
    commands = a3_plans.bar_commands(m, np.repeat(STROKES, POINTS), psi)
    runs = [f"{1e3 * s:.0f}" for s in np.repeat(STROKES, POINTS)]
    return m, m.series("cup", commands, runs)


@pytest.fixture(scope="module")
def plan() -> tuple[Measurement, Series]:
    return measured()


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
    level = rng.standard_normal((count, 5)).repeat(POINTS, axis=1)
    lines = {line.source: line for line in model.budget(maps).lines}
    size = {"noise": 0.5, "run": 1.0}.get(source, 1.0)
    shared = 0.0 if source == "run" else SHARED
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


N = 12
#: scales above and below the stated noise, a share carried along, a level, a seat
ONE = [np.array([x]) for x in (0.4, 3.0, 0.7, 0.5)]  # correlated, reach, level, seat
LAWS = Laws(np.array([[1.5, 0.8]]), *ONE)
BAR, CUP = instrument_source("bar"), instrument_source("cup")


@pytest.fixture
def structure(rng: np.random.Generator) -> ReadingStructure:
    """Two runs of six readings, one with each of two instruments."""
    run = np.repeat([0, 1], 6)
    return ReadingStructure(
        names=("a.length", "b.length"),
        group=run,
        chain=run,
        run=np.array([0, 1]),
        position=np.tile(np.arange(6.0), 2),
        unit=np.ones(N),
        decouple=None,
        columns=np.column_stack([np.ones(N), rng.standard_normal(N)]),
        kinds=np.array([SharedError.LEVEL, SharedError.RENEWED]),
    )


def test_noise_above_the_stated_one_is_its_own_source(structure, rng):
    errors = errors_of_readings(structure, LAWS, ["bar"] * 6 + ["cup"] * 6)
    assert set(errors.names) == {BAR, CUP, BEYOND, LEVELS, SEAT, CARRIED}
    first = np.repeat([1.0, 0.0], 6)
    assert errors.variances[BAR] == pytest.approx(first)
    assert errors.variances[BEYOND] == pytest.approx((0.6 * 2.25 - 1.0) * first)
    assert errors.variances[CUP] == pytest.approx((0.6 * 0.64) * (1.0 - first))
    gain = rng.standard_normal((N, 3))
    between = sum(0.384 * np.outer(row, row) for row in gain[6:])
    assert errors.between(CUP, gain) == pytest.approx(between)


FACTORS = (
    {}, {budget.CARRIED: 0.0}, {budget.LEVELS: 0.5, budget.SEAT: 0.0},
    {budget.COURSE: 0.5},
    {budget.instrument_source("bar"): 0.1, budget.BEYOND: 0.0},
)  # fmt: skip


@pytest.fixture(scope="module")
def circles() -> ReadingStructure:
    """Three circles of 40 readings, whose cup is seated at each."""
    return bar_circles.circles(40)


def covariance(structure, laws, factors):
    """The sum of the module's docstring, matrix by matrix, of one instrument."""
    share, scale = laws.correlated[0], laws.scale[0, structure.group]
    same_chain = structure.chain[:, None] == structure.chain
    distance = np.abs(structure.position[:, None] - structure.position)
    single = (1.0 - share) * scale**2
    stated = np.minimum(single, 1.0)
    of = {
        budget.instrument_source("bar"): np.diag(stated),
        budget.BEYOND: np.diag(single - stated),
        budget.CARRIED: share
        * np.exp(-distance / laws.reach[0])
        * same_chain
        * np.outer(scale, scale),
    }
    columns = structure.columns * laws.sizes[0, structure.kinds] * scale[:, None]
    for name, kinds in budget.SHARED_KINDS.items():
        some = columns[:, np.isin(structure.kinds, kinds)]
        of[name] = some @ some.T * same_chain
    course = structure.course * laws.course[0] * scale[:, None]
    of[budget.COURSE] = course @ course.T
    return sum(factors.get(name, 1.0) ** 2 * part for name, part in of.items())


@pytest.mark.parametrize("factors", FACTORS)
def test_errors_with_factors_are_those_of_dense_matrices(circles, factors):
    rng = np.random.default_rng(2)
    prior = NoisePrior.of(circles)
    laws = prior.laws(rng.standard_normal((1, prior.dimensions)))
    errors = budget.errors_of_readings(circles, laws, ["bar"] * len(circles))
    dense = covariance(circles, laws, factors)
    y = rng.standard_normal((len(circles), 3))
    exact = np.linalg.solve(dense, y)
    white = errors.whiten(y, factors)
    assert errors.weigh(y, factors) == pytest.approx(exact, rel=1e-8, abs=1e-8)
    assert white.T @ white == pytest.approx(y.T @ exact, rel=1e-9)
    name = budget.instrument_source("bar")
    stated = np.minimum((1.0 - laws.correlated[0]) * laws.scale[0, 0] ** 2, 1.0)
    assert errors.between(name, y) == pytest.approx(stated * y.T @ y)
