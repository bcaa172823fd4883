"""Which candidates can be taken: the oracles' geometry, sampling, virtual machines."""

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from oracles import planar_geometry as planar
from shipped_models import a3_head, calliper, height_probe, planar_2dof, relative

from kernel import a3_plans
from kernel.bar_series import CUP, LENGTH, bar, places, planar_series, tips
from kernel.cases import CASES
from oed.instrument import mount
from oed.measurement import Measurement
from oed.poses import ReadingLimits
from oed.poses.feasible import DirectionCone, Surroundings, sphere


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
