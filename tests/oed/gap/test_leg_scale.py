"""A leg whose conversion is wrong: named, called implausible, and estimated unbent."""

from pathlib import Path

import leg_scale
import numpy as np
import pytest
from shipped_models import encoder_scale

from kernel.laws import STATED_LAW
from oed.corrected import EffectReadings
from oed.dataset import Dataset
from oed.estimation import identify
from oed.gap.data import linearisation, problem
from oed.gap.data.linearisation import ActingEffectForm
from oed.measurement import Measurement
from pkm_studies import study as studies
from pkm_studies.resolve import resolved
from pkm_studies.stages.correct.corrected import implausible_sizes


def _session(folder: Path, scale: float) -> tuple[Measurement, Dataset]:
    study = leg_scale.write(folder, leg_scale.readings(scale))
    machine = resolved.resolve(studies.Study.load(study), readings=None)
    measurement = machine.measurement_with(machine.setups)
    assert machine.dataset is not None
    return measurement, machine.dataset


def test_the_joint_estimate_is_that_of_least_squares(tmp_path):
    """At 2000 times the 50 ppm that are expected; others stay near nothing."""
    scale = -0.1
    measurement, data = _session(tmp_path, scale)
    plain = identify(measurement, data.series, data.y)
    given = EffectReadings(measurement, tuple(data.series), data.y, data.covariates)
    corrected = given.estimate([encoder_scale.effect], plain.theta)
    start = corrected.parameters
    values = corrected.estimate.theta[start:] * corrected.scales
    sds = corrected.estimate.sd[start:] * corrected.scales
    wanted, sd = leg_scale.least_squares_scale(leg_scale.readings(scale))
    assert abs(wanted - scale) < 3.0 * sd
    assert abs(values[0] - wanted) < 2.0 * sd
    assert sds[0] == pytest.approx(sd, rel=0.3)
    assert (np.abs(values[1:]) < 4.0 * sds[1:]).all()
    assert corrected.estimate.chi2 < 1.3 * corrected.estimate.dof
    (sentence,) = implausible_sizes(corrected)
    assert sentence.startswith("Encoder scale: leg 1 is -1")
    assert "times the 50 ppm expected. That is implausible" in sentence


def test_the_linear_model_holds_where_the_effect_acts(tmp_path):
    """About the settled point the residuals change as the exact readings do."""
    measurement, data = _session(tmp_path, -0.06)
    given = problem.prepare(measurement, data.series, data.y, data.covariates)
    names = tuple(f"leg {k + 1}" for k in range(6))
    form = ActingEffectForm(encoder_scale.effect, {}, names, 1000.0)
    nothing = np.zeros(len(given))
    settled = linearisation.settle(given, [form], STATED_LAW, nothing)
    assert 10.0 < settled.departure < np.inf
    assert settled.coefficients[0] * 50e-6 == pytest.approx(-0.06, abs=4e-4)
    # what is left beside parameters and effect is noise
    there = settled.problem
    columns = there.noise_units(there.signature(encoder_scale.effect, {}).columns)
    root = measurement.prior_root()[:, measurement.free]
    z = np.linalg.lstsq(root, there.theta - measurement.nominal, rcond=None)[0]
    left = there.residual - there.slopes @ z - columns @ settled.coefficients
    assert np.sqrt(np.mean(left**2)) == pytest.approx(0.94, abs=0.08)
    # a small effect is linear from the start
    small = _session(tmp_path, -2e-4)
    measurement, data = small
    given = problem.prepare(measurement, data.series, data.y, data.covariates)
    small_form = ActingEffectForm(encoder_scale.effect, {}, names, 3.0)
    settled = linearisation.settle(given, [small_form], STATED_LAW, nothing)
    assert settled.departure < 1.0
