"""Sensors on passive joints and constraints: slopes and ranks against closures written
anew (`constraint_machines`), what leads a locked machine, and the advice on sensors.
"""

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
    external_slopes,
    hexapod_lengths,
    locked_poses,
    rank_of,
    seat_slopes,
    sensor_slopes,
    turned,
)
from shipped_models import hexapod

from oed.identifiability import Assessment, recoveries
from oed.instrument import Setup, mount
from oed.measurement import Measurement, Series, commands_at_fixed_reading
from pkm_models.instruments import camera, passive_joint, seat, touch_plane

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
