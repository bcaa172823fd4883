"""Sensors on passive joints, constraints and spare joints, against closures of their own."""

import itertools

import numpy as np
import pytest
from constraint_machines import (
    CMM,
    CMM_SCALE,
    GRID,
    LEGS,
    OWN_SLOPES,
    SEAT,
    SETUP_SCALE,
    angles,
    external_slopes,
    hexapod_lengths,
    lengths,
    locked_poses,
    probes,
    rank_of,
    seat_slopes,
    sensor_slopes,
    turned,
)
from oracles import planar_cables
from scipy import optimize
from scipy.optimize import brentq
from shipped_models import cables_planar, cables_spatial, hexapod

from oed.dataset import ReadingsError, from_series, load, to_csv
from oed.estimation import Estimate, identify
from oed.identifiability import Assessment, recoveries
from oed.instrument import Setup, mount
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_models.instruments import camera, passive_joint, redundancy, seat, touch_plane
from pkm_reports.page.sheet import _table
from pkm_studies.commands import main
from pkm_studies.stages.design.section import planned_readings

#: the joints of the legs, in the machine's order
JOINTS = [f"{kind}{i}" for i in (1, 2, 3) for kind in ("swing", "side")]


def sensors() -> Setup:
    return mount(passive_joint.instrument.for_machine(CMM), "sensors")


def lock(leg: int) -> Setup:
    instrument = passive_joint.locked.for_machine(CMM)
    return mount(instrument.take_channels([f"off_swing{leg + 1}"]), f"lock{leg + 1}")


def plate(height: float) -> Setup:
    return mount(touch_plane.instrument, f"plate{height}", at=height)


def of_class(name: str) -> tuple[Measurement, list[Series]]:
    """The readings of one class of calibration."""
    if name == "locks":
        poses = {f"lock{leg + 1}": locked_poses(leg) for leg in LEGS}
        setups = [lock(leg) for leg in LEGS]
    elif name == "plates":
        heights = (-0.24, -0.2, -0.16)
        setups = [plate(h) for h in heights]
        poses = {f"plate{h}": GRID[GRID[:, 2] == h] for h in heights}
    else:
        setup = sensors() if name == "sensors" else mount(camera.known_frame, name)
        setups, poses = [setup], {name: GRID}
    measurement = Measurement(CMM, setups)
    return measurement, [measurement.series(n, p) for n, p in poses.items()]


@pytest.mark.parametrize(("name", "rank", "count"), [
    ("external", 9, 15), ("sensors", 21, 27), ("plates", 15, 24), ("locks", 12, 18),
])  # fmt: skip
def test_slopes_and_ranks_of_each_class_of_calibration(name, rank, count):
    measurement, series = of_class(name)
    rows = measurement.jacobian(series, measurement.nominal)
    own = OWN_SLOPES[name]()
    factor = 0.2 if name in ("sensors", "locks") else 1.0
    assert factor * rows == pytest.approx(own, abs=2e-8)
    scale = np.r_[CMM_SCALE, SETUP_SCALE[name]]
    assert own.shape[1] == count
    assert rank_of(own, scale) == rank
    verdict = Assessment.of(measurement, series)
    assert (verdict.identifiability.rank, len(verdict.names)) == (rank, count)


def test_together_external_readings_and_sensors_lose_what_only_moves_both_ends():
    """Radii of frame and platform of a leg in common: 3 of 27."""
    own = np.vstack(
        [np.hstack([external_slopes(), np.zeros((81, 12))]), sensor_slopes()]
    )
    assert rank_of(own, np.r_[CMM_SCALE, [5.0] * 12]) == 24
    setups = [mount(camera.known_frame, "external"), sensors()]
    measurement = Measurement(CMM, setups)
    series = [measurement.series(s.name, GRID) for s in setups]
    assert Assessment.of(measurement, series).identifiability.rank == 24


def test_a_locked_joint_leads_one_coordinate():
    """Leg 1 swings as at home where x = 0.14 + 0.7 z."""
    measurement = Measurement(CMM, [lock(0)])
    command = locked_poses(0)
    start = command.copy()
    start[:, 0] = 0.0
    solved, possible = commands_at_fixed_reading(measurement, "lock1", start, "x")
    assert possible.all()
    assert solved == pytest.approx(command, abs=1e-9)


def seat_setup() -> Setup:
    return mount(seat.instrument.for_machine(hexapod.machine), "seat")


def test_slopes_and_rank_of_a_ball_in_a_seat(rng):
    """Lost are three turns of the platform about the ball and six motions of the base
    with the seat: 36 of 45, as a ball bar has them.
    """
    turns = turned(rng, 40)
    own = seat_slopes(turns)
    measurement = Measurement(hexapod.machine, [seat_setup()])
    q = hexapod_lengths(np.tile(SEAT, (40, 1)), turns)
    series = measurement.series_from_joints("seat", q)
    rows = measurement.jacobian([series], measurement.nominal)
    assert rows == pytest.approx(own, abs=1e-6)
    values = np.linalg.svd(own, compute_uv=False)
    verdict = Assessment.of(measurement, [series])
    rank = verdict.identifiability.rank
    assert len(verdict.names) == 45
    assert rank == int((values > 1e-6 * values[0]).sum()) == 36


def test_what_a_machine_cannot_do_is_refused():
    with pytest.raises(ValueError, match="could not move"):
        Measurement(CMM, [mount(seat.instrument, "s", at_x=0.0, at_y=0.0, at_z=-0.2)])
    lock_of_two = passive_joint.locked.for_machine(CMM)
    with pytest.raises(ValueError, match="reads one of"):
        lock_of_two.take_channels(["off_swing1", "off_side1"])


def test_sensors_are_suggested_where_they_help_alone():
    external, series = of_class("external")
    advice = recoveries(Assessment.of(external, series), {})
    phrase = f"sensors on the passive joints, {', '.join(JOINTS)}, recovers"
    assert f"{phrase} 3 of 6 lost directions" in advice
    both = Measurement(CMM, [mount(camera.known_frame, "external"), sensors()])
    together = [both.series(name, GRID) for name in both.setups]
    advice = recoveries(Assessment.of(both, together), {})
    assert not any(phrase in text for text in advice)


NORMAL95 = 1.959964


def named_lock(name: str) -> Setup:
    instrument = passive_joint.locked.for_machine(CMM)
    return mount(instrument.take_channels(["off_swing1"]), name)


# -- simulated machines that are calibrated -------------------------------------------------
def drawn(measurement: Measurement, rng: np.random.Generator) -> np.ndarray:
    """Parameters (n,) of a machine and its set-ups, from the tolerances."""
    return measurement.nominal + measurement.tolerance * rng.standard_normal(
        len(measurement.names)
    )


def calibrate_sensors(rng: np.random.Generator) -> np.ndarray:
    measurement = MEASUREMENTS["sensors"]
    truth = drawn(measurement, rng)
    q = lengths(GRID, CMM.nominal)
    theta_k = angles(probes(q, truth[:15]), truth[:15])
    home = angles(np.array([[0.0, 0.0, -0.2]]), CMM.nominal)[0]
    y = theta_k + truth[15::2] + truth[16::2] * (theta_k - home)
    y += 5e-6 * rng.standard_normal(y.shape)
    return pulls(measurement, q, y, truth)


def calibrate_plate(rng: np.random.Generator) -> np.ndarray:
    """The joints are those of the machine as it is, with its probe on the plate."""
    measurement = MEASUREMENTS["plate"]
    truth = drawn(measurement, rng)
    offset, tilt_x, tilt_y = truth[15:]
    x, y, _ = GRID.T
    z = -0.2 + offset + tilt_x * y - tilt_y * x + 1e-6 * rng.standard_normal(len(x))
    q = lengths(np.column_stack([x, y, z]), truth[:15])
    return pulls(measurement, q, np.zeros(len(q)), truth)


def calibrate_lock(rng: np.random.Generator) -> np.ndarray:
    """The x of each pose is where the true leg 1 swings as locked, within its play."""
    measurement = MEASUREMENTS["lock"]
    truth = drawn(measurement, rng)
    at = measurement.setups["lock"].settings["at_swing1"] + truth[15]
    points = []
    for y, z in itertools.product([-0.03, 0.0, 0.03], [-0.23, -0.2, -0.17]):
        wanted = at + 20e-6 * rng.standard_normal()

        def off(x: float, y: float = y, z: float = z, to: float = wanted) -> float:
            return float(angles(np.array([[x, y, z]]), truth[:15])[0, 0] - to)

        points.append([brentq(off, -0.1, 0.1, xtol=1e-13), y, z])
    q = lengths(np.array(points), truth[:15])
    return pulls(measurement, q, np.zeros(len(q)), truth)


def pulls(
    measurement: Measurement, q: np.ndarray, y: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """Errors (n,) of an estimate over its standard deviations."""
    name = next(iter(measurement.setups))
    series = measurement.series_from_joints(name, q)
    estimate = identify(measurement, [series], y.ravel())
    return np.asarray((estimate.theta - truth) / estimate.sd)


_CMM_KINEMATICS = Kinematics(CMM)
MEASUREMENTS = {
    "sensors": Measurement(CMM, [sensors()], _CMM_KINEMATICS),
    "plate": Measurement(CMM, [mount(touch_plane.instrument, "plate", at=-0.2)], _CMM_KINEMATICS),
    "lock": Measurement(CMM, [named_lock("lock")], _CMM_KINEMATICS),
}  # fmt: skip
CALIBRATIONS = {
    "sensors": calibrate_sensors, "plate": calibrate_plate, "lock": calibrate_lock,
}  # fmt: skip


@pytest.mark.parametrize("name", CALIBRATIONS)
def test_intervals_hold_over_40_machines(name):
    rng = np.random.default_rng(11)
    errors = np.array([CALIBRATIONS[name](rng) for _ in range(40)])
    share = float((np.abs(errors) <= NORMAL95).mean())
    print(name, "share", round(share, 3), "rms pull", np.sqrt((errors**2).mean()))
    assert 0.92 <= share <= 0.98
    assert np.abs(errors).max() < 5.0


# -- files ---------------------------------------------------------------------------------
def planned() -> tuple[Measurement, str]:
    """A sheet to fill in of a locked joint and of sensors."""
    measurement = Measurement(CMM, [named_lock("lock1"), sensors()])
    series = [
        measurement.series("lock1", locked_poses(0)),
        measurement.series("sensors", GRID[:2]),
    ]
    y = np.full(len(series[0]) + 6 * len(series[1]), np.nan)
    return measurement, to_csv(from_series(series, y, measurement))


def test_the_sheet_of_a_constraint_asks_for_the_joints(tmp_path):
    measurement, text = planned()
    header, *rows = [line.split(",") for line in text.splitlines()]
    assert "off_swing1_deg" not in header
    joints = [header.index(f"q{k}_mm") for k in (1, 2, 3)]
    assert all(row[k] == "" for row in rows for k in joints)
    sheet = tmp_path / "sheet.csv"
    sheet.write_text(text)
    with pytest.raises(ReadingsError, match="no reading was taken"):
        load(sheet, measurement)
    # two of the poses were measured
    q = 1e3 * lengths(locked_poses(0)[:2], CMM.nominal)
    for row, values in zip(rows[:2], q, strict=True):
        for k, value in zip(joints, values, strict=True):
            row[k] = f"{value:.9f}"
    lines = [",".join(row) for row in [header, *rows]]
    sheet.write_text("\n".join(lines) + "\n")
    data = load(sheet, measurement)
    assert data.setups == ("lock1",)
    assert data.y.tolist() == [0.0, 0.0]
    assert 1e3 * data.series[0].q == pytest.approx(q, abs=1e-8)
    assert data.dropped == 9  # seven poses with the lock, two of the sensors


def test_simulated_constraints_come_back_as_they_were(tmp_path):
    measurement = Measurement(CMM, [named_lock("lock1")])
    series = measurement.series("lock1", locked_poses(0))
    y = 1e-4 * np.arange(1.0, 10.0)
    sheet = tmp_path / "simulated.csv"
    sheet.write_text(to_csv(from_series([series], y, measurement)), "utf-8")
    again = load(sheet, measurement)
    assert again.y == pytest.approx(y, abs=1e-12)


# -- commands ------------------------------------------------------------------------------
def test_a_lock_without_its_joint_is_refused(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main(["new", "lock", "--machine", "a3_head", "--instrument", "locked_joint"])
    study = tmp_path / "lock.study.toml"
    lines = study.read_text().splitlines()
    study.write_text("\n".join(x for x in lines if not x.startswith("channels")) + "\n")
    assert main(["check", str(study)]) == 2
    assert 'write channels = ["off_swing1"]' in capsys.readouterr().err
    new = ["new", "s", "--machine", "micro_cmm", "--instrument", "seat"]
    assert main(new) == 2
    assert "it could not move" in capsys.readouterr().err


def test_the_plan_of_a_constraint_records_its_joints():
    """On the printed sheet the joints are cells to write in; sensors keep their own."""
    measurement, _ = planned()
    series = [
        measurement.series("lock1", locked_poses(0)),
        measurement.series("sensors", GRID[:1]),
    ]
    *locked, read = planned_readings(measurement, series)
    q = 1e3 * lengths(locked_poses(0), CMM.nominal)
    for row, values in zip(locked, q, strict=True):
        assert list(row.reading) == ["q1_mm", "q2_mm", "q3_mm"]
        assert list(row.reading.values()) == pytest.approx(values, abs=1e-4)
    assert "swing1_deg" in read.reading
    table = _table("lock1", {}, locked, len(locked), ())
    assert table["writing"] == 3
    assert len(table["titles"]) == 1 + 3 + 3  # number, command, joints


DRUM = 0.3e-3  #: m, of one drum


def _machine() -> Machine:
    geometry = {"anchor": planar_cables.ANCHORS, "tolerance": planar_cables.PLACE}
    return cables_planar.build(geometry)


def _calibrated(
    measurement: Measurement, noise: np.ndarray, rng: np.random.Generator
) -> tuple[Estimate, np.ndarray]:
    """A drawn robot's estimate from its cable lengths alone, and its true parameters."""
    robot = planar_cables.drawn(rng)
    q = planar_cables.recorded(robot, rng.uniform(-0.5, 0.5, (40, 2)), noise, rng)
    series = measurement.series_from_joints("cables", q)
    y = np.zeros(2 * len(q))
    truth = robot.by_name()
    return identify(measurement, [series], y), np.array(
        [truth[n] for n in measurement.names]
    )


def _measurement() -> Measurement:
    machine = _machine()
    instrument = redundancy.instrument.for_machine(machine)
    sigma = [DRUM / 2.0] * 2  # four equations
    return Measurement(machine, [mount(instrument, "cables", sigma=sigma)])


def test_cable_lengths_alone_calibrate_a_robot_with_two_spare_joints(rng):
    estimate, truth = _calibrated(_measurement(), np.full(4, DRUM), rng)
    before = np.abs(estimate.residuals_before).max()
    assert np.abs(estimate.residuals).max() < 5.0 * DRUM < before
    assert estimate.sd.min() < 0.5 * planar_cables.PLACE
    pulls = (estimate.theta - truth) / estimate.sd
    assert np.abs(pulls).max() < 4.5


@pytest.mark.parametrize("module", [cables_planar, cables_spatial])
def test_the_misfits_are_the_residuals_that_no_pose_removes(module, rng):
    """Their norm is that of the constraints' residual by SciPy's least squares."""
    machine = module.machine  # type: ignore[attr-defined]
    instrument = redundancy.instrument.for_machine(machine)
    assert [c.name for c in instrument.channels] == ["gap1", "gap2"]
    m = Measurement(machine, [mount(instrument, "cables")])
    low = [
        0.5 * (c.lower + c.upper) - 0.3 * (c.upper - c.lower) for c in machine.command
    ]
    high = [
        0.5 * (c.lower + c.upper) + 0.3 * (c.upper - c.lower) for c in machine.command
    ]
    command = rng.uniform(low, high, (5, len(low)))
    x, q = m.kinematics.inverse(command)
    q += 1e-3 * rng.standard_normal(q.shape)
    series = m.series_from_joints("cables", q)
    gaps = m.readings([series], m.nominal).reshape(5, 2)
    names = [c.name for c in machine.pose]
    p = {k.name: k.nominal for k in machine.parameters}
    for start, joints, gap in zip(x, q, gaps, strict=True):
        by_name = {f"q{i + 1}": v for i, v in enumerate(joints)}

        def residual(
            at: np.ndarray, by_name: dict[str, float] = by_name
        ) -> list[float]:
            pose = dict(zip(names, at, strict=True))
            return [float(v) for v in machine.closure(pose, by_name, p)]

        least = optimize.least_squares(residual, start, xtol=1e-15, ftol=1e-15)
        expected = np.linalg.norm(least.fun) / np.sqrt(len(joints))
        assert np.linalg.norm(gap) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("module", [cables_planar, cables_spatial])
def test_a_joint_that_errs_changes_the_misfits_as_its_slope_says(module, rng):
    """By central differences of the exact readings; effects of joints rest on it."""
    machine = module.machine  # type: ignore[attr-defined]
    instrument = redundancy.instrument.for_machine(machine)
    m = Measurement(machine, [mount(instrument, "cables")])
    q = m.kinematics.inverse(machine.home_command[None])[1]
    series = m.series_from_joints("cables", q + 1e-3 * rng.standard_normal(q.shape))
    (slopes,) = m.of(series).response(series, m.nominal).joints
    step, still = 1e-6, np.zeros((1, len(m.nominal)))
    for k in range(q.shape[1]):
        change = np.zeros_like(q)
        change[0, k] = step
        ahead, behind = (
            m.of(series).perturbed(
                series, m.nominal, sign * change, still, still[:, :0]
            )
            for sign in (1.0, -1.0)
        )
        numeric = (ahead - behind) / (2.0 * step)
        np.testing.assert_allclose(slopes[0, :, k], numeric, rtol=1e-6, atol=1e-8)
        assert np.abs(numeric).max() > 1e-3


def test_slopes_of_the_misfits_are_those_of_the_exact_readings(rng):
    m = _measurement()
    series = m.series("cables", rng.uniform(-0.4, 0.4, (10, 2)))
    theta = m.nominal + m.tolerance * rng.standard_normal(len(m.names))
    slopes, step = m.jacobian([series], theta), 1e-6
    for k in range(len(theta)):
        move = step * np.eye(len(theta))[k]
        ends = [m.readings([series], theta + s * move) for s in (1.0, -1.0)]
        difference = (ends[0] - ends[1]) / (2.0 * step)
        assert np.abs(slopes[:, k] - difference).max() < 1e-8


def test_noise_per_leg_is_projected_onto_the_misfits(rng):
    machine = _machine()
    noise = {f"noise_q{i}": v for i, v in enumerate([1e-3, 1e-4, 2e-4, 3e-4], start=1)}
    per_leg = redundancy.per_leg.for_machine(machine)
    m = Measurement(machine, [mount(per_leg, "cables", **noise)])  # type: ignore[arg-type]
    series = m.series("cables", np.array([[0.1, -0.2]]))
    x, _ = m.kinematics.inverse(np.array([[0.1, -0.2]]))
    away = x[0] - planar_cables.ANCHORS
    unit = away / np.linalg.norm(away, axis=1)[:, None]
    across = np.eye(4) - unit @ np.linalg.inv(unit.T @ unit) @ unit.T
    expected = across @ np.diag(np.square(list(noise.values()))) @ across / 4.0
    covariance = m.of(series).reading_covariances(series)[0]
    values = np.linalg.eigvalsh(expected)[-2:]
    assert np.linalg.eigvalsh(covariance) == pytest.approx(values, rel=1e-9)
