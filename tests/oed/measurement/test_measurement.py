"""Readings: against the oracles, by hand, and what a series keeps track of."""

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import delta_trilateration as delta
from shipped_models import a3_head, ball_bar, calliper, height_probe, linear_delta

from kernel import a3_plans
from kernel.cases import CASES
from oed import identifiability
from oed.instrument import Channel, Cost, Instrument, mount
from oed.measurement import (
    Measurement,
    commands_at_fixed_reading,
    draw_parameters,
    draw_readings,
)
from oed.mechanism import AssemblyError
from oed.model import Parameter

TOOL = 0.05


def wrong(m: Measurement, rng: np.random.Generator, n: int = 5) -> np.ndarray:
    """Parameter vectors (n, ...) of wrong machines, frame parameters and nuisances included."""
    return m.nominal + np.array(
        [p.tolerance for p in m.parameters]
    ) * rng.standard_normal((n, len(m.names)))


@pytest.mark.parametrize("tool", [0.0, TOOL])
@pytest.mark.parametrize("taught", [True, False])
def test_ball_bar_readings_and_rows_are_the_oracles(rng, taught, tool):
    m = a3_plans.measurement(taught=taught, tools=[tool])
    (setup,) = m.setups
    command = CASES["a3_head"].commands(rng, 40) + np.array([tool, 0, 0])
    series = m.series(setup, command)
    q, z = a3.inverse_nominal(*command.T, tool), a3.Z_TEACH + tool
    theta = wrong(m, rng)
    p, offset = theta[:, :24], theta[:, 24:]
    cup = a3.taught_cup(p, offset, z, tool) if taught else np.array([0, 0, z]) + offset
    exact = a3.ball_bar_reading(p[:, None], q, cup[:, None], tool)
    assert np.abs(m.readings([series], theta) - exact).max() < 1e-12
    nominal_cup = np.array([0, 0, z])
    rows = a3.bar_rows(*np.maximum(command, [0, -9, 1e-3]).T, nominal_cup, tool, taught)
    upright = command[:, 2] < 1e-3
    assert np.abs(m.jacobian([series], m.nominal) - rows)[~upright].max() < 1e-12 * 10


def test_calliper_distances_are_the_oracles(rng):
    """Three runs of different length; the first pose of each is its reference and no reading."""
    m = Measurement(linear_delta.machine, [mount(calliper.instrument, "calliper")])
    command = CASES["linear_delta"].commands(rng, 9)
    runs = ["a", "b", "a", "a", "b", "c", "b", "c", "a"]
    series = m.series("calliper", command, run=runs)
    assert series.run.tolist() == ["a", "a", "b", "b", "c", "a"]
    theta = wrong(m, rng)
    p = theta[:, None]
    point = delta.nozzle(series.q, p[..., 0], p[..., 1:4], p[..., 4:7], p[..., 7:10])
    pairs = [(2, 0), (3, 0), (4, 1), (6, 1), (7, 5), (8, 0)]
    distance = [np.linalg.norm(point[:, i] - point[:, j], axis=-1) for i, j in pairs]
    exact = (1 + theta[:, 10:]) * np.stack(distance, axis=-1)
    assert np.abs(m.readings([series], theta) - exact).max() < 1e-13
    assert (series.reading_commands() == command[[2, 3, 4, 6, 7, 8]]).all()


def test_a_controller_that_knows_better_sends_other_joints(rng):
    """With the true parameters height and the taught cup are exact."""
    m = Measurement(a3_head.machine, [mount(height_probe.instrument, "probe")])
    truth = wrong(m, rng, 1)[0]
    truth[24] = 0.0
    command = CASES["a3_head"].commands(rng, 20)
    knowing = m.series("probe", command, controller=truth[:24])
    assert np.abs(m.readings([knowing], truth) - command[:, 0]).max() < 1e-14
    plain = m.readings([m.series("probe", command)], truth)
    assert np.abs(plain - command[:, 0]).max() > 1e-4


@pytest.mark.parametrize("name", list(CASES["a3_head"].setups))
def test_taking_readings_of_a_series(rng, name):
    m = Measurement(a3_head.machine, [CASES["a3_head"].setups[name]])
    runs = np.repeat(["a", "b", "c"], 5) if name == "calliper" else None
    series = m.series(name, CASES["a3_head"].commands(rng, 15), run=runs)
    rows = np.array([7, 2, 2, 11])
    part = series.take(rows)
    theta = wrong(m, rng, 1)[0]
    assert len(part) == 4
    channels = len(m.setups[name].sigma)
    flat = (rows[:, None] * channels + np.arange(channels)).ravel()
    assert m.readings([part], theta) == pytest.approx(
        m.readings([series], theta)[flat], abs=1e-15
    )
    assert m.jacobian([part], theta) == pytest.approx(
        m.jacobian([series], theta)[flat], abs=1e-13
    )
    assert (part.reading_commands() == series.reading_commands()[rows]).all()
    assert (part.run == series.run[rows]).all()
    assert len(part.q) < len(series.q)


def test_a_bar_leads_the_tool_on_a_sphere():
    """By the oracle's bisection; where the bar cannot be held, it says so."""
    m = a3_plans.measurement()
    psi = np.linspace(0, 2 * np.pi, 25)
    command = np.column_stack([np.full(25, a3_plans.HOME_Z + 0.12), psi, np.zeros(25)])
    found, possible = commands_at_fixed_reading(m, "cup", command, "theta")
    assert possible.all()
    exact = a3.circle_theta(command[:, 0], psi, np.array([0, 0, a3.Z_TEACH]))
    assert np.abs(found[:, 2] - exact).max() < 1e-11
    assert (command[:, 2] == 0).all()
    assert np.abs(m.readings([m.series("cup", found)], m.nominal) - 0.3).max() < 1e-12
    bar = mount(ball_bar.instrument, "bar", teach=(1.286, 0, 0), length=0.05)
    short = Measurement(m.machine, [bar])
    _, possible = commands_at_fixed_reading(short, "bar", command, "theta")
    assert not possible.any()


def test_only_a_bar_holds_a_reading():
    m = Measurement(a3_head.machine, [mount(height_probe.instrument, "probe")])
    with pytest.raises(
        ValueError, match="height_probe holds no reading by design: give theta itself"
    ):
        commands_at_fixed_reading(
            m, "probe", a3_head.machine.home_command[None], "theta"
        )


def two_channels() -> Instrument:
    """An instrument with two channels and an unknown, written down here."""
    return Instrument(
        name="two", source="this test", settings=(), cost=Cost(1.0, 1.0),
        channels=(Channel("along", "m", 1e-6), Channel("angle", "rad", 2e-6)),
        nuisances=(Parameter("gain", 1.0, 0.1, "1"),),
        observe=lambda frames, s, k: [
            s["gain"] * frames[0].point[0], s["gain"] * frames[0].rotation[0, 2],
        ],
    )  # fmt: skip


def test_several_set_ups_and_channels_are_laid_out_in_order(rng):
    setups = [mount(two_channels(), "two"), mount(height_probe.instrument, "probe")]
    m = Measurement(a3_head.machine, setups)
    command = CASES["a3_head"].commands(rng, 6)
    series = [m.series("probe", command[:2]), m.series("two", command[2:])]
    theta = wrong(m, rng)
    assert m.names[24:] == ("two.gain", "probe.offset")
    pose = a3.forward(theta[:, None, :24], a3.inverse_nominal(*command.T))
    heights = pose.tip[:, :2, 2] + theta[:, 25:]
    seen = np.stack([pose.tip[:, 2:, 0], pose.R[:, 2:, 0, 2]], axis=-1)
    both = theta[:, 24, None, None] * seen
    exact = np.hstack([heights, both.reshape(5, -1)])
    assert np.abs(m.readings(series, theta) - exact).max() < 1e-13
    assert m.sigma(series) == pytest.approx([20e-6] * 2 + [1e-6, 2e-6] * 4)
    h = m.jacobian(series, theta[0])
    assert h.shape == (10, 26)
    assert (h[:2, 24] == 0).all()
    assert (h[2:, 25] == 0).all()
    assert h[2:, 24] == pytest.approx(both[0].ravel() / theta[0, 24], abs=1e-13)


def test_posterior_covariance_in_units_of_the_tolerances(rng):
    for n in (2, 5, 9):
        h = 10.0 ** rng.uniform(-2, 3, n)[:, None] * rng.standard_normal((n, 6))
        assert identifiability.posterior_covariance(h) == pytest.approx(
            np.linalg.inv(np.eye(6) + h.T @ h), rel=1e-7, abs=1e-9
        )
    blind = np.array([[1e6, 1e6, 0.0]])
    assert identifiability.posterior_covariance(blind)[2].tolist() == [0.0, 0.0, 1.0]
    shared = blind @ identifiability.posterior_covariance(blind) @ blind.T
    assert shared == pytest.approx(1.0, abs=1e-3)


def test_a_pose_that_cannot_be_assembled_at_some_parameters(rng):
    m = Measurement(linear_delta.machine, [mount(height_probe.instrument, "probe")])
    series = m.series("probe", CASES["linear_delta"].commands(rng, 5))
    theta = np.tile(m.nominal, (3, 1))
    theta[1, 1] = 0.05  # no arm of 50 mm reaches
    y = m.try_readings([series], theta)
    assert np.isnan(y[1]).all()
    assert np.isfinite(y[[0, 2]]).all()
    with pytest.raises(AssemblyError, match=r"linear_delta: .* cannot be assembled"):
        m.readings([series], theta)


def test_slopes_where_readings_were_asked_for_solve_no_pose_again(rng, monkeypatch):
    m, other = a3_plans.measurement(), a3_plans.measurement()
    (setup,) = m.setups
    some, more = (m.series(setup, CASES["a3_head"].commands(rng, 12)) for _ in range(2))
    there, elsewhere = wrong(m, rng, 2)
    solved: list[int] = []
    solve = m.kinematics.try_forward
    monkeypatch.setattr(
        m.kinematics,
        "try_forward",
        lambda q, *rest: solved.append(len(q)) or solve(q, *rest),
    )
    for series, theta, times in [
        (some, there, 1),
        (some, elsewhere, 1),
        (more, elsewhere, 1),
        (more, elsewhere, 0),
    ]:
        solved.clear()
        y, slopes = m.readings([series], theta), m.jacobian([series], theta)
        assert len(solved) == times
        assert (y == other.readings([series], theta)).all()
        assert (slopes == other.jacobian([series], theta)).all()
        # a parameter vector that is changed in place is another one
        theta += 1e-5
        assert (m.readings([series], theta) == other.readings([series], theta)).all()
        theta -= 1e-5
        m.readings([series], theta)


def test_virtual_machines_scatter_as_stated(rng):
    """2000 draws: each spread is known to 1.6 %."""
    m = Measurement(linear_delta.machine, [mount(height_probe.instrument, "probe")])
    truth = draw_parameters(m, rng, 2000)
    spread = truth.std(axis=0) / np.where(m.free, m.tolerance, 1.0)
    assert spread[m.free] == pytest.approx(1.0, abs=0.08)
    assert (truth[:, ~m.free] == m.nominal[~m.free]).all()
    assert truth.mean(axis=0) == pytest.approx(m.nominal, abs=0.1 * m.tolerance.max())
    series = m.series("probe", CASES["linear_delta"].commands(rng, 3))
    y = draw_readings(m, [series], np.tile(truth[0], (2000, 1)), rng)
    assert y.std(axis=0) == pytest.approx(20e-6, rel=0.08)
    assert y.mean(axis=0) == pytest.approx(m.readings([series], truth[0]), abs=3e-6)
    assert draw_parameters(m, rng).shape == m.nominal.shape


def test_machines_with_joints_of_their_own(rng):
    """Readings and slopes of several machines at once are those of each alone."""
    m = a3_plans.measurement(taught=True, tools=[TOOL])
    (setup,) = m.setups
    theta = wrong(m, rng, 3)
    command = CASES["a3_head"].commands(rng, 12) + np.array([TOOL, 0, 0])
    alone = [m.series(setup, command, controller=p[:24]) for p in theta]
    q, start = np.array([s.q for s in alone]), np.array([s.start for s in alone])
    together = dataclasses.replace(alone[0], q=q, start=start)
    y, slopes = m.readings([together], theta), m.jacobian([together], theta)
    for k, series in enumerate(alone):
        assert y[k] == pytest.approx(m.readings([series], theta[k]), abs=1e-12)
        expected = m.jacobian([series], theta[k])
        assert slopes[k] == pytest.approx(expected, abs=1e-9)
        one = together.of_machines(k).take(np.array([3, 1]))
        assert (one.q == series.take(np.array([3, 1])).q).all()


def test_readings_that_are_not_wanted_are_not_computed(rng):
    m = a3_plans.measurement(taught=True, tools=[TOOL])
    (setup,) = m.setups
    command = CASES["a3_head"].commands(rng, 12) + np.array([TOOL, 0, 0])
    series, theta = m.series(setup, command), wrong(m, rng, 4)
    wanted = rng.uniform(size=(4, 12)) < 0.5
    y = m.try_readings([series], theta, wanted)
    expected = m.readings([series], theta)
    assert y[wanted] == pytest.approx(expected[wanted], abs=1e-12)
    assert np.isnan(y[~wanted]).all()


def test_only_whitened_rows_carry_the_noise():
    m = a3_plans.measurement()
    series = a3_plans.circles(m, 3)
    h, sigma = m.jacobian([series], m.nominal), m.sigma([series])
    assert identifiability.scaled(m, [series], m.nominal, "tolerance") == pytest.approx(
        h * m.tolerance / sigma[:, None]
    )
    assert identifiability.scaled(m, [series], m.nominal, "length") == pytest.approx(
        h / m.length_factors
    )
    assert (identifiability.scaled(m, [series], m.nominal, "si") == h).all()
