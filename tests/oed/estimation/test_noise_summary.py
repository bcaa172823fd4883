"""Numbers and warnings of a noise law, runs it predicts, and tolerances too small."""

import dataclasses
import json
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import bad_fit_sample
import bar_readings
import numpy as np
import pytest
import sample
from scipy import optimize, stats
from shipped_models import (
    a3_head,
    laser_ball_bar,
    planar_2dof,
    pose_tracker,
    prs_spindle,
)

from kernel import a3_plans, bar_circles
from kernel.laws import dense_covariance
from oed import Measurement, mount
from oed.estimation import (
    identify,
    law_stage,
    noise_numbers,
    predict_runs,
    tolerance_factor,
)
from oed.estimation.contradictions import ToleranceFactor
from oed.estimation.estimate import large_residuals
from oed.estimation.fit_stages import ReadingsFit, last_stage
from oed.estimation.law_stage import P_CONTRADICTED, check_law
from oed.estimation.noise_summary import MIN_RATIO
from oed.measurement import Series, draw_parameters, draw_readings, reading_structure
from oed.noise import Laws, ReadingStructure
from oed.noise_law import NoisePrior
from oed.posterior import LogDensity
from pkm_studies.commands import main

position = pose_tracker.position

M = a3_plans.measurement()
SERIES = a3_plans.circles(M, 12)
STRUCTURE = reading_structure(M, [SERIES], M.nominal)
LONGEST = max(Counter(SERIES.run).values())
WEIGHTS = np.array([0.1, 0.2, 0.3, 0.4])


WHITE = -7.0  #: coordinate of the share carried along at which there is next to none


def scatter_within_run(laws: Laws, k: int) -> float:
    """Expected standard deviation about the mean of the longest run, of unit scale."""
    lag = np.abs(np.subtract.outer(np.arange(LONGEST), np.arange(LONGEST)))
    share = laws.correlated[k]
    whole = (1.0 - share) * np.eye(LONGEST) + share * np.exp(-lag / laws.reach[k])
    return float(np.sqrt(np.trace(whole - whole.mean(axis=0)) / (LONGEST - 1)))


def posterior(draws: np.ndarray) -> Any:
    law = {"prior": NoisePrior.of(STRUCTURE), "structure": STRUCTURE}
    return SimpleNamespace(**law, draws=draws, weights=WEIGHTS)


def test_means_and_deviations_are_the_draws(rng):
    prior = NoisePrior.of(STRUCTURE)
    draws = rng.standard_normal((4, prior.dimensions))
    laws = prior.laws(draws)
    numbers = {n.kind: n for n in noise_numbers(posterior(draws), M.setups)}
    (setup,) = M.setups.values()
    sigma = 1e6 * setup.sigma[0]
    size = sigma * laws.scale[:, 0] * [scatter_within_run(laws, k) for k in range(4)]
    mean = WEIGHTS @ size
    reading = numbers["reading"]
    assert (reading.value, reading.stated) == pytest.approx((mean, sigma))
    assert reading.sd == pytest.approx(np.sqrt(WEIGHTS @ (size - mean) ** 2))
    assert reading.unit == "um"
    run = numbers["run"]
    assert run.value == pytest.approx(sigma * WEIGHTS @ (laws.scale[:, 0] * laws.level))
    carried = numbers["carried"]
    assert carried.value == pytest.approx(WEIGHTS @ laws.correlated)
    reach = np.minimum(laws.reach, LONGEST)
    assert numbers["reach"].value == pytest.approx(WEIGHTS @ reach)


@pytest.mark.parametrize("factor", [1.0, 1.1, 1.4, 0.7])
def test_scatter_departs_where_all_draws_do(factor):
    prior = NoisePrior.of(STRUCTURE)

    def scale(u: float) -> float:
        point = np.zeros((1, prior.dimensions))
        point[0, :2] = u, WHITE
        return float(prior.laws(point).scale[0, 0])

    draws = np.zeros((4, prior.dimensions))
    draws[:, 1] = WHITE
    draws[:, 0] = optimize.brentq(lambda u: scale(u) - factor, -2.0, 2.0)
    (reading, *_) = noise_numbers(posterior(draws), M.setups)
    assert reading.departs == (factor > MIN_RATIO or factor < 1.0 / MIN_RATIO)


def test_each_channel_has_its_own_noise_however_far_another_is_overstated():
    """Two white channels of twice the stated noise, one of a seventeenth."""
    stated = np.array([10e-6, 10e-6, 10e-6])
    m = Measurement(planar_2dof.machine, [mount(position, "tracker", sigma=stated)])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 8), np.linspace(0.2, 1.3, 5))
    series = m.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(7)
    truth = stated * [1.0 / 17.0, 2.0, 2.0]
    readings = m.readings([series], draw_parameters(m, rng)).reshape(-1, 3)
    readings += truth * rng.standard_normal(readings.shape)
    estimate = identify(m, [series], readings.ravel(), estimate_noise=True)
    assert estimate.noise_posterior is not None
    numbers = noise_numbers(estimate.noise_posterior, m.setups)
    scatter = [n for n in numbers if n.kind == "reading"]
    sizes = np.array([n.value for n in scatter]) * 1e-6
    # of 40 readings each: some 12 % of a standard deviation, and a few directions
    assert sizes == pytest.approx(truth, rel=0.35)
    assert all(n.departs for n in scatter)
    assert not any(n.departs for n in numbers if n.kind == "carried")


def test_the_scatter_of_a_channel_is_that_of_all_its_sources():
    """A laser's x, y, z share range and angles; a scale is that of one source."""
    m = Measurement(
        prs_spindle.machine,
        [mount(laser_ball_bar.instrument, "laser", at_x=0.0, at_y=-0.7, at_z=0.2)],
    )
    command = np.random.default_rng(4).uniform(
        [0.1, -0.3, -0.3], [0.3, 0.3, 0.3], (6, 3)
    )
    series = m.series("laser", command)
    structure = reading_structure(m, [series], m.nominal)
    prior = NoisePrior.of(structure)
    draws = np.zeros((1, prior.dimensions))
    draws[0] = WHITE
    scale = np.array([1.0, 0.4, -0.8, 1.5, -2.0])
    draws[0, :5] = scale
    laws = prior.laws(draws)
    law = {
        "prior": prior,
        "structure": structure,
        "draws": draws,
        "weights": np.ones(1),
    }
    numbers = noise_numbers(SimpleNamespace(**law), m.setups)
    root = structure.restore(np.diag(laws.scale[0, structure.group])).T
    variance = (root**2).sum(axis=1)
    for g, one in enumerate(n for n in numbers if n.kind == "reading"):
        expected = np.sqrt(variance[structure.group == g].mean())
        unit = 1e-6 if one.unit == "um" else np.deg2rad(1.0 / 3600.0)
        assert one.value * unit == pytest.approx(expected, rel=1e-5)


def estimate(ratio: float, posterior: object = None) -> Any:
    return SimpleNamespace(
        chi2=40.0 * ratio**2, dof=40.0, noise_posterior=posterior, law_check=None
    )


@pytest.mark.parametrize(("ratio", "posterior", "words"), [
    (1.2, None, None),
    (3.0, None, "repeat readings on the spot: what scatters there is noise"),
    (3.0, "known", "the intervals are as wide as the residuals ask for"),
    (11.0, None, "or the readings have a mistake"),
])  # fmt: skip
def test_the_remedy_follows_from_how_large_they_are(ratio, posterior, words):
    sentences = large_residuals(estimate(ratio, posterior))
    if words is None:
        assert sentences == []
        return
    (sentence,) = sentences
    assert words in sentence
    assert f"{ratio:.1f} times the stated noise" in sentence


machine = planar_2dof.machine

MEASUREMENT = Measurement(machine, [mount(position, "tracker")])
ACROSS, UP = np.meshgrid(np.linspace(-1.2, 1.2, 9), np.linspace(0.2, 1.3, 8))
TRACKED = [MEASUREMENT.series("tracker", np.column_stack([ACROSS.ravel(), UP.ravel()]))]


def readings_with_wave(amplitude: float) -> np.ndarray:
    """Readings with a smooth error over the workspace, in stated standard deviations."""
    rng = np.random.default_rng(1)
    truth = draw_parameters(MEASUREMENT, rng)
    y = draw_readings(MEASUREMENT, TRACKED, truth, rng)
    place = np.repeat((ACROSS + UP).ravel(), len(y) // ACROSS.size)
    return y + amplitude * MEASUREMENT.sigma(TRACKED) * np.sin(3.0 * place)


@pytest.fixture
def contradicted(monkeypatch):
    """Every noise law is contradicted, so that readings have their stated weights."""
    monkeypatch.setattr(law_stage, "P_CONTRADICTED", 2.0)


def determined_covariance(estimate):
    """Covariance of the combinations that the readings determine, in stated tolerances."""
    dual = identify(MEASUREMENT, TRACKED, readings_with_wave(0.0)).coordinates.dual
    return dual @ estimate.covariance @ dual.T


@pytest.mark.usefixtures("contradicted")
@pytest.mark.parametrize("amplitude", [5.0, 100.0])
def test_doubt_of_the_noise_widens_intervals_and_moves_no_value(amplitude):
    y = readings_with_wave(amplitude)
    doubted = identify(MEASUREMENT, TRACKED, y, estimate_noise=True)
    stated = identify(MEASUREMENT, TRACKED, y)
    moved = (doubted.theta - stated.theta)[MEASUREMENT.free]
    assert np.abs(moved / stated.sd[MEASUREMENT.free]).max() < 1e-3
    assert any("stated weights" in warning for warning in doubted.warnings)
    assert doubted.scatter == pytest.approx(np.sqrt(doubted.chi2 / doubted.dof))
    factor = doubted.law_check.widening
    assert factor > 0.5 * np.sqrt(stated.chi2 / stated.dof)
    wider, alone = (np.diag(determined_covariance(e)) for e in (doubted, stated))
    assert np.allclose(np.sqrt(wider / alone), factor, rtol=0.02)
    # what readings tell of a parameter is no matter of the widening
    assert np.allclose(doubted.shrinkage, stated.shrinkage, atol=0.02)


@pytest.mark.usefixtures("contradicted")
def test_sampled_density_has_the_widened_covariance():
    y = readings_with_wave(20.0)
    estimate = identify(MEASUREMENT, TRACKED, y, estimate_noise=True)
    density = LogDensity(MEASUREMENT, TRACKED, y, estimate)
    dual = estimate.coordinates.dual
    expected = dual @ estimate.covariance @ dual.T
    assert np.allclose(density.root @ density.root.T, expected, rtol=1e-6, atol=1e-12)


def test_noise_as_stated_has_its_law():
    estimate = identify(
        MEASUREMENT, TRACKED, readings_with_wave(0.0), estimate_noise=True
    )
    assert not estimate.law_check.is_contradicted
    assert estimate.noise_posterior is not None
    assert estimate.scatter == 1.0


def test_a_law_that_does_not_settle_says_so(monkeypatch):
    stated, y = MEASUREMENT.noise(TRACKED), readings_with_wave(0.0)
    fit = ReadingsFit(MEASUREMENT, TRACKED, y, stated, 100)
    first = last_stage(fit, MEASUREMENT.nominal, ("*",))
    structure, prior = law_stage.structure_and_prior(fit, first)
    assert law_stage.settle_law(fit, first, structure, prior).has_settled
    monkeypatch.setattr(law_stage, "MAX_ROUNDS", 1)
    assert not law_stage.settle_law(fit, first, structure, prior).has_settled


head = a3_head.machine


def identified(folder: Path, factor: float) -> tuple[dict[str, Any], str]:
    """Result and study of an independent head whose tolerances are stated with a factor."""
    folder.mkdir()
    wide = [
        p for p in head.parameters if p.tolerance > 0.0 and p.name not in head.frame
    ]
    sizes = [("rad", 1.0) if p.unit == "rad" else ("mm", 1e3) for p in wide]
    lines = [
        f'[[prior.tolerance]]\nparameters = ["{p.name}"]\n'
        f"sigma_{unit} = {factor * p.tolerance * scale:.9g}\n"
        for p, (unit, scale) in zip(wide, sizes, strict=True)
    ]
    text = sample.changed(
        bad_fit_sample.WITHOUT_REPORT, ("[posterior]", "".join(lines) + "\n[posterior]")
    )
    study, readings = bad_fit_sample.write(folder, bar_readings.a3_readings(3), text)
    out = folder / "out"
    main(["identify", str(study), "--readings", str(readings), "--out", str(out)])
    return json.loads((out / "result.json").read_text()), text


def test_the_fit_is_that_of_tolerances_as_they_are(tmp_path):
    right, _ = identified(tmp_path / "right", 1.0)
    small, _ = identified(tmp_path / "small", 0.1)
    assert any("times as far from nominal" in w for w in small["warnings"])
    assert not any("as far from nominal" in w for w in right["warnings"])
    assert not small["goodness"]["bad_fit"]
    for name, p in right["estimate"]["parameters"].items():
        other = small["estimate"]["parameters"][name]
        if p["prior_sd"] > 0.0:
            assert abs(other["value"] - p["value"]) < 0.5 * p["sd"] + 1e-9
    for name, c in right["prediction"]["components"].items():
        after = small["prediction"]["components"][name]["after"]["rms"]
        assert after == pytest.approx(c["after"]["rms"], rel=0.2)


def planar() -> tuple[Measurement, list[Any]]:
    measurement = Measurement(machine, [mount(position, "tracker")])
    across, up = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    command = np.column_stack([across.ravel(), up.ravel()])
    return measurement, [measurement.series("tracker", command)]


@pytest.mark.parametrize("seed", range(4))
def test_tolerances_that_are_right_are_kept(seed):
    measurement, series = planar()
    rng = np.random.default_rng(seed)
    truth = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, truth, rng)
    estimate = identify(measurement, series, y)
    assert not tolerance_factor(measurement, series, estimate).is_sure
    small = ToleranceFactor(0.1, 0.0, 1.0).widened(measurement)
    judged = tolerance_factor(small, series, identify(small, series, y))
    assert judged.is_sure
    assert 5.0 < judged.factor < 20.0


def test_an_effect_is_no_wrong_tolerance():
    """A smooth error of 20 times the noise that no parameters explain."""
    measurement, series = planar()
    rng = np.random.default_rng(5)
    truth = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, truth, rng)
    wave = np.sin(np.linspace(0.0, 25.0, len(y)))
    y = y + 20.0 * measurement.sigma(series) * wave
    estimate = identify(measurement, series, y)
    assert not tolerance_factor(measurement, series, estimate).is_sure


@pytest.fixture(scope="module")
def structure() -> ReadingStructure:
    """Three runs of a ball bar."""
    return bar_circles.circles(12)


@pytest.fixture(scope="module")
def law(structure: ReadingStructure) -> Laws:
    """Most of the noise is carried along, and each run has a level."""
    groups = len(structure.names)
    one = np.ones(1)
    return Laws(np.full((1, groups), 1.5), 0.7 * one, 5.0 * one, 0.8 * one, 0.3 * one)


def test_the_covariance_of_sums_is_that_of_a_dense_matrix(structure, law):
    values = np.random.default_rng(1).standard_normal((len(structure), 4))
    exact = values.T @ dense_covariance(structure, law) @ values
    assert law.errors(structure).covariance_of(values) == pytest.approx(exact)


def test_the_ratio_and_the_widening_are_those_of_dense_matrices(structure, law):
    rng = np.random.default_rng(2)
    slopes = 2.0 * rng.standard_normal((len(structure), 6))
    residual = 3.0 * rng.standard_normal(len(structure))
    c = dense_covariance(structure, law)
    none = np.zeros(1)
    d = dense_covariance(
        structure, dataclasses.replace(law, correlated=none, level=none)
    )
    d *= 1.0 + law.level**2
    by_d = np.linalg.solve(np.eye(6) + slopes.T @ np.linalg.inv(d) @ slopes, slopes.T)
    by_c = np.linalg.solve(np.eye(6) + slopes.T @ np.linalg.inv(c) @ slopes, slopes.T)
    gain = by_d @ np.linalg.inv(d)
    gain_c = by_c @ np.linalg.inv(c)
    fit = np.linalg.cholesky(np.linalg.inv(d)).T @ slopes
    z = (gain - gain_c) @ residual

    def scatter(k: np.ndarray) -> np.ndarray:
        prior = np.eye(6) - k @ slopes
        return k @ c @ k.T + prior @ prior.T

    expected = np.trace(fit @ (scatter(gain) - scatter(gain_c)) @ fit.T)
    check = check_law(structure, law, residual, slopes)
    assert check.ratio == pytest.approx(np.sum((fit @ z) ** 2) / expected, rel=1e-6)
    t = dense_covariance(structure, Laws.stated(structure))
    information = slopes.T @ np.linalg.solve(t, slopes)
    least_squares = np.linalg.solve(information, np.linalg.solve(t, slopes).T)
    variances = least_squares @ c @ least_squares.T @ information
    assert check.widening == pytest.approx(np.sqrt(np.trace(variances) / 6))


def test_readings_of_the_law_are_rarely_contradicted(structure, law):
    rng = np.random.default_rng(3)
    slopes = 2.0 * rng.standard_normal((len(structure), 6))
    root = np.linalg.cholesky(dense_covariance(structure, law))
    count, contradicted = 300, 0
    for _ in range(count):
        errors = root @ rng.standard_normal(len(structure))
        residual = slopes @ rng.standard_normal(6) + errors
        contradicted += check_law(structure, law, residual, slopes).is_contradicted
    rate = stats.binomtest(contradicted, count).proportion_ci(0.999)
    assert rate.low < P_CONTRADICTED < rate.high


def test_noise_of_single_readings_leaves_nothing_to_test(structure, law):
    none = np.zeros(1)
    alone = dataclasses.replace(law, correlated=none, level=none, seat=none)
    slopes = np.random.default_rng(4).standard_normal((len(structure), 6))
    check = check_law(structure, alone, slopes[:, 0], slopes)
    assert not check.is_contradicted
    assert check.widening == pytest.approx(float(law.scale[0, 0]), rel=0.2)


Problem = tuple[Measurement, list[Series], np.ndarray]
POINTS, STROKES = 10, (0.02, 0.08, 0.14, 0.2)


def problem(seed: int) -> Problem:
    """Four circles of an A3 head, a run each."""
    m = a3_plans.measurement()
    circles = a3_plans.circles(m, POINTS, strokes=STROKES)
    runs = [f"c{k // POINTS}" for k in range(len(circles))]
    series = [m.series("cup", circles.reading_commands(), runs)]
    rng = np.random.default_rng([seed, 4])
    truth = m.nominal + 0.1 * m.tolerance * rng.standard_normal(len(m.nominal))
    return m, series, draw_readings(m, series, truth, rng)


@pytest.mark.parametrize("estimate_noise", [False, True])
def test_a_run_is_predicted_as_by_conditional_normal_laws(estimate_noise):
    m, series, y = problem(0)
    estimate = identify(m, series, y, estimate_noise=estimate_noise)
    h = m.jacobian(series, estimate.theta)
    whole = np.linalg.inv(estimate.noise.whiten(np.eye(len(y))))
    spread = whole @ whole.T + (h * m.tolerance**2) @ h.T
    noise = np.linalg.inv(estimate.noise.split_common()[0].whiten(np.eye(len(y))))
    noise = noise @ noise.T
    taken = y if estimate.robust_readings is None else estimate.robust_readings
    linear = m.readings(series, estimate.theta) - h @ (estimate.theta - m.nominal)
    result = predict_runs(m, series, estimate)
    assert [one.run for one in result.runs] == ["c0", "c1", "c2", "c3"]
    r = taken - linear
    for k, one in enumerate(result.runs):
        b = np.arange(k * POINTS, (k + 1) * POINTS)
        a = np.setdiff1d(np.arange(len(y)), b)
        gain = np.linalg.solve(spread[np.ix_(a, a)], spread[np.ix_(a, b)]).T
        error = r[b] - gain @ r[a]
        covariance = spread[np.ix_(b, b)] - gain @ spread[np.ix_(a, b)]
        chi2 = error @ np.linalg.solve(covariance, error)
        assert one.chi2 == pytest.approx(chi2, rel=1e-3)
        size = np.linalg.slogdet(covariance)[1]
        unit = np.linalg.slogdet(noise[np.ix_(b, b)])[1]
        density = -0.5 * (POINTS * np.log(2 * np.pi) + size - unit + chi2)
        assert one.log_score == pytest.approx(density, rel=1e-3)
    assert result.log_score == pytest.approx(sum(o.log_score for o in result.runs))


def test_only_a_run_that_does_not_fit_the_others_is_surprising():
    m, series, y = problem(1)
    sound = predict_runs(m, series, identify(m, series, y))
    assert not sound.surprising
    shifted = y + 20e-6 * (np.arange(len(y)) // POINTS == 2)
    result = predict_runs(m, series, identify(m, series, shifted))
    assert "c2" in [one.run for one in result.surprising]
    assert result.log_score < sound.log_score - 50.0


def test_one_run_alone_has_no_others():
    m = a3_plans.measurement()
    series = [a3_plans.circles(m, POINTS)]
    y = m.readings(series, m.nominal)
    assert len(dict.fromkeys(series[0].run)) == 1
    assert predict_runs(m, series, identify(m, series, y)) is None
