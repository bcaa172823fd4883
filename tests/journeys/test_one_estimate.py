"""Diagnosis, corrected model and predictions rest on one estimate and its draws."""

from __future__ import annotations

import json
from pathlib import Path

import bad_fit_sample
import bar_readings
import gap_fixture
import msgspec
import numpy as np
import pytest
import sample
from oracles import a3_geometry as a3

import oed
from oed import units
from oed.linear_algebra import covariance_root
from oed.result import StudyResult
from pkm_studies import stages
from pkm_studies import study as studies
from pkm_studies.stages.predict import prediction

ACTING = "[[gap.acting]]"
A3 = (
    sample.changed(
        gap_fixture.STUDY.split(ACTING)[0],
        (
            '["effects.py:backlash", "effects.py:cold"]',
            '["backlash", "friction", "encoder_scale"]',
        ),
        ("count = 24", "count = 12"),
    )
    + '[[gap.acting]]\neffect = "backlash"\ncoefficients = { "leg 2" = 3.0 }\n'
)


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> tuple[StudyResult, dict]:
    """A diagnosed virtual machine, and the coefficients that it has, SI."""
    folder = tmp_path_factory.mktemp("a3_head")
    path = folder / "case.study.toml"
    path.write_text(A3, encoding="utf-8")
    study = studies.Study.load(path)
    _, truth_file = stages.simulate_study(study, folder / "case.csv")
    truth = json.loads(Path(truth_file).read_text(encoding="utf-8"))["effects"][0]
    readings = [folder / "case.csv"]
    with pytest.MonkeyPatch.context() as patch:
        # the accuracy over all hypotheses takes half of the time
        patch.setattr("pkm_studies.stages.order.mix_answers", lambda state: state)
        return stages.diagnose_study(study, readings, folder / "out", seed=1), truth


def test_one_value_and_one_deviation(case):
    result, truth = case
    gap, corrected = result.gap, result.corrected
    assert truth["effect"] in gap.selected
    shared = {f"{c.effect}: {c.name}": c for c in gap.coefficients}
    assert set(shared) == set(corrected.effects)
    for name, estimate in corrected.effects.items():
        c = shared[name]
        factor = units.coefficient_unit(c.unit)[1]
        assert c.value == pytest.approx(factor * estimate.value, rel=1e-9)
        assert c.sd == pytest.approx(factor * estimate.sd, rel=1e-9)
        assert c.prior_sd == pytest.approx(factor * estimate.prior_sd, rel=1e-9)
    for effect, constants in corrected.constants.items():
        assert gap.constants[effect] == constants


def test_it_is_that_of_the_machine(case):
    result, truth = case
    estimates = {
        c.name: c for c in result.gap.coefficients if c.effect == truth["effect"]
    }
    for name, true in truth["coefficients"].items():
        c = estimates[name]
        assert abs(c.value - true["value"]) < 4.0 * c.sd, name
        if abs(true["prior_sds"]) > 2.0:
            assert abs(c.value) > 5.0 * c.sd, name


@pytest.fixture(scope="module")
def fitted(tmp_path_factory: pytest.TempPathFactory) -> oed.EstimateView:
    """Circles with two tools: one direction of the A3 head stays undetermined."""
    folder: Path = tmp_path_factory.mktemp("fit")
    path, table = bad_fit_sample.write(folder, bar_readings.a3_readings(0))
    study = oed.load_study(path)
    return oed.identify(oed.read_readings(study, table))


def test_draws_give_the_readings_that_were_taken(fitted):
    """By the oracle: normal draws of the covariance move them by micrometres more."""
    state = fitted.state
    assert state.posterior is None
    assert state.estimate is not None
    assert state.readings is not None
    estimate = state.estimate
    theta = prediction._draws(state).theta[:1000]
    root = covariance_root(estimate.covariance)
    rng = np.random.default_rng(1)
    straight = estimate.theta + rng.standard_normal((1000, root.shape[1])) @ root.T
    off = {}
    for name, draws in (("followed", theta), ("straight", straight)):
        read = np.array([exact_readings(state, t) for t in draws[:200]])
        off[name] = np.sqrt(
            np.mean((read - exact_readings(state, estimate.theta)) ** 2)
        )
    noise = np.sqrt(np.mean(estimate.noise.sigma**2))  # as estimated
    assert off["followed"] < 2.0 * noise
    assert off["straight"] > 1.5 * off["followed"]
    spread = theta.std(axis=0)[:24]
    sd = np.sqrt(np.diag(estimate.covariance))[:24]
    assert spread == pytest.approx(sd, rel=0.25)


def exact_readings(state: object, theta: np.ndarray) -> np.ndarray:
    """Readings (N,) of the oracle's machine at theta."""
    parts = []
    m = state.measurement  # type: ignore[attr-defined]
    for s in state.readings.series:  # type: ignore[attr-defined]
        tool = m.setups[s.setup].tool[2]
        poses, teach = s.q[s.index[:, 0]], s.q[s.index[:, 1]]
        offset = theta[m.nuisance_slice(s.setup)]
        cup = a3.forward(theta[:24], teach, tool).tip + offset
        parts.append(a3.ball_bar_reading(theta[:24], poses, cup, tool))
    return np.concatenate(parts)


def test_the_prediction_is_that_of_the_posterior(fitted):
    without = oed.predict(fitted).section.components
    study = fitted.state.study
    table = msgspec.structs.replace(study.posterior, enabled=True)
    study = msgspec.structs.replace(study, posterior=table)
    sampling = type(fitted)(fitted.state.replace(study=study))
    sampled = oed.predict(oed.sample(sampling)).section.components
    for name, spread in without.items():
        exact = sampled[name].after.rms
        assert spread.after.rms == pytest.approx(exact, rel=0.08), name
