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
from oed.result import StudyResult
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.resolve import resolved

FEW = '["encoder_scale", "pitch_accumulation", "joint_runout", "gravity"]'


def _session(folder: Path, scale: float) -> tuple[Measurement, Dataset]:
    study = leg_scale.write(folder, leg_scale.readings(scale))
    machine = resolved.resolve(studies.Study.load(study), readings=None)
    measurement = machine.measurement_with(machine.setups)
    assert machine.dataset is not None
    return measurement, machine.dataset


@pytest.mark.parametrize(
    "scale", [-0.1, *(pytest.param(k, marks=pytest.mark.slow) for k in (0.001, 0.03))]
)
def test_the_joint_estimate_is_that_of_least_squares(
    tmp_path: Path, scale: float
) -> None:
    """From 20 to 2000 times the 50 ppm that are expected; others stay near nothing."""
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


@pytest.fixture(scope="module")
def result(tmp_path_factory: pytest.TempPathFactory) -> StudyResult:
    folder = tmp_path_factory.mktemp("leg_scale")
    study = studies.Study.load(leg_scale.write(folder, leg_scale.readings(-0.06), FEW))
    return stages.diagnose_study(study, None, folder / "out", seed=1)


@pytest.mark.slow
def test_six_percent_are_named_and_called_implausible(result: StudyResult) -> None:
    gap = result.gap
    assert gap.verdict == "effect"
    assert gap.selected == ["encoder_scale"]
    assert next(p.block for p in gap.where if p.p_value < 0.05) == "leg 1"
    (sentence,) = [s for s in gap.words if "implausible" in s]
    assert sentence.startswith("Encoder scale: leg 1 is -6")
    assert "1200 times the 50 ppm expected" in sentence
    assert "conversion factor" in sentence


@pytest.mark.slow
def test_both_sections_have_one_estimate(result: StudyResult) -> None:
    gap, corrected = result.gap, result.corrected
    assert corrected is not None
    wanted, sd = leg_scale.least_squares_scale(leg_scale.readings(-0.06))
    leg = next(c for c in gap.coefficients if c.name == "leg 1")
    assert abs(leg.value - wanted) < 2.0 * sd
    for c in gap.coefficients:
        other = corrected.effects[f"{c.effect}: {c.name}"]
        assert (c.value, c.sd) == pytest.approx((1e-6 * other.value, 1e-6 * other.sd))
    assert all(
        after < 0.05 * before
        for before, after in zip(
            gap.rms_before.values(), gap.rms_after.values(), strict=True
        )
    )


def test_the_linear_model_holds_where_the_effect_acts(tmp_path: Path) -> None:
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
    columns = there.in_noise_units(there.signature(encoder_scale.effect, {}).columns)
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
