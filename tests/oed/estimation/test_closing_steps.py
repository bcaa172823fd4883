"""Steps of a fit stay where all poses close."""

import numpy as np
import pytest
from shipped_models import linear_delta, pose_tracker

from oed.estimation import IdentificationError, identification, identify
from oed.estimation.fit_stages import ReadingsFit
from oed.instrument import mount
from oed.measurement import Measurement
from oed.mechanism import AssemblyError

position = pose_tracker.position


def test_a_step_to_parameters_that_do_not_close_is_halved():
    """With all lengths turned over nothing closes; near the start all does."""
    measurement = Measurement(linear_delta.machine, [mount(position, "tracker")])
    home = linear_delta.machine.home_command
    series = [measurement.series("tracker", home[None])]
    y = measurement.readings(series, measurement.nominal)
    fit = ReadingsFit(measurement, series, y, measurement.noise(series), 20)
    start = measurement.nominal
    wanted = -2.0 * start
    assert not np.isfinite(measurement.try_readings(series, wanted)).all()
    reached = fit.closing(start, wanted)
    assert np.isfinite(measurement.try_readings(series, reached)).all()
    share = (reached - start)[start != 0.0] / (wanted - start)[start != 0.0]
    assert share == pytest.approx(np.full_like(share, share[0]))
    assert np.log2(share[0]) == pytest.approx(round(np.log2(share[0])))
    assert not np.isfinite(
        measurement.try_readings(series, start + 2.0 * (reached - start))
    ).all()
    near = start * (1.0 + 1e-6)
    assert fit.closing(start, near) == pytest.approx(near, abs=0.0)


def test_a_pose_that_fails_in_a_step_is_no_fault_of_the_data(monkeypatch):
    measurement = Measurement(linear_delta.machine, [mount(position, "tracker")])
    home = linear_delta.machine.home_command
    series = [measurement.series("tracker", home + 0.01 * np.eye(3)[[0, 1, 2, 0]])]
    y = measurement.readings(series, measurement.nominal)

    def fails(*_: object) -> None:
        raise AssemblyError("check joint values and their unit", np.arange(4))

    monkeypatch.setattr(identification, "last_stage", fails)
    with pytest.raises(IdentificationError, match="has a pose at the start") as error:
        identify(measurement, series, y)
    assert "joint values" not in str(error.value)
