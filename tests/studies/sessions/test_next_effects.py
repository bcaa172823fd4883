"""Advice at a machine with effects: against a dense update of parameters and effects."""

from pathlib import Path

import numpy as np
import pytest

from pkm_studies.sessions import next_reading
from pkm_studies.sessions.next_reading import effects_at
from pkm_studies.study import Study

STUDY = """
schema = 1
name = "small_planar"

[machine]
model = "planar_2dof"

[[setup]]
name = "tracker"
instrument = "pose_tracker_position"

[identify]
effects = {effects}

[design]
readings = 8

[[design.candidates]]
setup = "tracker"
y_mm = {{ from = -1000.0, to = 1000.0, count = 5 }}
z_mm = {{ from = 300.0, to = 1200.0, count = 4 }}

[prediction]
y_mm = [-900.0, 0.0, 900.0]
z_mm = [400.0, 1100.0]
"""


def adviser(folder: Path, effects: str, wanted: str = "") -> next_reading.Adviser:
    file = folder / "small.study.toml"
    file.write_text(STUDY.format(effects=effects), encoding="utf-8")
    return next_reading.Adviser(Study.load(file), wanted)


def test_accuracy_is_that_of_a_dense_update(tmp_path):
    """Parameters and effects with their priors, updated by all readings at once."""
    with_effects = adviser(tmp_path, '["encoder_scale", "gravity"]')
    measurement = with_effects.base.measurement
    taken = [with_effects.base.resolved.candidates[0].take(np.arange(0, 20, 3))]
    y = measurement.readings(taken, measurement.nominal)
    effects = effects_at(with_effects.base, measurement, taken)
    numbers = effects.readings.take(slice(0, len(y)))
    free = measurement.free
    slopes = measurement.jacobian(taken, measurement.nominal) * measurement.tolerance
    rows = np.hstack([slopes[:, free], numbers.columns])
    noise = np.diag(measurement.noise(taken).sigma ** 2 + numbers.scatter**2)
    covariance = np.eye(rows.shape[1])
    gain = rows.T @ np.linalg.inv(rows @ rows.T + noise)
    covariance = covariance - gain @ rows
    raw = (
        with_effects.maps.raw * measurement.tolerance[: with_effects.maps.raw.shape[2]]
    )
    missing = np.zeros((*raw.shape[:2], len(measurement.names) - raw.shape[2]))
    of_parameters = np.concatenate([raw, missing], axis=2)[:, :, free]
    factors = np.concatenate([of_parameters, effects.tool], axis=2)
    variances = np.einsum("nkp,pq,nkq->nk", factors, covariance, factors).mean(axis=0)
    said = with_effects.advise_after(measurement, taken, y)
    assert said.known == pytest.approx(np.sqrt(variances + effects.others), rel=1e-6)
    assert (said.after < said.known).all()


def test_effects_leave_more_than_the_geometry_alone(tmp_path):
    rigid = adviser(tmp_path, '"none"')
    measurement = rigid.base.measurement
    taken = [rigid.base.resolved.candidates[0].take(np.arange(0, 20, 2))]
    y = measurement.readings(taken, measurement.nominal)
    alone = rigid.advise_after(measurement, taken, y)
    real = adviser(tmp_path, '"catalogue"').advise_after(measurement, taken, y)
    assert (real.known > alone.known).all()


def test_what_no_reading_reduces_is_never_reached(tmp_path):
    """Wanted is less than effects that these readings do not tell."""
    rigid = adviser(tmp_path, '"none"', "y_um=5,z_um=5")
    measurement = rigid.base.measurement
    every = [rigid.base.resolved.candidates[0]]
    y = measurement.readings(every, measurement.nominal)
    real = adviser(tmp_path, '"catalogue"', "y_um=5,z_um=5")
    assert not real.advise_after(measurement, every, y).is_reached


def test_residuals_of_expected_effects_are_no_bad_fit(tmp_path):
    """A scale of one drive: the fit without effects is bad, with them it is not."""
    files, expected = {}, {}
    for effects in ('"none"', '["encoder_scale"]'):
        one = adviser(tmp_path, effects)
        measurement = one.base.measurement
        taken = [one.base.resolved.candidates[0]]
        found = expected[effects] = effects_at(one.base, measurement, taken)
        if found is not None:
            change = 2.0 * found.readings.columns[: 3 * len(taken[0]), 0]
        files[effects] = (one, measurement, taken)
    chi2 = {}
    for effects, (one, measurement, taken) in files.items():
        y = measurement.readings(taken, measurement.nominal) + change
        estimate = next_reading._fit(one.base, measurement, taken, y, expected[effects])
        chi2[effects] = estimate.chi2 / estimate.dof
    assert chi2['["encoder_scale"]'] < 1.0
    assert chi2['"none"'] > 4.0 * chi2['["encoder_scale"]']
