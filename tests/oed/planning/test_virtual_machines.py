"""Virtual machines in a plan's stages: gantries of the oracle, read and fitted."""

import functools
import math

import numpy as np
import pytest
from oracles import planar_geometry
from shipped_models import planar_2dof, pose_tracker

from kernel import plan_catalogues as catalogues
from oed.instrument import mount
from oed.measurement import Measurement
from oed.planning import Option, PlanStage, build_option, propagate, virtual_machines
from oed.planning.virtual_machines import (
    HALF_WIDTH,
    WorkspaceErrors,
    prepare_stages,
    refit_machines,
)

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
