"""Clearance of struts, bar and surroundings, and moves between poses."""

import dataclasses
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from oracles import planar_geometry as planar
from scipy.optimize import minimize
from shipped_models import planar_2dof

from kernel import a3_plans
from kernel.bar_series import CUP, bar, planar_series, tips
from kernel.cases import CASES
from oed.measurement import Measurement
from oed.poses import ReadingLimits
from oed.poses.feasible import (
    Capsule,
    Clearance,
    Surroundings,
    cup_position,
    point_distance,
    segment_distance,
    sphere,
)


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
