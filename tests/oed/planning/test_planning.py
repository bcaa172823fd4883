"""Stages against simulations, dense updates and closed forms, the search against all plans."""

import dataclasses
import math
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest
from oracles import planar_geometry as oracle
from shipped_models import planar_2dof, pose_tracker, relative

from kernel import plan_catalogues as catalogues
from kernel.plan_catalogues import capture, linear_option, searched, stage_after
from oed import Component, Measurement, mount
from oed.accuracy import ErrorMaps
from oed.design import Nuisances
from oed.design.forms.protocol import pairwise_traces
from oed.instrument import Channel, Cost, Instrument
from oed.linear_algebra import symmetric_root
from oed.measurement import Series
from oed.model import Coordinate, Machine, Parameter
from oed.planning import (
    Goal,
    Option,
    PlanProblem,
    PlanStreams,
    build_option,
    search_plan,
    travel,
    workspace_goal,
)
from oed.planning import prediction as stage_module
from oed.planning.prediction import predict_stage, profile
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve
from pkm_studies.study import Study

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


SIGMA, EFFECTS = 5e-6, 4
PLANAR = Path(__file__).parents[3] / "studies" / "planar_plan.study.toml"


def tracker(name: str, seed: int) -> tuple[Option, Measurement, Series]:
    """Positions of the tool, which drawn effects change, and their measurement."""
    setup = mount(pose_tracker.position, name, sigma=(SIGMA,) * 3)
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 4), np.linspace(0.2, 1.3, 3))
    measurement = Measurement(machine, [setup])
    command = np.column_stack([y.ravel(), z.ravel()])
    series = measurement.series(name, command)
    rng = np.random.default_rng(seed)
    columns = 20e-6 * rng.standard_normal((36, EFFECTS))
    nuisances = Nuisances(columns, 10e-6 * rng.random(36))
    times = {"mounting_seconds": 60.0, "reading_seconds": 10.0}
    few = {"name": name, "counts": (3, 6), "nuisances": nuisances}
    option = build_option(machine, [setup], [series], **few, **times)
    return option, measurement, series


def dense_update(prior, option, measurement, chosen):
    """Covariance of machine and effects after readings, set-up unknowns integrated out."""
    numbers = (3 * chosen[:, None] + np.arange(3)).ravel()
    slopes = measurement.jacobian(option.series, measurement.nominal)[numbers]
    slopes = (slopes * measurement.tolerance)[:, measurement.free]
    free = int(measurement.free[: len(machine.parameters)].sum())
    nuisances = option.candidates.nuisances
    h = np.hstack([slopes[:, :free], nuisances.columns[numbers]])
    of_setup = slopes[:, free:]
    scatter = nuisances.scatter[numbers]
    noise = np.diag(SIGMA**2 + scatter**2) + of_setup @ of_setup.T
    gain = prior @ h.T @ np.linalg.inv(noise + h @ prior @ h.T)
    return np.asarray(prior - gain @ h @ prior)


def test_stages_carry_what_is_known_of_the_effects():
    first, one, _ = tracker("first", 1)
    second, two, _ = tracker("second", 2)
    prior = np.eye(first.machine_columns)
    assert len(prior) == int(one.free[: len(machine.parameters)].sum()) + EFFECTS
    rng = np.random.default_rng(0)
    everything = np.ones(12)
    chosen = np.array([0, 3, 7, 11])
    after_first = predict_stage(first, chosen, prior, everything, rng, exact=False)
    expected = dense_update(prior, first, one, chosen)
    assert after_first.covariance == pytest.approx(expected, rel=1e-6, abs=1e-9)
    others = np.array([1, 5, 10])
    known = after_first.posterior
    after_both = predict_stage(second, others, known, everything, rng, exact=False)
    expected = dense_update(expected, second, two, others)
    assert after_both.covariance == pytest.approx(expected, rel=1e-5, abs=1e-9)
    with_residual = predict_stage(first, chosen, prior, everything, rng)
    ratio = np.diag(with_residual.covariance) / np.diag(after_first.covariance)
    assert (ratio > 1.0 - 1e-9).all()


def test_the_bound_holds_over_all_plans():
    """Every plan of one option, with all errors that no reading reduces."""
    option, measurement, _ = tracker("only", 3)
    command = np.array([[-1.0, 0.4], [0.0, 0.9], [1.0, 0.6]])
    maps = ErrorMaps.of(measurement.kinematics, command)
    rng = np.random.default_rng(4)
    tool = 15e-6 * rng.standard_normal((3, len(maps.names), EFFECTS))
    rest = np.full(len(maps.names), 1e-12)
    goal = workspace_goal(
        measurement, maps, {}, SimpleNamespace(tool=tool, others=rest)
    )
    budget = 60.0 + 6 * 10.0
    streams, start = PlanStreams.seeded([1]), np.eye(goal.parameters)
    problem = PlanProblem((option,), goal, budget, 1, start, streams)
    found = search_plan(problem)
    assert found.best.value >= found.bound.value * (1.0 - 1e-9)
    for _ in range(200):
        chosen = rng.choice(12, size=6, replace=False)
        covariance = dense_update(
            np.eye(goal.parameters), option, measurement, np.sort(chosen)
        )
        value = goal.value(covariance)
        assert value >= found.bound.value * (1.0 - 1e-9)
        assert value >= found.best.value * 0.98


def with_effects(folder: Path, effects: str, machines: int) -> Path:
    """The planar plan with effects and virtual machines."""
    text = PLANAR.read_text(encoding="utf-8")
    study = folder / "planar_plan.study.toml"
    lines = f"virtual_machines = {machines}\neffects = {effects}"
    changed = text.replace("virtual_machines = 200", lines)
    assert changed != text
    study.write_text(changed, encoding="utf-8")
    return study


@pytest.mark.parametrize(("effects", "machines", "words"), [
    ('"catalogue"', 200, "virtual machines"),
    ('["wind"]', 0, r"effects\[1\].*no such effect"),
])  # fmt: skip
def test_what_a_plan_cannot_allow_for_is_refused(tmp_path, effects, machines, words):
    study = Study.load(with_effects(tmp_path, effects, machines))
    with pytest.raises(InputError, match=words):
        resolve(study, readings=[])


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
