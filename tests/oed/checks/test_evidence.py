"""Evidence of readings, of mistakes and of gross errors, against densities and quadrature."""

import dataclasses

import blunder_machines as machines
import numpy as np
import pytest
from scipy import integrate, stats
from shipped_models import a3_head, ball_bar

from kernel.laws import dense_covariance
from oed import checks
from oed.base import Array
from oed.checks import outlier_odds, screening
from oed.checks.explain import candidates
from oed.checks.fit import fit, fit_amounts
from oed.checks.mistakes import Suspect, trials
from oed.checks.outlier_odds import (
    GROSS_ODDS,
    GROSS_SCALE,
    LOCATED_ODDS,
    LeaveOneOut,
    OutlierOdds,
)
from oed.checks.session import CheckedLaw
from oed.instrument import mount
from oed.measurement import Measurement, reading_structure
from oed.noise import Laws, Noise, SharedError
from oed.noise_law import log_prior_of_scale
from oed.noise_law.prior import scale_over_stated

VALUES = {"correlated": 0.4, "reach": 3.0, "level": 0.7, "seat": 0.5}
ONE = Laws(np.array([[1.3]]), **{name: np.array([x]) for name, x in VALUES.items()})


def circles(runs: int = 3, count: int = 12) -> checks.SessionReadings:
    """Circles of a ball bar in one set-up, read on a drawn machine."""
    setup = mount(ball_bar.instrument, "bar", teach=(1.2, 0.0, 0.0), sigma=[0.5e-6])
    m = Measurement(a3_head.machine, [setup])
    psi = np.linspace(-3.0, 3.0, count)
    heights = np.repeat(np.linspace(1.15, 1.25, runs), count)
    tilt = np.full(len(heights), 0.4)
    command = np.column_stack([heights, np.tile(psi, runs), tilt])
    series = [m.series("bar", command, run=[f"z {z:.3f}" for z in heights])]
    rng = np.random.default_rng(3)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = m.readings(series, truth)
    return checks.session_readings(m, series, y + 0.5e-6 * rng.standard_normal(len(y)))


@pytest.fixture(scope="module")
def bar() -> checks.SessionReadings:
    return circles()


def test_the_log_marginal_is_that_of_a_normal_density(bar):
    solution = fit(bar)
    linear = screening.linear_readings(solution)
    unit = dataclasses.replace(ONE, scale=np.ones((1, 1)))
    scale = 1.7
    one = screening._log_marginal(
        linear, linear.slopes, unit, np.zeros(1), np.array([scale])
    )
    covariance = scale**2 * dense_covariance(linear.structure, unit)
    covariance = covariance + linear.slopes @ linear.slopes.T
    expected = stats.multivariate_normal.logpdf(
        linear.residual, np.zeros(len(covariance)), covariance
    )
    normalisation = 0.5 * len(linear.residual) * np.log(2.0 * np.pi)
    assert one == pytest.approx(expected + normalisation, abs=1e-5)
    about = linear.residual - linear.slopes @ solution.departure
    predicted = bar.measurement.readings(bar.series, solution.theta)
    assert about * 0.5e-6 == pytest.approx(bar.y - predicted, abs=1e-15)


def test_the_screening_maximises_a_normal_density(bar):
    given = Suspect(bar)
    screen = screening.Screening(given)
    slopes = given.slopes / 0.5e-6
    residual = (bar.y - given.predicted) / 0.5e-6

    def best(r: Array, h: Array) -> float:
        values = []
        for scale in screen.scales:
            covariance = scale**2 * np.eye(len(r)) + h @ h.T
            density = stats.multivariate_normal.logpdf(r, np.zeros(len(r)), covariance)
            weight = log_prior_of_scale(np.array([scale]), is_assumed=False)[0]
            values.append(density + weight + 0.5 * len(r) * np.log(2.0 * np.pi))
        return float(max(values))

    of_given = screen.as_given().log_evidence
    assert of_given == pytest.approx(best(residual, slopes), abs=1e-4)
    # slopes whose squares hide the noise leave a number, and no likely one
    hidden = screening.log_density_of_one(1e9 * slopes, residual, screen.scales)
    assert (hidden < of_given).all()
    every = list(trials(given))
    of_values = next(t for t in every if t.kind == "sign")
    of_poses = next(t for t in every if t.kind == "pose" and t.table is not None)
    scores = screen.scores([of_values, of_poses])
    assert of_values.y is not None
    moved = (of_values.y - given.predicted) / 0.5e-6
    assert scores[0].log_evidence == pytest.approx(best(moved, slopes), rel=1e-6)
    elsewhere = (bar.y - of_poses.table.predicted) / 0.5e-6
    there = of_poses.table.slopes / 0.5e-6
    assert scores[1].log_evidence == pytest.approx(best(elsewhere, there), rel=1e-6)


def test_scales_have_the_prior_of_their_coordinate():
    u = np.array([-3.0, -0.5, 0.0, 0.7, 3.0, 6.0])
    scale = scale_over_stated(u)
    density = log_prior_of_scale(scale, is_assumed=False)
    assert density == pytest.approx(-0.5 * u**2, abs=1e-9)
    decades = log_prior_of_scale(10.0**u, is_assumed=True)
    assert decades == pytest.approx(-0.5 * u**2, abs=1e-9)


def test_an_offset_is_estimated_as_by_generalised_least_squares(bar):
    moved = bar.with_y(bar.y + 3e-4)
    every = trials(Suspect(moved))
    offset = next(t for t in every if t.kind == "offset" and t.scope.level == "file")
    fitted = fit_amounts(offset, 1.0)
    m = bar.measurement
    h = m.jacobian(bar.series, fitted.theta) * m.tolerance
    covariance = h @ h.T + (0.5e-6) ** 2 * np.eye(len(bar))
    ones = np.ones(len(bar))
    precision = float(ones @ np.linalg.solve(covariance, ones))
    assert fitted.sd[0] == pytest.approx(precision**-0.5, rel=1e-3)
    assert abs(fitted.amounts[0] - 3e-4) < 4.0 * fitted.sd[0]


def long_session() -> checks.SessionReadings:
    """3 circles of 40 readings, of which rows 55 to 81 of the file are in um."""
    session = circles(3, 40)
    y = session.y.copy()
    y[53:80] *= 1e3
    return session.with_y(y)


def test_long_sessions_are_cut_where_a_mistake_begins():
    """In the linear model: the likeliest coarse part leads to the row."""
    given = Suspect(long_session())
    assert given.cut_step > 1
    assert len(given.parts) < 300
    first, _ = candidates(given, screening.Screening(given), thorough=True)
    likeliest = max(first, key=lambda one: one.log_posterior).trial
    assert (likeliest.kind, likeliest.scope.name) == ("unit", "rows 55 to 81")


def test_scopes_are_the_file_its_setups_and_runs(bar):
    levels = [scope.level for scope in Suspect(bar).scopes]
    assert levels == ["file", "run", "run", "run"]
    one = Suspect(bar.take(np.arange(12)))
    assert [scope.level for scope in one.scopes] == ["file"]


def law_of(scale: dict[str, float], level: float = 0.0) -> CheckedLaw:
    numbers = ([[1.0]], [0.3], [4.0], [level], [0.0])
    return CheckedLaw(scale, Laws(*map(np.array, numbers)), np.zeros(0))


def test_noise_of_a_session_has_the_laws_covariance(rng):
    """Groups that the law does not know are as stated."""
    session = machines.session("a3", machines.readings("a3", 1))
    m = session.measurement
    structure = reading_structure(m, session.series, m.nominal)
    name, other = structure.names
    law = law_of({name: 3.0}, level=0.8)
    laws = law.laws(structure)
    assert laws.scale.tolist() == [[3.0, 1.0]]
    dense = dense_covariance(structure, laws) * np.outer(structure.unit, structure.unit)
    white = law.noise(m, session.series).whiten(np.eye(len(session)))
    precision = white.T @ white
    assert precision @ dense == pytest.approx(np.eye(len(session)), abs=1e-8)
    assert other != name


def test_the_size_is_the_largest_standard_deviation():
    session = machines.session("a3", machines.readings("a3", 1))
    m = session.measurement
    structure = reading_structure(m, session.series, m.nominal)
    first, second = structure.names
    law = law_of({first: 3.0, second: 0.5}, level=0.8)
    laws = law.laws(structure)
    dense = np.diag(dense_covariance(structure, laws))
    assert set(structure.kinds.tolist()) >= {SharedError.LEVEL}
    assert law.size(structure) == pytest.approx(np.sqrt(dense.max()))


def test_scales_are_kept_between_ends():
    law = law_of({"a.length": 0.2, "b.length": 1.7, "c.length": 9.0})
    limited = law.with_scale(0.5, 4.0)
    assert limited.scale == {"a.length": 0.5, "b.length": 1.7, "c.length": 4.0}
    assert law.scale["a.length"] == 0.2


READINGS, UNKNOWNS = 30, 5


def precision(slopes: np.ndarray) -> np.ndarray:
    """Inverse (N, N) of the covariance of residuals, of unit noise and tolerances."""
    return np.asarray(np.linalg.inv(np.eye(len(slopes)) + slopes @ slopes.T))


def odds_of(slopes, residual, student=None):
    """Of readings of one value each, of unit noise."""
    p = precision(slopes)
    values, vectors = np.linalg.eigh(np.eye(len(p)) - p)
    factor = vectors * np.sqrt(np.maximum(values, 0.0))
    noise, reading = Noise(np.ones(len(p))), np.arange(len(p), dtype=np.intp)
    gradient, diagonal = p @ residual, np.diag(p).copy()
    return OutlierOdds(LeaveOneOut(gradient, diagonal, factor, noise, reading), student)


def session(seed: int, sizes: dict[int, float]) -> tuple[np.ndarray, np.ndarray]:
    """Slopes of wide tolerances, and residuals with gross errors in sigma."""
    rng = np.random.default_rng([41, seed])
    slopes = 100.0 * rng.standard_normal((READINGS, UNKNOWNS))
    residual = slopes @ rng.standard_normal(UNKNOWNS) + rng.standard_normal(READINGS)
    for place, size in sizes.items():
        residual[place] += size
    return slopes, residual


@pytest.mark.parametrize("size", [0.0, 4.0, 12.0])
def test_a_shift_weighs_what_quadrature_of_its_prior_gives(size):
    slopes, residual = session(1, {3: size})
    p = precision(slopes)
    covariance = np.eye(READINGS) + slopes @ slopes.T
    law = stats.multivariate_normal(np.zeros(READINGS), covariance)
    unit = np.eye(READINGS)[3]
    middle = float((p @ residual)[3] / p[3, 3])

    def density(shift: float) -> float:
        ratio = law.logpdf(residual - shift * unit) - law.logpdf(residual)
        return float(np.exp(ratio) * stats.cauchy.pdf(shift, scale=GROSS_SCALE))

    expected, _ = integrate.quad(density, middle - 60.0, middle + 60.0, points=[middle])
    weights = outlier_odds.log_weights_of_shifts(
        p @ residual, np.diag(p), np.ones(READINGS)
    )
    assert weights[3] == pytest.approx(np.log(expected), abs=1e-3)


def test_with_one_degree_of_freedom_no_reading_is_located():
    """The residual has one direction: every single shift explains it equally."""
    rng = np.random.default_rng(5)
    slopes = 1e4 * rng.standard_normal((7, 6))
    residual = slopes @ rng.standard_normal(6)
    residual[2] += 2000.0
    p = precision(slopes)
    pulls = p @ residual / np.sqrt(np.diag(p))
    assert np.abs(pulls) == pytest.approx(np.abs(pulls[2]), rel=1e-2)
    assert abs(pulls[2]) > 7.0
    asked = odds_of(slopes, residual)
    assert asked.location_odds([2])[2] < np.log(1.0)
    assert set(asked.rivals([2], 2)) == set(range(7))


@pytest.mark.parametrize("places", [(4,), (4, 11), (4, 11, 20), (1, 4, 9, 11, 20)])
def test_redundant_readings_locate_gross_errors(places):
    signs = (1, -1, -1, 1, 1)
    sizes = {k: 20.0 * s for k, s in zip(places, signs, strict=False)}
    slopes, residual = session(2, sizes)
    asked = odds_of(slopes, residual)
    assert min(asked.location_odds(places).values()) > np.log(LOCATED_ODDS)
    assert min(asked.gross_error_odds(places, rest_fits=True).values()) > np.log(
        GROSS_ODDS
    )
    assert asked.rivals(places, places[0]) == (places[0],)


def test_a_sound_reading_is_no_gross_error():
    slopes, residual = session(3, {})
    p = precision(slopes)
    worst = int(np.argmax(np.abs(p @ residual / np.sqrt(np.diag(p)))))
    asked = odds_of(slopes, residual)
    assert asked.gross_error_odds([worst], rest_fits=True)[worst] < 0.0
    assert asked.location_odds([worst])[worst] < np.log(LOCATED_ODDS)


def odds_of_one(errors: np.ndarray, *, student: float | None = None) -> float:
    """Log odds of reading 8, which is off by 15 sigma, beside errors of the others."""
    slopes = 100.0 * np.random.default_rng(6).standard_normal((READINGS, UNKNOWNS))
    residual = errors.copy()
    residual[8] = 15.0
    asked = odds_of(slopes, residual, student)
    return asked.gross_error_odds([8], rest_fits=True)[8]


def test_heavy_tails_of_the_others_make_a_far_reading_noise():
    rng = np.random.default_rng(7)
    normal = [odds_of_one(rng.standard_normal(READINGS)) for _ in range(20)]
    tails = [odds_of_one(rng.standard_t(3.0, READINGS)) for _ in range(20)]
    assert np.median(normal) > np.log(GROSS_ODDS)
    assert np.median(tails) < np.log(GROSS_ODDS)
    errors = rng.standard_normal(READINGS)
    stated = [odds_of_one(errors, student=dof) for dof in (3.0, 6.0, 30.0)]
    assert stated == sorted(stated)


def test_beside_a_misfit_a_moderate_error_proves_nothing():
    slopes, residual = session(5, {})
    residual += 2.0 * np.random.default_rng(8).standard_normal(READINGS)
    residual[8] += 8.0
    residual[15] += 60.0
    asked = odds_of(slopes, residual)
    odds = asked.gross_error_odds([8, 15], rest_fits=False)
    assert odds[8] < np.log(GROSS_ODDS) < odds[15]
