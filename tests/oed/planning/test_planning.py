"""Stages against simulations and closed forms, the search against all plans."""

import dataclasses
import math
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from oracles import planar_geometry as oracle
from shipped_models import planar_2dof, relative

from kernel import plan_catalogues as catalogues
from kernel.plan_catalogues import capture, searched, stage_after
from oed import Component
from oed.instrument import Channel, Cost, Instrument, mount
from oed.measurement import Measurement
from oed.model import Coordinate, Machine, Parameter
from oed.planning import Goal, Option, build_option, travel
from oed.planning import prediction as stage_module

machine = planar_2dof.machine

TILT = 1e-3
TOLERANCE = np.array([p.tolerance for p in machine.parameters])


def line_option(number, limit=math.inf, whole_runs=False):
    """An RM of Chang et al. on the paper's lines; its ruler's direction is unknown."""
    instrument = getattr(relative, f"rm{number}")
    tolerances = {n.name: TILT for n in instrument.nuisances}
    setup = mount(instrument, "rm", tolerances=tolerances)
    pose, line = oracle.lines(number)
    series = Measurement(machine, [setup]).series(
        "rm", pose, run=[str(k) for k in line]
    )
    few = {"name": f"rm{number}", "counts": (3, 30), "whole_runs": whole_runs}
    return build_option(machine, [setup], [series], travel=limit, **few)


def everything(option: Option) -> np.ndarray:
    return np.arange(len(option.candidates))


# -- a stage ---------------------------------------------------------------------------
def simulate(number, channel, sigma, limit, rng, draws):
    """Linear readings of drawn planar machines by the oracle's rows.

    Returns the estimates' errors (draws, 7) in tolerance units, their covariances
    (draws, 7, 7), and which readings are within the travel (draws, N). Covariances are
    joint inverses over machine and tilt, with all readings' correlated noise.
    """
    pose, line = oracle.lines(number)
    values = oracle.rows(pose)
    along = pose[:, 1 - channel]
    h = np.column_stack(
        [oracle.relative(values[:, channel], line), -oracle.relative(along, line)]
    )
    h *= np.append(TOLERANCE, TILT)
    first = {k: int(np.flatnonzero(line == k)[0]) for k in np.unique(line)}
    labels = np.array([k for i, k in enumerate(line) if i != first[k]])
    noise = sigma**2 * (np.eye(len(labels)) + (labels[:, None] == labels[None]))
    theta = rng.standard_normal((draws, 8))
    exact = theta @ h.T
    normals = rng.standard_normal((draws, len(labels)))
    y = exact + normals @ np.linalg.cholesky(noise).T
    within = np.abs(exact) <= limit
    covariances, errors = np.zeros((draws, 7, 7)), np.zeros((draws, 7))
    for k in range(draws):
        rows = h[within[k]]
        gain = np.linalg.solve(noise[np.ix_(within[k], within[k])], rows).T
        covariance = np.linalg.inv(np.eye(8) + gain @ rows)
        covariances[k] = covariance[:7, :7]
        errors[k] = (theta[k] - covariance @ gain @ y[k, within[k]])[:7]
    return errors, covariances, within


def test_a_stage_leaves_the_errors_of_simulated_machines(rng):
    """4000 machines scatter as predicted; the tilt is profiled out, lines share noise."""
    option = line_option(4)
    stage = stage_after(option, everything(option), np.eye(7), rng, exact=False)
    errors, covariances, _ = simulate(4, 0, 3e-6, np.inf, rng, 4000)
    assert stage.covariance == pytest.approx(covariances.mean(axis=0), abs=1e-8)
    scatter = errors.T @ errors / len(errors)
    values, vectors = np.linalg.eigh(stage.covariance)
    ratio = np.diag(vectors.T @ scatter @ vectors) / values
    assert ratio == pytest.approx(np.ones(7), abs=0.12)
    assert stage.information == pytest.approx(
        np.linalg.inv(stage.covariance) - np.eye(7), rel=1e-6, abs=1e-3
    )


def test_lost_readings_leave_the_mean_covariance_of_the_machines(rng, monkeypatch):
    option = line_option(4, limit=0.6e-3)
    monkeypatch.setattr(stage_module, "FIRST_LOOK_DRAWS", 4000)
    stage = stage_after(option, everything(option), np.eye(7), rng, exact=False)
    errors, covariances, within = simulate(4, 0, 3e-6, 0.6e-3, rng, 4000)
    assert 0.3 < within.mean() < 0.9
    expected = covariances.mean(axis=0)
    assert stage.covariance == pytest.approx(expected, abs=0.03)
    assert np.diag(stage.covariance) == pytest.approx(np.diag(expected), rel=0.05)
    # machines that lose readings have errors a little larger than their covariance
    # says: they are far off
    assert np.mean(errors**2, axis=0) == pytest.approx(np.diag(expected), rel=0.15)
    # the tilts' difference, which readings of all machines determine to 1 %, is lost
    # with the machines that give none
    difference = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, -1.0])
    unlimited = line_option(4)
    full = stage_after(unlimited, everything(option), np.eye(7), rng, exact=False)
    variance = difference @ full.covariance @ difference
    assert difference @ stage.covariance @ difference > 100.0 * variance


@pytest.mark.parametrize("whole_runs", [False, True])
def test_capture_probabilities_are_shares_of_exact_machines(rng, whole_runs):
    """The oracle's exact readings of 6000 machines and rulers, singly and by line."""
    option = line_option(5, limit=1e-3, whole_runs=whole_runs)
    pose, line = oracle.lines(5)
    p = oracle.NOMINAL + TOLERANCE * rng.standard_normal((6000, 1, 7))
    errors = oracle.forward(oracle.inverse(pose), p) - pose
    deviation = np.array([oracle.relative(e[:, 0], line) for e in errors])
    within = np.abs(deviation) <= 1e-3
    if whole_runs:
        within = within.reshape(len(within), 3, -1).all(axis=2)
    assert 0.2 < within.mean() < 0.95
    share = within.mean(axis=0)
    tolerance = 0.05 if whole_runs else 0.025
    assert capture(option, np.eye(7)) == pytest.approx(share, abs=tolerance)
    bound = travel.capture_probability_bound(option, np.eye(7))
    assert (bound >= share - 0.025).all()


def test_the_capture_probability_of_a_mixture_is_the_mean():
    option = line_option(4, limit=0.6e-3)
    mixture = np.stack([np.eye(7), 0.01 * np.eye(7)])
    each = [capture(option, covariance) for covariance in mixture]
    mean = np.mean(each, axis=0)
    assert capture(option, mixture) == pytest.approx(mean, abs=1e-12)
    assert (each[0] < each[1] - 1e-3).all()


BEND = 100.0  #: 1/m
BENT = Machine(
    name="bent",
    source="invented",
    pose=(Coordinate("u", "m"), Coordinate("v", "m")),
    joints=(Coordinate("q1", "m", -1.0, 1.0), Coordinate("q2", "m", -1.0, 1.0)),
    command=(Coordinate("u", "m", -1.0, 1.0), Coordinate("v", "m", -1.0, 1.0)),
    parameters=(Parameter("p", 0.0, 1e-3, "m"), Parameter("fixed", 0.0, 0.0, "m")),
    components=(
        Component("u", "m", compensatable=True),
        Component("v", "m", compensatable=True),
    ),
    home={"u": 0.0, "v": 0.0},
    lever=1.0,
    closure=lambda x, q, p: [
        x["u"] - q["q1"] - p["p"] - BEND * p["p"] ** 2,
        x["v"] - q["q2"] - p["fixed"],
    ],
    platform=lambda x: (ca.SX.eye(3), ca.vertcat(x["u"], x["v"], 0.0)),
    commanded=lambda x, tip: [tip[0], tip[1]],
    target=lambda c: [c["u"], c["v"]],
    guess=lambda c: ([c["u"], c["v"]], [c["u"], c["v"]]),
    read_error=lambda c, twist: [twist[0], twist[1]],
)
RULE = Instrument(
    name="rule", source="invented", channels=(Channel("u", "m", 2e-3),), settings=(),
    nuisances=(), cost=Cost(1.0, 1.0), observe=lambda frames, s, k: [frames[0].point[0]],
)  # fmt: skip


def parabola_option(count: int) -> Option:
    """The parabola, read `count` times."""
    setup = mount(RULE, "rule")
    commands = np.linspace(-0.5, 0.5, 2 * count).reshape(count, 2)
    series = Measurement(BENT, [setup]).series("rule", commands)
    return build_option(BENT, [setup], [series], name="rule", counts=(count,))


def test_the_linearisation_residual_of_a_parabola(rng, monkeypatch):
    """y = p + k p^2 read N times: p has the variance v = 1 / (1/t^2 + N/s^2).

    The residual k p^2 has the rms sqrt(3) k v. It is the same in all N readings and
    scatters by sqrt(2) k v: no number of readings averages it out.
    """
    option = parabola_option(4)
    monkeypatch.setattr(stage_module, "RESIDUAL_DRAWS", 20000)
    stage = stage_after(option, everything(option), np.eye(1), rng, draws=40000)
    variance = 1.0 / (1e6 + 4 / 4e-6)
    rms = np.full(4, np.sqrt(3.0) * BEND * variance)
    assert stage.linearisation_rms == pytest.approx(rms, rel=0.03)
    expected = 1.0 / (1e6 + 1.0 / (4e-6 / 4 + 2.0 * (BEND * variance) ** 2))
    assert stage.covariance[0, 0] == pytest.approx(expected / 1e-6, rel=1e-3)
    assert stage.covariance[0, 0] > 1.002 * variance / 1e-6


def test_machines_fitted_by_the_exact_model_are_no_worse_than_the_residual_says(rng):
    """20000 parabolas scatter between the slope alone and the prediction."""
    option = parabola_option(4)
    stage = stage_after(option, everything(option), np.eye(1), rng)
    p = 1e-3 * rng.standard_normal((20000, 1))
    mean_of_four = p + BEND * p**2 + 1e-3 * rng.standard_normal(p.shape)
    grid = np.linspace(-5e-3, 5e-3, 401)
    residual = (mean_of_four - grid - BEND * grid**2) / 1e-3
    cost = residual**2 + (grid / 1e-3) ** 2
    estimate = grid[np.argmin(cost, axis=1)]
    scatter = np.mean((estimate - p[:, 0]) ** 2) / 1e-6
    assert 0.47 < scatter < 1.03 * stage.covariance[0, 0]


# -- the search ------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, eq=False)
class SmallProblem:
    """A catalogue with its goal and budget (s); values and times of all its plans."""

    options: list[Option]
    goal: Goal
    budget: float
    value: np.ndarray
    time: np.ndarray


def small_problem(seed: int) -> SmallProblem:
    """A catalogue without targets, of readings of one length."""
    rng = np.random.default_rng(seed)
    options, goal = catalogues.catalogue(rng)
    value, time = catalogues.every_plan(options, goal, 3)
    budget = float(rng.uniform(900.0, 2500.0))
    within = (time > 0.0) & (time <= budget * (1 + 1e-9))
    return SmallProblem(options, goal, budget, value[within], time[within])


def solved(problem: SmallProblem) -> catalogues.PlanSearchResult:
    return searched(problem.options, problem.goal, problem.budget, stages=3)


def test_the_plan_is_the_best_of_all():
    """Within 2 % of all sets of readings within the budget."""
    losses = []
    for seed in range(12):
        problem = small_problem(seed)
        result = solved(problem)
        assert result.best is result.most_accurate
        assert result.best.seconds <= problem.budget * (1 + 1e-9)
        losses.append(result.best.value / problem.value.min() - 1.0)
        assert losses[-1] > -1e-9
        assert result.loss >= losses[-1] - 1e-9
        assert result.reached
    assert max(losses) <= 0.02, losses


def test_the_front_only_falls():
    front = solved(small_problem(2)).front
    assert all(a.seconds < b.seconds and a.value > b.value for a, b in pairwise(front))
    assert front[0].stages == ()


def test_a_reading_takes_time():
    setup = mount(relative.rm4, "rm")
    series = Measurement(machine, [setup]).series(
        "rm", np.array([[0.0, 0.0], [0.0, 1.0]])
    )
    with pytest.raises(ValueError, match="every reading takes some time"):
        build_option(
            machine, [setup], [series], name="free", counts=(1,), reading_seconds=0.0
        )
