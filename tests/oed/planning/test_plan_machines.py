"""Plans of measurements for machines, and virtual machines carried through their stages."""

import dataclasses
import functools
import itertools
import math

import numpy as np
import pytest
from oracles import planar_geometry
from oracles import planar_geometry as oracle
from shipped_models import a3_head, ball_bar, planar_2dof, pose_tracker, relative

from kernel import plan_catalogues as catalogues
from kernel.plan_catalogues import searched, stage_after
from oed.accuracy import ErrorMaps
from oed.instrument import mount
from oed.measurement import Measurement, commands_at_fixed_reading
from oed.model import Machine
from oed.planning import (
    Goal,
    Option,
    PlanSearchResult,
    PlanStage,
    build_option,
    propagate,
    virtual_machines,
    workspace_goal,
)
from oed.planning.virtual_machines import (
    HALF_WIDTH,
    WorkspaceErrors,
    prepare_stages,
    refit_machines,
)

#: cups (height, distance from the axis) in m, tools and bars in m
CUPS = ((1.126, 0.0), (1.126, 0.1), (1.306, 0.1), (1.286, 0.0))
HEIGHTS = 1.066 + np.array([0.0, 0.1, 0.2])
TILTS, TURNS = np.radians([5, 15, 25, 35]), np.arange(12) * np.pi / 6
#: commands over the workspace: z, psi, theta
WORKSPACE = np.array(
    [[z, psi, theta] for z, theta, psi in itertools.product(HEIGHTS, TILTS, TURNS)]
)


def a3(home: float, joint: float, beta: float) -> Machine:
    """The A3 head with tolerances of home positions, joints (m) and guides (rad)."""
    tolerances = {"dq": home, "be": beta}
    parameters = [
        dataclasses.replace(p, tolerance=tolerances.get(p.name[:2], joint))
        for p in a3_head.machine.parameters
    ]
    return a3_head.machine.with_parameters(parameters)


def bars(machine, cup, tools, lengths, around=12):
    """Ball bars of +-1 mm of travel about cups set by hand to `cup` (m)."""
    options = []
    for tool, length in itertools.product(tools, lengths):
        for height, offset in CUPS:
            option = bar(machine, cup, tool, length, (offset, height), around)
            if option is not None:
                options.append(option)
    return options


def bar(machine, cup, tool, length, cup_at, around):
    """One bar about a cup at (x, z); None where it reaches at most 20 poses."""
    x, z = cup_at
    name = (
        f"bar {1e3 * length:.0f}, tool {1e3 * tool:.0f}, cup {1e3 * z:.0f}"
        f" {1e3 * x:.0f}"
    )
    there = {"at_x": x, "at_y": 0.0, "at_z": z + tool, "tool": (0, 0, tool)}
    cups = {f"cup_{n}": cup for n in "xyz"}
    setup = mount(ball_bar.free_cup, name, tolerances=cups, length=length, **there)
    measurement = Measurement(machine, [setup])
    heights = np.linspace(1.066, 1.266, 7) + tool
    angles = np.arange(around) * 2.0 * np.pi / around
    grid = np.array([[h, psi, 0.0] for h in heights for psi in angles])
    command, possible = commands_at_fixed_reading(measurement, name, grid, "theta")
    if possible.sum() <= 20:
        return None
    series = measurement.series(name, command[possible])
    return build_option(
        machine, [setup], [series], name=name, counts=(6, 12, 24, 48), travel=1e-3
    )


def tracker(machine: Machine, name: str, sigma: float, mounting: float) -> Option:
    """Positions of the tool, from any distance."""
    setup = mount(pose_tracker.position, name, sigma=(sigma,) * 3)
    poses = itertools.product(HEIGHTS, np.arange(6) * np.pi / 3, (0.1, 0.4))
    series = Measurement(machine, [setup]).series(name, np.array(list(poses)))
    times = {"mounting_seconds": mounting, "reading_seconds": 30.0}
    return build_option(
        machine, [setup], [series], name=name, counts=(4, 8, 16), **times
    )


def relative_accuracy(machine: Machine, command: np.ndarray) -> Goal:
    """All components, relative to their accuracy before."""
    measurement = Measurement(machine, [])
    maps = ErrorMaps.of(measurement.kinematics, command, "home")
    return workspace_goal(measurement, maps, {})


@pytest.fixture(scope="module")
def unknown_home() -> PlanSearchResult:
    """Bars and a rough tracker, for home positions known to 8 mm."""
    machine = a3(8e-3, 0.3e-3, 5e-3)
    options = [
        *bars(machine, 0.2e-3, (0.0,), (0.3,)),
        tracker(machine, "rough", 0.2e-3, 1200.0),
    ]
    goal = relative_accuracy(machine, WORKSPACE)
    return searched(options, goal, 3600.0, stages=2, beam=4)


# -- which measurement at which stage --------------------------------------------------
def planar(budget: float) -> PlanSearchResult:
    """RM 1 to 5 of Chang et al. (2011): all lines of one together, in equal times."""
    machine, options = planar_2dof.machine, []
    for k in range(1, 6):
        setup = mount(getattr(relative, f"rm{k}"), f"rm{k}")
        pose, line = oracle.lines(k)
        series = Measurement(machine, [setup]).series(
            setup.name, pose, run=[str(v) for v in line]
        )
        lines = {"name": setup.name, "counts": (3,), "whole_runs": True}
        times = {"mounting_seconds": 600.0, "reading_seconds": 60.0 / len(series)}
        option = build_option(machine, [setup], [series], **lines, **times)
        options.append(option)
    y, z = np.linspace(-1.5, 1.5, 11), (0.0, 0.5, 1.0, 1.5)
    workspace = np.array(list(itertools.product(y, z)))
    return searched(options, relative_accuracy(machine, workspace), budget)


def machine_slopes(stage: PlanStage) -> np.ndarray:
    """Slopes (readings, 7) of a stage's readings over the planar machine."""
    measurement = stage.option.measurement
    return measurement.jacobian(stage.series, measurement.nominal)[:, :7]


def test_rm4_then_rm5_as_in_the_paper():
    """The paper's choice, certified; RM 5 alone is 19 times as weak."""
    two_stages, alone = planar(1320.0), planar(660.0)
    assert two_stages.best.names == ("rm4", "rm5")
    assert two_stages.loss < 0.01
    assert alone.best.names == ("rm5",)
    assert alone.best.value > 10.0 * two_stages.best.value
    rows = {k: oracle.identification_rows(k) for k in (4, 5)}
    weakest = [
        np.linalg.svd(r, compute_uv=False)[5]
        for r in (np.vstack([rows[4], rows[5]]), rows[5])
    ]
    assert weakest[0] / weakest[1] == pytest.approx(19.0, rel=0.02)
    # the readings behind the two plans are those rows
    for plan, expected in ((two_stages.best, weakest[0]), (alone.best, weakest[1])):
        h = np.vstack([machine_slopes(stage) for stage in plan.stages])
        singular_values = np.linalg.svd(h, compute_uv=False)
        assert singular_values[5] == pytest.approx(expected, rel=1e-6)


# -- virtual machines through a plan ---------------------------------------------------
def check_stages(realisation, ratio, coverage):
    """Accuracy, coverage and losses of every stage, within limits."""
    for stage in realisation.stages:
        within = (stage.ratio > ratio[0]) & (stage.ratio < ratio[1])
        assert within.all(), (stage.name, stage.ratio)
        for share in (stage.coverage, stage.pose_coverage):
            assert coverage[0] < share < coverage[1], (stage.name, share)
        assert stage.realised_loss == pytest.approx(stage.predicted_loss, abs=0.02)


def test_virtual_machines_are_as_accurate_as_predicted(unknown_home):
    stages = unknown_home.best.stages
    realisation = propagate(stages, WORKSPACE[::2], 25, np.random.default_rng(5))
    assert realisation.names == ("x", "y", "z", "psi", "theta", "phi")
    check_stages(realisation, (0.6, 1.5), (0.88, 0.99))
    goal = relative_accuracy(a3(8e-3, 0.3e-3, 5e-3), WORKSPACE[::2])
    predicted = goal.accuracy(stages[-1].covariance) * goal.unit
    assert realisation.stages[-1].predicted == pytest.approx(predicted, rel=1e-9)


def test_compensation_brings_the_bar_s_readings_back():
    """Few of the second bar's readings are lost, where its own travel is short."""
    machine = a3(2e-3, 0.3e-3, 5e-3)
    rough = tracker(machine, "rough", 50e-6, 600.0)
    one_bar = bars(machine, 0.2e-3, (0.0,), (0.3,))[0]
    rng = np.random.default_rng(2)
    prior = np.eye(24 - len(machine.frame))
    first = stage_after(rough, np.arange(16), prior, rng)
    second = stage_after(one_bar, np.arange(0, 48, 2), first.posterior, rng)
    stages, rng = [first, second], np.random.default_rng(6)
    realisation = propagate(stages, WORKSPACE[::12], 12, rng)
    assert realisation.stages[1].realised_loss < 0.02
    # a bar alone, on the machine before any stage
    bar = stage_after(one_bar, np.arange(0, 48, 2), prior, rng)
    alone = propagate([bar], WORKSPACE[::12], 12, rng)
    assert alone.stages[0].realised_loss > 0.5


def test_machines_are_drawn_from_an_earlier_posterior():
    """The second stage alone, from the first one's covariance, is as good as both."""
    first, second = planar(1320.0).best.stages
    y, z = (-1.5, -0.5, 0.5, 1.5), (0.0, 0.7, 1.5)
    workspace = np.array(list(itertools.product(y, z)))
    start = first.covariance
    rng = np.random.default_rng(0)
    after_first = stage_after(second.option, second.chosen, start, rng)
    alone = propagate(
        [after_first], workspace, 60, np.random.default_rng(2), start=start
    ).stages[0]
    both = propagate([first, second], workspace, 60, np.random.default_rng(2))
    assert alone.predicted == pytest.approx(both.stages[1].predicted, rel=1e-3)
    assert ((alone.ratio > 0.75) & (alone.ratio < 1.3)).all(), alone.ratio
    assert 0.88 < alone.coverage < 0.99
    # drawn from the tolerances instead, the same stage alone is far worse
    from_tolerances = stage_after(second.option, second.chosen, np.eye(7), rng)
    apart = propagate([from_tolerances], workspace, 5, rng).stages[0]
    assert apart.predicted[0] > 5.0 * alone.predicted[0]


position = pose_tracker.position

SETUP = mount(position, "tracker")
M = Measurement(planar_2dof.machine, [SETUP])
GRID = np.array([(y, z) for y in (-1.2, -0.4, 0.5, 1.3) for z in (0.0, 0.7, 1.4)])
COMMAND = np.array([[0.1, 0.2], [-1.0, 1.0], [0.9, 1.3]])
HOME = planar_2dof.machine.home_command


@functools.cache
def option(travel: float = math.inf) -> Option:
    series = M.series("tracker", GRID)
    few, times = (
        {"name": "tracker", "counts": [12]},
        {"mounting_seconds": 60.0, "reading_seconds": 10.0},
    )
    return build_option(
        planar_2dof.machine, [SETUP], [series], travel=travel, **few, **times
    )


@functools.cache
def stage() -> PlanStage:
    rng = np.random.default_rng(1)
    return catalogues.stage_after(option(), np.arange(12), np.eye(7), rng)


def machines(rng: np.random.Generator, count: int) -> np.ndarray:
    """Drawn gantries whose tracker stands where it is assumed to."""
    theta = M.nominal + M.tolerance * rng.standard_normal((count, len(M.nominal)))
    theta[:, 7:] = 0.0
    return theta


def test_machines_are_read_at_the_oracles_poses(rng):
    """Joints are those that a controller with its own parameters sends."""
    (virtual,) = prepare_stages([stage()])
    assert list(virtual.measurement.setups) == ["1. tracker"]
    truth = machines(rng, 2)
    controller = truth[:, :7] + 0.3 * (M.nominal[:7] - truth[:, :7])
    controller[:, 5:] = 0.0
    none = np.zeros((2, 36))
    read = virtual.read(truth, truth, controller, none)
    for k in (0, 1):
        joints = planar_geometry.inverse(GRID, controller[k])
        pose = planar_geometry.forward(joints, truth[k, :7])
        exact = np.column_stack([np.zeros(12), pose])
        assert read.y[k].reshape(12, 3) == pytest.approx(exact, abs=1e-9)
    assert read.captured.all()
    assert read.lost_share == pytest.approx([0.0, 0.0])


def test_readings_beyond_the_travel_are_lost_with_their_candidate(rng):
    chosen = catalogues.stage_after(option(5e-4), np.arange(12), np.eye(7), rng)
    (virtual,) = prepare_stages([chosen])
    truth, expected = machines(rng, 1), M.nominal[None].copy()
    truth[0, 7] = 4e-4  # along x, the first channel: within the travel
    read = virtual.read(truth, expected, None, np.zeros((1, 36)))
    assert read.captured.all()
    truth[0, 7] = 6e-4
    read = virtual.read(truth, expected, None, np.zeros((1, 36)))
    assert not read.captured.any()
    assert read.lost_share == pytest.approx([1.0])


def test_refitted_machines_are_the_regularised_solution(rng):
    """The cost has no slope at the fit, by differences of exact readings."""
    series = [M.series("tracker", GRID)]
    truth = M.nominal + M.tolerance * rng.standard_normal((2, 13))
    sigma = M.sigma(series)
    y = M.readings(series, truth) + sigma * rng.standard_normal((2, 36))
    captured = np.ones((2, 36), dtype=bool)
    captured[1, :6] = False
    fits = refit_machines(M, series, y, captured, np.tile(M.nominal, (2, 1)))
    for fit, read, use in zip(fits, y, captured, strict=True):

        def white(theta: np.ndarray, read: np.ndarray, use: np.ndarray) -> np.ndarray:
            residual = (read - M.readings(series, theta)) / sigma
            free = M.free
            prior = (theta - M.nominal)[free] / M.tolerance[free]
            return np.concatenate([residual[use], prior])

        jacobian = []
        for change in np.diag(1e-3 * M.tolerance)[M.free]:
            ahead = white(fit.theta + change, read, use)
            behind = white(fit.theta - change, read, use)
            jacobian.append((ahead - behind) / 2e-3)
        slopes = np.array(jacobian)
        covariance = np.linalg.inv(slopes @ slopes.T)
        step = covariance @ (slopes @ white(fit.theta, read, use))
        assert np.abs(step / np.sqrt(np.diag(covariance))).max() < 1e-3
        scale = M.tolerance[M.free]
        exact = covariance * np.outer(scale, scale)
        found = fit.covariance[np.ix_(M.free, M.free)]
        assert np.diag(found) == pytest.approx(np.diag(exact), rel=1e-3)


def test_a_machine_fitted_alone_is_as_among_the_others(rng, monkeypatch):
    """One whose fit among the others does not converge, and lost readings."""
    series = [M.series("tracker", GRID)]
    truth = M.nominal + M.tolerance * rng.standard_normal((3, 13))
    sigma = M.sigma(series)
    y = M.readings(series, truth) + sigma * rng.standard_normal((3, 36))
    captured = np.ones((3, 36), dtype=bool)
    captured[1, :6] = False
    arguments = (M, series, y, captured, np.tile(M.nominal, (3, 1)))
    together = refit_machines(*arguments)
    fit_all = virtual_machines._refits
    calls = []

    def without_the_second(problem, z):
        calls.append(len(z))
        fits = fit_all(problem, z)
        return fits if len(z) == 1 else [fits[0], None, fits[2]]

    monkeypatch.setattr(virtual_machines, "_refits", without_the_second)
    apart = refit_machines(*arguments)
    assert calls == [3, 1]
    sd = np.sqrt(np.diag(together[1].covariance)[M.free])
    change = (apart[1].theta - together[1].theta)[M.free]
    assert np.abs(change / sd).max() < 1e-3
    assert apart[1].covariance == pytest.approx(together[1].covariance, rel=1e-6)


def test_errors_over_the_workspace_are_the_oracles(rng):
    """Both machines at the joints that a nominal controller sends; less that at home."""
    errors = WorkspaceErrors.of(M, COMMAND, "home")
    nominal = np.tile(M.nominal[:7], (2, 1))
    truth = machines(rng, 2)[:, :7]
    found = errors.errors(nominal, nominal, truth)
    joints = planar_geometry.inverse(np.vstack([COMMAND, HOME]))
    for k in (0, 1):
        off = planar_geometry.forward(joints, truth[k]) - np.vstack([COMMAND, HOME])
        assert found[k] == pytest.approx(off[:-1] - off[-1], abs=1e-9)
    # coverage: a covariance so wide, or so narrow, that all errors are in, or out
    for size, share in ((1e2, 1.0), (1e-6, 0.0)):
        wide = np.tile(np.diag((size * M.tolerance[:7]) ** 2), (2, 1, 1))
        both = errors.evaluate(nominal, nominal, truth, wide, np.zeros(2))
        assert both.coverage == pytest.approx([share, share])
        assert both.pose_coverage == pytest.approx([share, share])
        assert both.lost_share.tolist() == [0.0, 0.0]
    assert pytest.approx(1.959964) == HALF_WIDTH


def test_predicted_errors_are_differences_of_the_oracles_poses():
    errors = WorkspaceErrors.of(M, COMMAND, "home")
    joints, step = planar_geometry.inverse(np.vstack([COMMAND, HOME])), 1e-3
    variance = np.zeros((3, 2))
    for change in np.diag(step * M.tolerance[:7]):
        ahead = planar_geometry.forward(joints, M.nominal[:7] + change)
        behind = planar_geometry.forward(joints, M.nominal[:7] - change)
        slope = (ahead - behind) / (2.0 * step)
        variance += (slope[:-1] - slope[-1]) ** 2
    free = int((M.tolerance[:7] > 0.0).sum())
    exact = np.sqrt(variance.mean(axis=0))
    assert errors.predicted(np.eye(free)) == pytest.approx(exact, rel=1e-5)


def test_propagated_machines_are_as_accurate_as_predicted():
    """Ratios of 30 machines; the same seed gives the same ones."""
    first, again = (
        propagate([stage()], COMMAND, 30, np.random.default_rng(2)) for _ in range(2)
    )
    (one,), (other,) = first.stages, again.stages
    assert (one.realised == other.realised).all()
    assert ((one.ratio > 0.6) & (one.ratio < 1.5)).all()
    assert one.coverage == pytest.approx(0.95, abs=0.05)
    assert (one.predicted_loss, one.realised_loss) == (0.0, 0.0)
    with pytest.raises(ValueError, match="at least one of each is needed"):
        propagate([], COMMAND, 3, np.random.default_rng(2))
