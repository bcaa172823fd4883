"""Candidates that can be taken: the oracles' geometry, sampling, clearance, moves."""

import dataclasses
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_geometry as planar
from scipy.optimize import minimize
from shipped_models import (
    a3_head,
    ball_bar,
    calliper,
    height_probe,
    planar_2dof,
    relative,
)

from kernel import a3_plans
from kernel.cases import CASES
from oed.instrument import mount
from oed.measurement import Measurement, Series
from oed.poses import ReadingLimits
from oed.poses.feasible import (
    Capsule,
    Clearance,
    DirectionCone,
    Surroundings,
    cup_position,
    point_distance,
    segment_distance,
    sphere,
)

CUP = np.array([0.1, 0.2, -0.4])


LENGTH = 0.9


def bar(length: float = LENGTH) -> Measurement:
    """A bar from a cup set by hand to the platform of the planar machine."""
    at = dict(zip(("at_x", "at_y", "at_z"), CUP, strict=True))
    return Measurement(
        planar_2dof.machine, [mount(ball_bar.free_cup, "bar", length=length, **at)]
    )


def places(rng: np.random.Generator, n: int = 200) -> np.ndarray:
    return rng.uniform([-1.5, 0.0], [1.5, 1.5], (n, 2))


def tips(command: np.ndarray) -> np.ndarray:
    """Tool points (n, 3) of the planar machine."""
    return np.column_stack([np.zeros(len(command)), command])


def planar_series(
    rng: np.random.Generator, n: int = 200
) -> tuple[Measurement, np.ndarray, Series]:
    m, command = bar(), places(rng, n)
    return m, command, m.series("bar", command)


def test_joint_travel_is_reported_joint_by_joint(rng):
    m = a3_plans.measurement(taught=False)
    command = CASES["a3_head"].commands(rng, 300)
    q = a3.inverse_nominal(*command.T)
    feasibility = ReadingLimits(joints={"q2": (0.45, 0.70), "q3": (0.0, 0.75)}).check(
        m, m.series("cup", command)
    )
    out2, out3 = (q[:, 1] < 0.45) | (q[:, 1] > 0.70), q[:, 2] > 0.75
    assert 0 < out3.sum() < out2.sum()
    assert (feasibility.allowed == ~(out2 | out3)).all()
    assert feasibility.sentences == [
        f"{out2.sum()} of 300 candidates leave the travel of joint q2",
        f"{out3.sum()} of 300 candidates leave the travel of joint q3",
    ]
    assert (feasibility.refused["leave the travel of joint q3"] == out3).all()
    with pytest.raises(ValueError, match=r"no joint \['q9'\]"):
        ReadingLimits(joints={"q9": (0.0, 1.0)}).check(m, m.series("cup", command))


def test_the_machines_own_joint_range_holds_without_being_asked():
    """The A3 reaches struts of 0.2 to 1.2 m; a series from joints beyond that is refused."""
    m = Measurement(a3_head.machine, [mount(height_probe.instrument, "probe")])
    q = np.array([[0.3, 0.3, 0.3], [0.19, 0.19, 0.19], [1.2, 1.2, 1.2]])
    feasibility = ReadingLimits().check(m, m.series_from_joints("probe", q))
    assert feasibility.allowed.tolist() == [True, False, True]
    assert feasibility.refusal_counts == {
        f"leave the travel of joint q{i}": 1 for i in (1, 2, 3)
    }


def test_nearness_to_a_singular_pose_is_the_angle_between_the_struts(rng):
    """The condition number of the struts' directions is cot of half their angle."""
    m, command, series = planar_series(rng)
    along = command[:, None] - planar.sliders(planar.inverse(command), planar.NOMINAL)
    half = np.arccos((along[:, 0] * along[:, 1]).sum(-1) / planar.L**2) / 2
    expected = np.minimum(np.tan(half), 1 / np.tan(half))
    limit = float(np.sort(expected)[50:52].mean())
    feasibility = ReadingLimits(singularity=limit).check(m, series)
    assert feasibility.details["singularity"] == pytest.approx(expected, rel=1e-9)
    assert feasibility.sentences == [
        "51 of 200 candidates are too near a singular pose"
    ]
    assert (feasibility.allowed == (expected >= limit)).all()


def test_travel_of_the_bar_about_its_length(rng):
    m, command, series = planar_series(rng)
    off = np.abs(np.linalg.norm(tips(command) - CUP, axis=1) - LENGTH)
    feasibility = ReadingLimits(travel=0.2).check(m, series)
    assert feasibility.details["travel"] == pytest.approx(off, abs=1e-13)
    assert (feasibility.allowed == (off <= 0.2)).all()
    assert 0 < feasibility.allowed.sum() < 200
    probe = Measurement(planar_2dof.machine, [mount(height_probe.instrument, "probe")])
    with pytest.raises(ValueError, match="height_probe holds no reading by design"):
        ReadingLimits(travel=0.1).check(probe, probe.series("probe", command))


def test_the_chance_to_stay_within_the_travel_is_that_of_exact_machines(rng):
    """20000 machines of the oracle, with correlated errors, near the ends of the travel."""
    draws, travel = 20000, 1.5e-3
    m = bar()
    command = places(rng, 30)
    reach = np.linalg.norm(tips(command) - CUP, axis=1)
    within = LENGTH + rng.uniform(-1.5 * travel, 1.5 * travel, 30)
    command = (
        CUP[1:]
        + (command - CUP[1:])
        * np.sqrt((within**2 - CUP[0] ** 2) / (reach**2 - CUP[0] ** 2))[:, None]
    )[(reach > 0.3)]
    root = m.tolerance[:, None] * rng.standard_normal((10, 10)) / np.sqrt(10)
    theta = m.nominal + rng.standard_normal((draws, 10)) @ root.T
    pose = planar.forward(planar.inverse(command), theta[:, None, :7])
    point = np.concatenate([np.zeros((*pose.shape[:2], 1)), pose], axis=-1)
    length = np.linalg.norm(point - CUP - theta[:, None, 7:], axis=-1)
    counted = (np.abs(length - LENGTH) <= travel).mean(axis=0)
    probability = ReadingLimits(travel=travel).travel_probability(
        m, m.series("bar", command), root @ root.T
    )
    assert counted.min() < 0.4 < 0.8 < counted.max()
    assert np.abs(probability - counted).max() < 4 * np.sqrt(0.25 / draws) + 0.002
    assert np.abs(probability - counted).mean() < 0.004


def test_a_known_machine_stays_within_the_travel_or_not(rng):
    m, _, series = planar_series(rng)
    sure = ReadingLimits(travel=0.2).travel_probability(m, series, np.zeros((10, 10)))
    assert (sure == ReadingLimits(travel=0.2).check(m, series).allowed).all()
    wide = ReadingLimits(travel=1e9).travel_probability(
        m, series, np.diag(m.tolerance**2)
    )
    assert (wide == 1.0).all()
    with pytest.raises(ValueError, match="must be 10 x 10"):
        ReadingLimits(travel=0.2).travel_probability(m, series, np.eye(7))


def test_the_first_channel_has_the_travel(rng):
    """RM 5 reads dy and dz from the first pose of a line: only dy has the travel."""
    holding = dataclasses.replace(relative.rm5, fixed_reading=lambda settings: 0.0)
    m = Measurement(planar_2dof.machine, [mount(holding, "rm5")])
    assert len(m.setups["rm5"].sigma) == 2
    series = m.series("rm5", places(rng, 12), run=["line"] * 12)
    first = m.readings([series], m.nominal).reshape(-1, 2)[:, 0]
    feasibility = ReadingLimits(travel=0.5).check(m, series)
    assert feasibility.details["travel"] == pytest.approx(np.abs(first))
    chance = ReadingLimits(travel=0.5).travel_probability(
        m, series, np.zeros((len(m.names),) * 2)
    )
    assert (chance == feasibility.allowed).all()


def test_a_reading_falls_with_its_reference_pose():
    m = Measurement(planar_2dof.machine, [mount(calliper.instrument, "calliper")])
    command = np.array([[0.0, 1.4], [0.1, 0.2], [0.2, 0.2], [0.0, 0.1], [0.1, 0.3]])
    series = m.series("calliper", command, run=["high", "high", "high", "low", "low"])
    highest = float(planar.inverse(command)[1:].max())
    feasibility = ReadingLimits(
        joints={"q1": (0.0, highest), "q2": (0.0, highest)}
    ).check(m, series)
    assert feasibility.allowed.tolist() == [False, False, True]


def angle(direction: np.ndarray, axis: np.ndarray) -> np.ndarray:
    return np.arccos(
        direction @ axis / np.linalg.norm(direction, axis=-1) / np.linalg.norm(axis)
    )


def test_solid_angles_at_cup_and_tool_are_the_oracles(rng):
    """The oracle gives the tool point; the cup is at the teach pose's."""
    command = CASES["a3_head"].commands(rng, 300)
    m = a3_plans.measurement()
    real = a3.forward(np.zeros((1, 24)), a3.inverse_nominal(*command.T))
    cup = np.array([0.0, 0.0, a3.Z_TEACH])
    down, out = np.array([0.1, 0.0, -2.0]), np.array([0.0, 0.3, 1.0])
    at_cup = angle(real.tip - cup, down)
    at_tool = angle(np.einsum("nji,nj->ni", real.R, cup - real.tip), out)
    limits = ReadingLimits(
        base_cone=DirectionCone(tuple(down), 0.5),
        platform_cone=DirectionCone(tuple(out), 0.6),
    )
    feasibility = limits.check(m, m.series("cup", command))
    assert feasibility.details["base_cone"] == pytest.approx(at_cup, abs=1e-7)
    assert feasibility.details["platform_cone"] == pytest.approx(at_tool, abs=1e-7)
    assert (feasibility.allowed == ((at_cup <= 0.5) & (at_tool <= 0.6))).all()
    assert 0 < feasibility.allowed.sum() < 300
    assert set(feasibility.refusal_counts) == {
        "leave the cone at the cup",
        "leave the cone at the tool",
    }


def test_cones_hold_for_set_ups_with_a_cup(rng):
    m, command, series = planar_series(rng)
    limits = ReadingLimits(
        base_cone=DirectionCone((0.0, 0.0, 1.0), 0.7),
        travel=0.2,
        surroundings=Surroundings(obstacles=(sphere((0.0, 0.0, 0.0), 0.1),), bar=0.01),
    )
    expected = angle(tips(command) - CUP, np.array([0.0, 0.0, 1.0]))
    feasibility = limits.check(m, series)
    assert feasibility.details["base_cone"] == pytest.approx(expected, abs=1e-7)
    assert limits.for_setup(m.setups["bar"]) == limits
    probe = Measurement(planar_2dof.machine, [mount(height_probe.instrument, "probe")])
    of_probe = limits.for_setup(probe.setups["probe"])
    assert of_probe == ReadingLimits()
    assert of_probe.check(probe, probe.series("probe", command)).allowed.all()
    with pytest.raises(ValueError, match="does not state where its other end is"):
        dataclasses.replace(limits, travel=None).check(
            probe, probe.series("probe", command)
        )
    with pytest.raises(ValueError, match="axis that is not zero"):
        DirectionCone((0.0, 0.0, 0.0), 1.0)


@pytest.mark.parametrize("others", [(), ("length",)])
def test_a_bar_is_held_where_its_settings_say(others):
    """At the three settings of its place, else at the tool point of its teach pose."""
    place = dict(zip(("at_x", "at_y", "at_z"), CUP, strict=True))
    mounted = bar().setups["bar"]
    settings = {**place, **dict.fromkeys(others, 0.3)}
    teach = (0.2, 0.4)

    def held_at(settings: dict[str, float]) -> np.ndarray:
        known = SimpleNamespace(
            settings=settings, teach=teach, tool=(0.0, 0.0, 0.0), instrument=mounted
        )
        kinematics = bar().kinematics
        some = SimpleNamespace(setups={"bar": known}, kinematics=kinematics)
        return cup_position(cast(Measurement, some), "bar")

    assert held_at(settings) == pytest.approx(np.array(CUP))
    del settings["at_y"]
    assert held_at(settings) == pytest.approx(tips(np.array([teach]))[0])


def test_distances_of_segments_are_the_least_found_by_search(rng):
    """Random, touching, parallel, collinear and shrunken segments, by minimisation."""
    a0, a1, b0, b1 = rng.standard_normal((4, 60, 3))
    a1[0], b1[1] = a0[0], b0[1]  # one is a point
    a1[2], b1[2] = a0[2], b0[2]  # both are
    b1[3] = b0[3] + 2.5 * (a1[3] - a0[3])  # parallel
    b0[4], b1[4] = a1[4] + (a1[4] - a0[4]), a1[4] + 3 * (a1[4] - a0[4])  # in one line
    b0[5] = 0.3 * a0[5] + 0.7 * a1[5]  # touching
    distance = segment_distance(a0, a1, b0, b1)

    def searched(i: int) -> float:
        def square(st: np.ndarray) -> float:
            return float(
                (
                    (a0[i] + st[0] * (a1[i] - a0[i]) - b0[i] - st[1] * (b1[i] - b0[i]))
                    ** 2
                ).sum()
            )

        starts = [(0.1, 0.1), (0.9, 0.1), (0.1, 0.9), (0.9, 0.9)]
        box = {"bounds": [(0, 1), (0, 1)], "tol": 1e-14}
        return float(np.sqrt(min(minimize(square, s, **box).fun for s in starts)))

    assert distance == pytest.approx([searched(i) for i in range(60)], abs=2e-6)
    assert distance == pytest.approx(segment_distance(b1, b0, a1, a0), abs=1e-14)
    assert distance[2] == pytest.approx(np.linalg.norm(a0[2] - b0[2]))
    assert distance[5] == pytest.approx(0.0, abs=1e-14)


def test_distances_of_a_crossing_and_of_a_point():
    x, y, z = np.eye(3)
    assert segment_distance(-x, x, -y + 2 * z, y + 2 * z) == pytest.approx(2.0)
    assert segment_distance(-x, x, 2 * x - y, 2 * x + y) == pytest.approx(1.0)
    assert segment_distance(-x, x, 4 * x + 4 * y, 4 * x + 9 * y) == pytest.approx(5.0)
    assert point_distance(4 * x + 4 * y, -x, x) == pytest.approx(5.0)
    assert point_distance(0.5 * x + 3 * z, -x, x) == pytest.approx(3.0)


def struts(command: np.ndarray) -> np.ndarray:
    """Slider and platform of both struts (n, 2, 2, 3), by the oracle."""
    slider = planar.sliders(planar.inverse(command), planar.NOMINAL)
    ends = np.stack([slider, np.broadcast_to(command[:, None], slider.shape)], axis=2)
    return np.concatenate([np.zeros((*ends.shape[:3], 1)), ends], axis=-1)


def sampled(ends: np.ndarray, centre: np.ndarray, n: int = 2001) -> np.ndarray:
    """Least distance (...) of points along segments (..., 2, 3) to a centre."""
    t = np.linspace(0, 1, n)[:, None]
    points = (
        ends[..., None, 0, :] + t * (ends[..., 1, :] - ends[..., 0, :])[..., None, :]
    )
    return np.asarray(np.linalg.norm(points - centre, axis=-1).min(axis=-1))


def test_clearance_of_struts_and_bar_is_that_of_sampled_points(rng):
    """Lines 0 and 2 of the skeleton are the guides, which are left out."""
    m, command, series = planar_series(rng)
    centre = np.array([0.05, 0.3, 1.0])
    at_guide = sphere((0.0, -2.2, 0.2), 0.45)
    around = (sphere(tuple(centre), 0.2), at_guide)
    about = Surroundings(
        obstacles=around, links=0.03, bar=0.01, margin=0.05, ignore=(0, 2)
    )
    feasibility = ReadingLimits(surroundings=about).check(m, series)
    link = sampled(struts(command), centre).min(axis=1) - 0.2 - 0.03
    rods = np.stack([np.broadcast_to(CUP, (200, 3)), tips(command)], axis=1)
    rod = sampled(rods, centre) - 0.2 - 0.01
    assert feasibility.details["clearance"] == pytest.approx(
        np.minimum(link, rod), abs=1e-4
    )
    assert (rod < link).any()
    assert (link < rod).any()
    assert (feasibility.allowed == (np.minimum(link, rod) >= 0.05)).all()
    assert 0 < feasibility.refusal_counts["come too near an obstacle"] < 200
    stated = Surroundings(obstacles=around, links=0.03, bar=0.01, ignore=(0, 2))
    feasibility = ReadingLimits(surroundings=stated).check(m, series)
    assert (feasibility.allowed == (np.minimum(link, rod) >= 0.0)).all()
    with_guides = Clearance(m, "bar", dataclasses.replace(about, ignore=()))
    assert (
        with_guides.at_readings(series, series.start)
        <= 2.2 - 1.792 - 0.45 - 0.03 + 1e-12
    ).all()


def test_clearance_of_a_whole_skeleton_with_a_longer_tool(rng):
    m = a3_plans.measurement(tools=[0.25])
    series = m.series(
        "cup250", CASES["a3_head"].commands(rng, 20) + np.array([0.25, 0, 0])
    )
    wall = Capsule((0.4, -0.5, 1.3), (0.4, 0.5, 1.5), 0.02)
    clearance = Clearance(
        m, "cup250", Surroundings(obstacles=(wall,), links=0.03)
    ).pose_clearance(series.start, series.q)
    points = np.linspace(wall.start, wall.end, 401)
    for k in (0, 5, 19):
        tip = m.kinematics.frames(series.start[k : k + 1], np.array([0, 0, 0.25]))[1][0]
        nominal, x, q = m.machine.nominal, series.start[k], series.q[k]
        lines = [np.array(v) for v in m.kinematics.skeleton(x, q, nominal)]
        lines.append(np.stack([lines[-1][-1], tip]))
        ends = np.concatenate([np.stack([v[:-1], v[1:]], axis=1) for v in lines])
        expected = min(sampled(ends, point, 801).min() for point in points) - 0.05
        assert clearance[k] == pytest.approx(expected, abs=1e-4)


def test_incomplete_surroundings_are_refused():
    with pytest.raises(ValueError, match="at least one obstacle"):
        Surroundings(obstacles=(), bar=0.01)
    with pytest.raises(ValueError, match="nothing that moves is checked"):
        Surroundings(obstacles=(sphere((0.0, 0.0, 0.0), 0.1),))
    bare = Measurement(
        dataclasses.replace(planar_2dof.machine, skeleton=None),
        list(bar().setups.values()),
    )
    ball = (sphere((0.0, 0.0, 0.0), 0.1),)
    with pytest.raises(ValueError, match="has no skeleton"):
        Clearance(bare, "bar", Surroundings(obstacles=ball, links=0.01))
    with pytest.raises(ValueError, match="lines 0 to 3"):
        Clearance(bar(), "bar", Surroundings(obstacles=ball, links=0.01, ignore=(4,)))
