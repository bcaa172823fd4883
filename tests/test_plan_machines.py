"""Plans of measurements for machines: which comes first, how far from the best
possible, and what virtual machines make of them.
"""

import dataclasses
import time

import numpy as np
import pytest
from oracles import planar_geometry as oracle

from oed import predict, simulate
from oed.identify import identify
from oed.instrument import mount
from oed.machine import Machine
from oed.measurement import Measurement
from oed.planning import campaign, refit, search
from oed.planning import stage as staging
from oed.planning.goal import Goal, goal_of
from oed.planning.option import Option, option
from oed.planning.search import Planned
from pkm_models.instruments import ball_bar, pose_tracker, relative
from pkm_models.machines import a3_head, planar_2dof

#: cups (height, distance from the axis) in m, tools and bars in m
CUPS = ((1.126, 0.0), (1.126, 0.1), (1.306, 0.1), (1.286, 0.0))
TOOLS, BARS = (0.0, 0.05, 0.1), (0.1, 0.15, 0.2, 0.25, 0.3)
HEIGHTS = 1.066 + np.array([0.0, 0.1, 0.2])
#: commands over the workspace: z, psi, theta
OVER = np.array([
    [z, psi, theta]
    for z in HEIGHTS for theta in np.radians([5, 15, 25, 35]) for psi in np.arange(12) * np.pi / 6
])  # fmt: skip


def a3(home: float, joint: float, beta: float) -> Machine:
    """The A3 head with tolerances of home positions (m), joint centres (m) and guides
    (rad).
    """
    kinds = {"dq": home, "be": beta}
    return a3_head.machine.with_parameters(
        [
            dataclasses.replace(p, tolerance=kinds.get(p.name[:2], joint))
            for p in a3_head.machine.parameters
        ]
    )


def bars(
    machine: Machine,
    cup: float,
    tools: tuple[float, ...],
    lengths: tuple[float, ...],
    around: int = 12,
) -> list[Option]:
    """Ball bars of +-1 mm of travel about cups set by hand, with the poses at which
    they keep their length.
    """
    made = []
    for tool in tools:
        for length in lengths:
            for height, off in CUPS:
                name = (
                    f"bar {1e3 * length:.0f}, tool {1e3 * tool:.0f}, cup"
                    f" {1e3 * height:.0f} {1e3 * off:.0f}"
                )
                free = {f"cup_{n}": cup for n in "xyz"}
                at = {"at_x": off, "at_y": 0.0, "at_z": height + tool}
                setup = mount(
                    ball_bar.free_cup,
                    name,
                    tool=(0, 0, tool),
                    length=length,
                    tolerances=free,
                    **at,
                )
                measurement = Measurement(machine, [setup])
                turns = np.arange(around) * 2.0 * np.pi / around
                grid = np.array(
                    [
                        [z + tool, psi, 0.0]
                        for z in np.linspace(1.066, 1.266, 7)
                        for psi in turns
                    ]
                )
                held, possible = measurement.hold(name, grid, "theta")
                if possible.sum() > 20:
                    series = measurement.series(name, held[possible])
                    counts = (6, 12, 24, 48)
                    made.append(
                        option(
                            machine,
                            [setup],
                            [series],
                            name=name,
                            counts=counts,
                            travel=1e-3,
                        )
                    )
    return made


def tracker(machine: Machine, name: str, sigma: float, mounting: float) -> Option:
    """Positions of the tool, from any distance."""
    setup = mount(pose_tracker.position, name, sigma=(sigma,) * 3)
    poses = np.array(
        [
            [z, psi, theta]
            for z in HEIGHTS
            for psi in np.arange(6) * np.pi / 3
            for theta in (0.1, 0.4)
        ]
    )
    series = Measurement(machine, [setup]).series(name, poses)
    return option(
        machine,
        [setup],
        [series],
        name=name,
        counts=(4, 8, 16),
        mounting=mounting,
        reading=30.0,
    )


def accuracy(machine: Machine, command: np.ndarray) -> Goal:
    """All components, relative to what they are before."""
    measurement = Measurement(machine, [])
    return goal_of(
        measurement, predict.error_maps(measurement.kinematics, command, "home"), {}
    )


def a3_plan(
    home: float, joint: float, beta: float, cup: float, stages: int = 3
) -> Planned:
    machine = a3(home, joint, beta)
    options = [
        *bars(machine, cup, (0.0,), (0.3,)),
        tracker(machine, "rough", 0.2e-3, 1200.0),
    ]
    return search.plan(
        options,
        accuracy(machine, OVER),
        3600.0,
        np.random.default_rng(0),
        stages=stages,
        beam=4,
    )


@pytest.fixture(scope="module")
def unknown_home() -> Planned:
    """Home positions known to 8 mm."""
    return a3_plan(8e-3, 0.3e-3, 5e-3, 0.2e-3)


# -- which measurement at which stage --------------------------------------------------


def test_a_rough_measurement_comes_first_where_the_bars_could_not_follow(
    unknown_home: Planned,
) -> None:
    best = unknown_home.best
    assert best.names[0] == "rough"
    assert len(best.stages) >= 2
    assert unknown_home.bound.value <= best.value
    first = [
        p
        for p in unknown_home.front
        if p.stages and p.names[0] != "rough" and len(p.stages) == 1
    ]
    assert all(p.value > 10.0 * best.value for p in first)
    assert all(s.available.min() > 0.99 for s in best.stages[1:])


def test_it_is_left_out_where_the_machine_is_known_well_enough() -> None:
    best = a3_plan(0.1e-3, 0.05e-3, 0.3e-3, 0.1e-3, stages=2).best
    assert "rough" not in best.names
    assert all(s.available.min() > 0.98 for s in best.stages)


def planar(budget: float) -> Planned:
    """RM 1 to 5 of Chang et al. (2011) on the paper's lines, all lines of one together,
    all for the same time.
    """
    machine, options = planar_2dof.machine, []
    for k in range(1, 6):
        setup = mount(getattr(relative, f"rm{k}"), f"rm{k}")
        pose, line = oracle.lines(k)
        series = Measurement(machine, [setup]).series(
            setup.name, pose, run=[str(v) for v in line]
        )
        times = {"mounting": 600.0, "reading": 60.0 / len(series)}
        options.append(
            option(
                machine,
                [setup],
                [series],
                name=setup.name,
                counts=(3,),
                whole_runs=True,
                **times,
            )
        )
    over = np.array(
        [[y, z] for y in np.linspace(-1.5, 1.5, 11) for z in (0.0, 0.5, 1.0, 1.5)]
    )
    return search.plan(
        options, accuracy(machine, over), budget, np.random.default_rng(0)
    )


def test_rm4_then_rm5_as_in_the_paper() -> None:
    """Two stages: the paper's choice, and certified. RM 5 alone is 19 times as weak in
    the weakest direction.
    """
    found, alone = planar(1320.0), planar(660.0)
    assert found.best.names == ("rm4", "rm5")
    assert found.loss < 0.01
    assert alone.best.names == ("rm5",)
    assert alone.best.value > 10.0 * found.best.value
    rows = {k: oracle.identification_rows(k) for k in (4, 5)}
    weakest = [
        np.linalg.svd(r, compute_uv=False)[5]
        for r in (np.vstack([rows[4], rows[5]]), rows[5])
    ]
    assert weakest[0] / weakest[1] == pytest.approx(19.0, rel=0.02)
    # the readings behind the two plans are those rows
    for plan, expected in ((found.best, weakest[0]), (alone.best, weakest[1])):
        h = np.vstack(
            [
                s.option.measurement.jacobian(s.series, s.option.measurement.nominal)[
                    :, :7
                ]
                for s in plan.stages
            ]
        )
        assert np.linalg.svd(h, compute_uv=False)[5] == pytest.approx(
            expected, rel=1e-6
        )


@pytest.mark.slow
@pytest.mark.parametrize("home", [1e-3, 8e-3])
def test_thirty_measurements_four_stages_eight_hours(home: float) -> None:
    """Certified to 5 % within a minute of processor time."""
    machine = a3(home, 0.3e-3, 5e-3)
    some = bars(machine, 0.2e-3, TOOLS, BARS, around=18)[:28]
    options = [
        *some,
        tracker(machine, "rough", 50e-6, 600.0),
        tracker(machine, "fine", 10e-6, 2700.0),
    ]
    assert len(options) == 30
    goal = accuracy(machine, OVER)
    start = time.process_time()
    found = search.plan(options, goal, 8 * 3600.0, np.random.default_rng(0), stages=4)
    assert time.process_time() - start < 60.0
    assert found.loss <= 0.05
    assert found.bound.closed


# -- virtual machines through a plan ---------------------------------------------------


def held_to(
    seen: campaign.Campaign, low: float, high: float, least: float, most: float
) -> None:
    for stage in seen.stages:
        assert ((stage.ratio > low) & (stage.ratio < high)).all(), (
            stage.name,
            stage.ratio,
        )
        assert least < stage.held < most, (stage.name, stage.held)
        assert least < stage.held_poses < most, (stage.name, stage.held_poses)
        assert stage.lost == pytest.approx(stage.lost_predicted, abs=0.02)


def test_virtual_machines_are_as_accurate_as_predicted(unknown_home: Planned) -> None:
    seen = campaign.carry_out(
        unknown_home.best.stages, OVER[::2], 25, np.random.default_rng(5)
    )
    assert seen.names == ("x", "y", "z", "psi", "theta", "phi")
    held_to(seen, 0.6, 1.5, 0.88, 0.99)
    goal = accuracy(a3(8e-3, 0.3e-3, 5e-3), OVER[::2])
    told = goal.accuracy(unknown_home.best.stages[-1].covariance) * goal.unit
    assert seen.stages[-1].predicted == pytest.approx(told, rel=1e-9)


@pytest.mark.slow
def test_two_hundred_virtual_machines_are_as_accurate_as_predicted(
    unknown_home: Planned,
) -> None:
    held_to(
        campaign.carry_out(
            unknown_home.best.stages, OVER, 200, np.random.default_rng(5)
        ),
        0.8,
        1.25,
        0.93,
        0.97,
    )


def test_a_bar_alone_loses_what_is_predicted() -> None:
    """Home positions known to 2 mm: most readings of a bar mounted first are out of its
    travel.
    """
    machine = a3(2e-3, 0.3e-3, 5e-3)
    one, two = bars(machine, 0.2e-3, (0.0,), (0.3,))[:2]
    rng, before, stages = np.random.default_rng(2), np.eye(24 - len(machine.frame)), []
    for made in (one, two):
        stages.append(staging.told(made, np.arange(0, 48, 2), before, rng, draws=1000))
        before = stages[-1].known
    seen = campaign.carry_out(stages, OVER[::6], 40, np.random.default_rng(6))
    assert seen.stages[0].lost_predicted > 0.5
    assert seen.stages[0].lost == pytest.approx(seen.stages[0].lost_predicted, abs=0.08)
    assert seen.stages[1].lost == pytest.approx(seen.stages[1].lost_predicted, abs=0.15)
    for done in seen.stages:
        assert ((done.ratio > 0.65) & (done.ratio < 1.5)).all(), (done.name, done.ratio)


def test_compensation_brings_the_bar_s_readings_back() -> None:
    """Without it the second bar loses as much as if nothing had been identified."""
    machine = a3(2e-3, 0.3e-3, 5e-3)
    rough, bar = (
        tracker(machine, "rough", 50e-6, 600.0),
        bars(machine, 0.2e-3, (0.0,), (0.3,))[0],
    )
    rng = np.random.default_rng(2)
    first = staging.told(rough, np.arange(16), np.eye(24 - len(machine.frame)), rng)
    stages = [first, staging.told(bar, np.arange(0, 48, 2), first.known, rng)]
    lost = [
        campaign.carry_out(
            stages, OVER[::12], 12, np.random.default_rng(6), compensated=c
        )
        .stages[1]
        .lost
        for c in (True, False)
    ]
    assert lost[0] < 0.02
    assert lost[1] > 0.5


def test_machines_are_drawn_from_what_was_learned() -> None:
    """The second stage alone, from the covariance that the first one left, is as
    accurate as both in a row.
    """
    first, second = planar(1320.0).best.stages
    over = np.array([[y, z] for y in (-1.5, -0.5, 0.5, 1.5) for z in (0.0, 0.7, 1.5)])
    start = first.covariance
    rng = np.random.default_rng(0)
    told = staging.told(second.option, second.chosen, start, rng)
    seen = campaign.carry_out(
        [told], over, 60, np.random.default_rng(2), start=start
    ).stages[0]
    both = campaign.carry_out(
        [first, second], over, 60, np.random.default_rng(2)
    ).stages[1]
    assert seen.predicted == pytest.approx(both.predicted, rel=1e-3)
    assert ((seen.ratio > 0.75) & (seen.ratio < 1.3)).all(), seen.ratio
    assert 0.88 < seen.held < 0.99
    # drawn from the tolerances instead, the same stage alone is far worse
    apart = campaign.carry_out(
        [staging.told(second.option, second.chosen, np.eye(7), rng)], over, 5, rng
    ).stages[0]
    assert apart.predicted[0] > 5.0 * seen.predicted[0]


def test_refits_are_the_fits_of_identify() -> None:
    """Readings of drawn machines, fitted from nominal by either."""
    option_ = planar(660.0).best.stages[0].option
    m, rng = option_.measurement, np.random.default_rng(4)
    for _ in range(3):
        y = simulate.read(m, option_.series, simulate.draw(m, rng), rng)
        one, other = (
            refit.refit(m, option_.series, y, m.nominal),
            identify(m, option_.series, y),
        )
        assert (np.abs(one.theta - other.theta)[m.free] < 1e-3 * other.sd[m.free]).all()
        assert np.sqrt(np.diag(one.covariance)) == pytest.approx(other.sd, rel=1e-3)


def test_the_same_seed_gives_the_same_campaign() -> None:
    found = planar(660.0).best.stages
    over = np.array([[0.0, 0.5], [1.0, 1.0]])
    one, two = (
        campaign.carry_out(found, over, 5, np.random.default_rng(1)).stages[0]
        for _ in range(2)
    )
    assert (one.realised == two.realised).all()
    with pytest.raises(ValueError, match="at least one of each"):
        campaign.carry_out([], over, 5, np.random.default_rng(1))
