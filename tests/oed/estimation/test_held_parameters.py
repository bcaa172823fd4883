"""Held parameters and errors outside the model, against deltas and platforms of other code."""

import dataclasses
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import optimize, stats
from scipy.spatial.transform import Rotation
from shipped_models import (
    height_probe,
    hexapod_ups,
    linear_delta,
    planar_2dof,
    pose_tracker,
)

from kernel.delta_probe import ARM, SIGMA, bed, heights
from oed import Measurement, mount
from oed.estimation import Estimate, contradicted_parameters, identify
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


MM = 1e-3
LEG = np.arange(6)
#: rms over that of plain least squares at most: of the same readings, of the leg equation
AS_GOOD, NEARLY_AS_GOOD = 1.05, 1.15
#: of coordinates of the joints: the frame of the camera is theirs too
TOLERANCE = 50.0 * MM


@dataclasses.dataclass(frozen=True)
class Poses:
    """Poses x (n, 3) and R, with the leg lengths (n, 6) that the controller knows."""

    x: np.ndarray
    turned: Rotation
    legs: np.ndarray

    def take(self, rows: np.ndarray) -> "Poses":
        return Poses(self.x[rows], self.turned[rows], self.legs[rows])

    def readings(self) -> np.ndarray:
        """Position and tilts alpha, beta, gamma (n, 6) of R = Rx Ry Rz."""
        angles = self.turned.as_euler("XYZ")
        return np.column_stack([self.x, angles])


@dataclasses.dataclass(frozen=True)
class Nominal:
    """Nominal joints base (6, 3), platform (6, 3), height of home."""

    base: np.ndarray
    platform: np.ndarray
    height: float

    @property
    def home(self) -> np.ndarray:
        return np.linalg.norm(
            self.platform + np.array([0.0, 0.0, self.height]) - self.base, axis=1
        )


def ring(radius: float, degrees: np.ndarray) -> np.ndarray:
    angle = np.radians(degrees)
    return radius * np.column_stack([np.cos(angle), np.sin(angle), 0.0 * angle])


#: of the real platform, from its author's drawing
MACHINE = Nominal(
    ring(0.410, 200 + 100 * (LEG // 2) + 20 * ((LEG + 1) // 2)),
    ring(
        0.219075, 154.3012223 + 8.6024446 * (LEG // 2) + 111.3975554 * ((LEG + 1) // 2)
    ),
    0.565,
)


def leg_errors(values: np.ndarray, poses: Poses) -> np.ndarray:
    """The leg equation (n, 6) with changes (42,) of base, platform, leg offsets."""
    base = MACHINE.base + values[:18].reshape(6, 3)
    platform = MACHINE.platform + values[18:36].reshape(6, 3)
    points = np.stack([poses.turned.apply(a) for a in platform], axis=1)
    lengths = np.linalg.norm(poses.x[:, None] + points - base, axis=2)
    return lengths - poses.legs - values[36:42]


def plain_least_squares(poses: Poses) -> np.ndarray:
    """All legs alike; a millionth of a prior fixes what no reading tells."""

    def residuals(values: np.ndarray) -> np.ndarray:
        return np.concatenate([leg_errors(values, poses).ravel(), 1e-5 * values])

    return optimize.least_squares(residuals, np.zeros(42), xtol=1e-14).x


def fitted(poses: Poses, noise: float, *, estimate_noise: bool = True) -> Estimate:
    home = np.array([0.0, 0.0, 0.75])
    size = {"home": home, "reach": 0.2, "tilt": 0.5, "tolerance": TOLERANCE}
    machine = hexapod_ups.build(
        {"base": MACHINE.base, "platform": MACHINE.platform, **size}
    )
    sigma = [noise] * 3 + [noise / 0.219] * 3
    setup = mount(pose_tracker.instrument, "camera", sigma=sigma)
    fixed = tuple(dataclasses.replace(p, tolerance=0.0) for p in setup.nuisances)
    measurement = Measurement(machine, [dataclasses.replace(setup, nuisances=fixed)])
    series = measurement.series_from_joints("camera", poses.legs)
    return identify(
        measurement, [series], poses.readings().ravel(), estimate_noise=estimate_noise
    )


def changes(estimate: Estimate) -> np.ndarray:
    nominal = np.concatenate(
        [MACHINE.base.ravel(), MACHINE.platform.ravel(), np.zeros(6)]
    )
    return estimate.theta[:42] - nominal


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.fixture(scope="module")
def platform(shared_data: Path) -> Poses:
    """108 camera poses of a real six-legged platform."""
    file = shared_data / "jugglebot" / "poses_108.csv"
    if not file.is_file():
        pytest.skip("the folder jugglebot with real measurements is not there")
    table = pd.read_csv(file).to_numpy()
    per_turn = np.array([75.69, 71.20, 72.34, 70.80, 70.62, 71.26]) * MM
    legs = MACHINE.home + table[:, :6] * per_turn
    return Poses(table[:, 6:9] * MM, Rotation.from_quat(table[:, 9:13]), legs)


def test_a_real_platform_is_fitted_as_well_as_by_least_squares(platform):
    every = np.arange(len(platform.x))
    judged, used = every[2::3], np.delete(every, every[2::3])
    estimate = fitted(platform.take(used), 0.2 * MM)
    same_readings = fitted(platform.take(used), 0.2 * MM, estimate_noise=False)
    equation = plain_least_squares(platform.take(used))
    ours, same, plain = (
        rms(leg_errors(values, platform.take(judged)))
        for values in (changes(estimate), changes(same_readings), equation)
    )
    assert ours < AS_GOOD * same
    assert ours < NEARLY_AS_GOOD * plain
    assert any("the model may lack an effect" in text for text in estimate.warnings)
