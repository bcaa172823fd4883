"""A measurement with effects against readings and slopes put together by hand."""

import numpy as np
import pytest
from shipped_models import planar_2dof, pose_tracker

from oed.corrected.fit import MeasurementWithEffects
from oed.instrument import TakenReadings, mount
from oed.measurement import Measurement

position = pose_tracker.position

SIZES = np.array([2e-6, 5e-6])
BASE = Measurement(planar_2dof.machine, [mount(position, "tracker")])
SERIES = BASE.series(
    "tracker", np.array([[0.0, 0.5], [1.0, 0.5], [-0.7, 1.0], [0.3, 0.2]])
)
N = len(BASE.readings([SERIES], BASE.nominal))
_rng = np.random.default_rng(3)
COLUMNS, OFFSET = _rng.standard_normal((N, 2)), 1e-6 * _rng.standard_normal(N)
BOTH = MeasurementWithEffects(
    BASE, [SERIES], ["play: leg 1", "play: leg 2"], SIZES, COLUMNS, OFFSET
)


def theta(rng: np.random.Generator) -> np.ndarray:
    of_base = BASE.nominal + BASE.tolerance * rng.standard_normal(len(BASE.nominal))
    return np.append(of_base, SIZES * rng.standard_normal(2))


def test_readings_are_the_machines_plus_the_effects(rng):
    point = theta(rng)
    expected = BASE.readings([SERIES], point[:-2]) + COLUMNS @ point[-2:] + OFFSET
    assert BOTH.readings([SERIES], point) == pytest.approx(expected, abs=1e-12)
    assert [p.name for p in BOTH.parameters[-2:]] == ["play: leg 1", "play: leg 2"]
    assert BOTH.tolerance[-2:] == pytest.approx(SIZES)


def test_slopes_are_differences_of_readings(rng):
    point, step = theta(rng), 1e-6
    slopes = BOTH.jacobian([SERIES], point)
    for k, change in enumerate(step * np.eye(len(point))):
        ahead = BOTH.readings([SERIES], point + change)
        behind = BOTH.readings([SERIES], point - change)
        expected = (ahead - behind) / (2.0 * step)
        assert slopes[:, k] == pytest.approx(expected, abs=1e-7)


def test_some_readings_have_their_rows(rng):
    rows, point = np.array([0, 2]), theta(rng)
    part = SERIES.take(rows)
    some = BOTH.taken_measurement([TakenReadings(SERIES, part, rows)])
    channels = N // len(SERIES)
    values = (rows[:, None] * channels + np.arange(channels)).ravel()
    every = BOTH.readings([SERIES], point)
    assert some.readings([part], point) == pytest.approx(every[values], abs=1e-12)


def test_a_coefficient_is_as_long_as_its_change_of_the_readings():
    expected = SIZES * np.sqrt((COLUMNS**2).mean(axis=0))
    assert BOTH.length_factors[-2:] == pytest.approx(expected)
