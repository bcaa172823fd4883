"""Held parameters that readings contradict, against deltas that other code computes."""

import dataclasses

import numpy as np
import pytest
from scipy import stats
from shipped_models import height_probe, linear_delta, planar_2dof, pose_tracker

from kernel.printer_bed import ARM, SIGMA, bed, heights
from oed import Measurement, mount
from oed.estimation import contradicted_parameters, identify
from oed.measurement import draw_parameters, draw_readings

TOLERANCES = {"radius": 2e-3, "arm": 3e-3, "angle": 0.01, "endstop": 2e-3}


def delta(*, fixed: tuple[str, ...]) -> Measurement:
    """A delta printer with a height probe, some parameters held as its firmware does."""
    parameters = [
        dataclasses.replace(p, tolerance=TOLERANCES[p.name.rstrip("123")])
        for p in linear_delta.machine.parameters
    ]
    machine = linear_delta.machine.with_parameters(parameters)
    machine = dataclasses.replace(machine, frame=fixed)
    probe = mount(
        height_probe.instrument, "probe", sigma=[SIGMA], tolerances={"offset": 0.0}
    )
    return Measurement(machine, [probe])


def named(m, series, y, **options):
    estimate = identify(m, [series], y, **options)
    return contradicted_parameters(m, [series], y, estimate)


def test_a_lean_of_the_bed_is_named_with_what_it_changes():
    """The bed leans by 4 mrad: the endstops have taken it up, the print is off."""
    m = delta(fixed=("angle3", "arm1", "arm2", "arm3"))
    command, lean = bed(25), -4e-3
    rng = np.random.default_rng(3)
    y = heights(command, tilt_x=lean) + SIGMA * rng.standard_normal(25)
    series = m.series("probe", command)
    for options in ({}, {"estimate_noise": True}):
        found = named(m, series, y, **options)
        assert [one.parameters for one in found] == [["probe.tilt_x"]]
        (one,) = found
        assert one.unit == "mrad"
        assert one.estimate == pytest.approx(1e3 * lean, abs=3.0 * one.sd)
        assert 0.2 < one.sd < 1.0
        assert one.p_value < 1e-4
        assert set(one.changes) == {"endstop1", "endstop2", "endstop3"}
        # the endstops lean against the towers' circle: 4 mrad of 162 mm at the last
        assert one.changes["endstop3"] == pytest.approx(-0.65, rel=0.3)
        assert one.tool_mm > 0.1


def test_a_common_arm_length_held_as_the_firmware_holds_it_is_named():
    m = delta(fixed=("angle3", "arm1", "arm2", "arm3"))
    command, arm = bed(41), ARM - 4.1e-3
    rng = np.random.default_rng(5)
    y = heights(command, arm=arm) + SIGMA * rng.standard_normal(41)
    (one,) = named(m, m.series("probe", command), y, estimate_noise=True)
    assert one.parameters == ["arm1", "arm2", "arm3"]
    assert one.estimate == pytest.approx(1e3 * arm, abs=3.0 * one.sd)
    assert one.sd < 1.5
    assert one.p_value < 0.01


def test_what_only_chooses_a_frame_is_not_tested():
    """Towers turned together read the same: angle3 has no part of its own."""
    m = delta(fixed=("angle3",))
    command = bed(30)
    series = m.series("probe", command)
    y = heights(command) + SIGMA * np.random.default_rng(1).standard_normal(30)
    turned = m.nominal
    turned[[m.names.index(f"angle{i}") for i in (1, 2, 3)]] += 0.02
    assert m.readings([series], turned) == pytest.approx(
        m.readings([series], m.nominal), abs=1e-3
    )
    assert named(m, series, y) == []


def test_the_statistic_is_that_of_an_added_variable():
    """One held offset of a flat tracker: Student's t of ordinary least squares."""
    m = delta(fixed=("angle3", "arm1", "arm2", "arm3", "angle1", "angle2"))
    command = bed(20)
    series = m.series("probe", command)
    y = heights(command, tilt_x=-4e-3)
    y += SIGMA * np.random.default_rng(2).standard_normal(20)
    estimate = identify(m, [series], y)
    (one, *_) = contradicted_parameters(m, [series], y, estimate)
    # by hand, about the estimate: four free columns, one for the tilt
    j = m.jacobian([series], estimate.theta)[:, m.free]
    point = m.kinematics.frames(m.poses(series, estimate.theta), np.zeros(3))[1]
    design = np.column_stack([j, -point[:, 1]])
    solution = np.linalg.lstsq(design, estimate.residuals, rcond=None)[0]
    left = estimate.residuals - design @ solution
    variance = left @ left / (20 - 5) * np.linalg.inv(design.T @ design)[-1, -1]
    p = 2.0 * stats.t.sf(abs(solution[-1]) / np.sqrt(variance), 15)
    # angle3 turns nothing: tests of 5 angles and arms, of all arms, of all angles, 2 tilts
    assert one.parameters == ["probe.tilt_x"]
    assert one.p_value / p == pytest.approx(round(one.p_value / p), rel=1e-3)
    assert 4 <= round(one.p_value / p) <= 10


def test_sound_studies_have_nothing_named():
    """40 at the level of 1 %: four or more are less likely than one in a thousand."""
    tracker = mount(pose_tracker.position, "tracker", sigma=[10e-6] * 3)
    planar = Measurement(planar_2dof.machine, [tracker])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 4), np.linspace(0.2, 1.3, 3))
    flat = planar.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    printer = delta(fixed=("angle3", "arm1", "arm2", "arm3"))
    cases = [(planar, flat), (printer, printer.series("probe", bed(19)))]
    alarms = 0
    for k in range(40):
        m, series = cases[k % 2]
        rng = np.random.default_rng([7, k])
        readings = draw_readings(m, [series], draw_parameters(m, rng), rng)
        alarms += bool(named(m, series, readings))
    assert alarms < 4
