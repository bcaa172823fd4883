"""Verdicts on a fit, and the figures, rows and columns of its sentences."""

from pathlib import Path

import blunder_machines as machines
import numpy as np
import pandas as pd
import pytest
import sample
from scipy import stats

from oed import checks, dataset
from oed.checks import explain, sentences
from oed.checks.copies import CoarseReadings, EqualReadings
from oed.checks.findings import Severity, rounded
from oed.checks.fit import fit, goodness, goodness_of, goodness_of_estimate
from oed.checks.mistakes import Suspect
from oed.checks.session import Ranges, SessionReadings
from oed.dataset.data import short_names
from oed.estimation import identify

SIGMA = 0.5e-3  # mm, of the bar


@pytest.mark.parametrize("chi2", [1.0, 7.0, 30.0])
def test_goodness_is_that_of_a_gamma_law_with_mean_and_variance(chi2):
    weights = np.array([1.0, 1.0, 0.5, 0.25, 0.1] * 3)
    mean, variance = weights.sum(), 2.0 * weights @ weights
    law = stats.gamma(a=mean**2 / variance, scale=variance / mean)
    told = goodness_of(chi2, weights)
    assert told.dof == pytest.approx(mean)
    assert told.p_low == pytest.approx(law.cdf(chi2))
    assert told.p_high == pytest.approx(law.sf(chi2))


def test_the_law_is_that_of_drawn_sums(rng):
    weights = np.linspace(0.2, 1.0, 12)
    sums = rng.standard_normal((40_000, 12)) ** 2 @ weights
    for chi2 in np.quantile(sums, [0.1, 0.5, 0.9]):
        assert goodness_of(chi2, weights).p_low == pytest.approx(
            np.mean(sums < chi2), abs=0.02
        )


def test_a_fit_without_freedom_says_nothing():
    nothing = goodness_of(3.0, np.zeros(4))
    assert (nothing.dof, nothing.p_low, nothing.p_high) == (0.0, 1.0, 1.0)
    assert nothing.ratio is None


def test_readings_in_doubt_are_in_no_figure():
    """Their residuals and their weights leave, and nothing else does."""
    session = machines.session("a3", machines.readings("a3", 0))
    m, series = session.measurement, session.series
    estimate = identify(m, series, session.y)
    doubtful = np.zeros(len(session), dtype=bool)
    whole = goodness_of_estimate(m, series, estimate, doubtful)
    assert whole.chi2 == pytest.approx(estimate.chi2)
    doubtful[[3, 40]] = True
    rest = goodness_of_estimate(m, series, estimate, doubtful)
    white = estimate.residuals / m.sigma(series)
    assert rest.chi2 == pytest.approx(whole.chi2 - np.sum(white[doubtful] ** 2))
    slopes = m.jacobian(series, estimate.theta)[~doubtful] * m.tolerance
    values = np.linalg.svd(slopes / m.sigma(series)[~doubtful, None], compute_uv=False)
    determined = float(np.sum(values**2 / (1.0 + values**2)))
    assert rest.dof == pytest.approx(len(slopes) - determined, abs=1e-6)
    solution = fit(session)
    assert solution is not None
    assert goodness(solution).dof == pytest.approx(whole.dof, abs=0.1)


def test_one_far_reading_is_no_misfit_of_the_others():
    rows = machines.readings("a3", 3)
    clean = explain.as_given(fit(machines.session("a3", rows)))
    rows.loc[17, "length_mm"] += 50.0 * SIGMA
    spoiled = explain.as_given(fit(machines.session("a3", rows)))
    rows["length_mm"] += 50.0 * SIGMA * (np.arange(len(rows)) % 2)
    many = explain.as_given(fit(machines.session("a3", rows)))
    assert spoiled.after == pytest.approx(clean.after, rel=0.1)
    assert many.after > 10.0
    assert spoiled.log_posterior < clean.log_posterior


def test_readings_left_out_are_anywhere_about_nominal():
    """Each of them has SciPy's Cauchy density, and may be any of all readings."""
    rows = machines.readings("a3", 3)
    rows.loc[17, "length_mm"] += 80.0 * SIGMA
    rows.loc[41, "length_mm"] -= 120.0 * SIGMA
    session = machines.session("a3", rows)
    solution = fit(session)
    assert solution is not None
    rest, log_density = explain._drop_outliers(solution)
    assert len(rest.session) == len(session) - 2
    given, far = Suspect(session), [17, 41]
    law = stats.cauchy(given.predicted[far], 3.0 * given.spread[far])
    exact = law.logpdf(session.y[far]).sum() - 2.0 * np.log(len(session))
    assert log_density == pytest.approx(exact, rel=1e-12)


def test_a_mistake_that_leaves_no_reading_is_judged():
    session = machines.session("a3", machines.readings("a3", 3))
    assert explain._log_of_poses_read(session, []) == 0.0


@pytest.mark.parametrize("most", [5, 24, 48, 60])
def test_a_sample_has_the_first_and_the_last_reading(monkeypatch, most):
    monkeypatch.setattr(explain, "MAX_COMPARED", most)
    session = machines.session("a3", machines.readings("a3", 3))
    sample = explain._sample(session)
    assert len(sample) == min(most, len(session))
    assert sample.y[[0, -1]] == pytest.approx(session.y[[0, -1]])


def candidate(what, log_posterior, kind="unit", ratio=1.0):
    return explain.Explanation(kind, what, np.inf, ratio, 1.0, log_posterior)


def test_mistakes_and_none_share_the_probability():
    """By Bayes' rule, with the prior of no mistake."""
    nothing = candidate("", -400.0, ratio=90.0)
    one, two = candidate("in um", -100.0), candidate("in inch", -102.0)
    told = explain._explanations([one, two], nothing, before=90.0, count=50)
    assert [e.what for e in told] == ["in um", "in inch"]
    odds = np.exp([0.0, -2.0])
    assert [e.probability for e in told] == pytest.approx(odds / odds.sum())


def test_a_mistake_that_is_not_far_likelier_explains_nothing():
    nothing = candidate("", -100.0, ratio=90.0)
    prior = np.log1p(-explain.MISTAKE_PROBABILITY)
    for gain, count in ((-0.1, 0), (0.1, 1)):
        one = candidate("in um", -100.0 + prior + explain.MIN_LOG_ODDS + gain)
        assert (
            len(explain._explanations([one], nothing, before=90.0, count=50)) == count
        )
    assert explain._explanations([], nothing, before=90.0, count=50) == []
    left = candidate("in um", -10.0, ratio=50.0)
    assert explain._explanations([left], nothing, before=90.0, count=50) == []
    assert explain._explanations([left], None, before=np.inf, count=50) == []
    # backlash whose first readings come from the other side: 2.8 to 2.4 is no cause
    for before, after in ((0.94, 0.9), (0.94, 0.2), (1.8, 1.75), (2.8, 2.4)):
        no_better = candidate("in um", -10.0, ratio=after)
        assert explain._explanations([no_better], nothing, before, count=50) == []
    small = candidate("in um", -10.0, ratio=1.5)
    assert len(explain._explanations([small], None, before=np.inf, count=50)) == 1


def test_of_one_mistake_the_likeliest_form_counts():
    one, two = candidate("in um", -102.0), candidate("in um", -100.0)
    other = candidate("in inch", -101.0)
    assert explain._distinct([one, other, two]) == [two, other]


def test_only_a_specific_mistake_settles_the_search():
    nothing = candidate("", -400.0)
    assert explain._settles(candidate("in um", -100.0), nothing)
    assert not explain._settles(candidate("in um", -399.0), nothing)
    assert explain._settles(
        candidate("in um", -400.0 + explain.MAX_LOG_DEFICIT), nothing
    )
    at_the_limit = candidate("in um", -100.0, ratio=explain.SETTLED_RATIO)
    assert explain._settles(at_the_limit, nothing)
    assert not explain._settles(candidate("any", -100.0, kind="size"), nothing)
    assert not explain._settles(candidate("in um", -100.0, ratio=1.6), nothing)
    assert explain._settles(candidate("in um", -1e6), None)


@pytest.mark.parametrize(("value", "sd", "words"), [
    (12.3456, 0.07, "12.35"), (12.3, 4.0, "12"), (1234567.0, 0.1, "1234567"),
    (0.5, 0.1, "0.5"), (3.14159, 0.0, "3.142"),
])  # fmt: skip
def test_a_number_has_the_digits_that_its_deviation_leaves(value, sd, words):
    assert rounded(value, sd) == words


def of_two_files(tmp_path: Path) -> SessionReadings:
    """The same readings in two files, with runs of other names in the second."""
    measurement = sample.resolved().measurement
    paths = [tmp_path / "first.csv", tmp_path / "later.csv"]
    later = sample.READINGS.replace(",low,", ",low2,").replace(",high,", ",high2,")
    for path, text in zip(paths, (sample.READINGS, later), strict=True):
        path.write_text(text, encoding="utf-8")
    data = dataset.load(paths, measurement)
    return checks.session_readings(
        measurement, data.series, data.y, data.covariates, data.columns
    )


def test_a_row_of_several_files_is_named_with_its_file(tmp_path):
    session = of_two_files(tmp_path)
    rows = session.rows(range(6))
    assert [int(row) for row in rows] == [2, 3, 5, 2, 3, 5]
    assert len(set(rows)) == 6
    finding = sentences.doubled(session, [EqualReadings((0, 3), same_pose=True)])
    assert "rows 2 of first.csv and 2 of later.csv." in finding.sentence
    assert "row 3 of later.csv, column" in sentences._place(session, 4)


def test_rows_of_the_only_file_are_numbers():
    session = machines.session("a3", machines.readings("a3", 2))
    rows = session.rows([3, 4])
    assert all(isinstance(row, int) for row in rows)
    assert pd.api.types.is_integer_dtype(session.values["row"])


@pytest.mark.parametrize(("files", "names"), [
    (["a/one.csv", "b/two.csv"], ["one.csv", "two.csv"]),
    (["a/one.csv", "b/one.csv"], ["a/one.csv", "b/one.csv"]),
    (["a\\one.csv", "two.csv"], ["one.csv", "two.csv"]),
])  # fmt: skip
def test_files_go_by_their_names_where_these_differ(files, names):
    assert short_names(files) == names


@pytest.fixture(scope="module")
def session() -> SessionReadings:
    return machines.session("a3", machines.readings("a3", 2))


def test_nothing_is_explained_by_no_mistake():
    assert sentences.explained([]) == []
    assert sentences.no_fit().severity == Severity.BAD_FIT


def test_equal_readings_are_named_by_their_rows(session):
    group = EqualReadings((3, 4), same_pose=False)
    finding = sentences.doubled(session, [group])
    rows = session.values["row"].to_numpy()[[3, 4]]
    assert finding.rows == tuple(rows)
    assert f"rows {rows[0]} and {rows[1]}." in finding.sentence
    assert "at other poses" in finding.sentence


def test_a_step_is_in_the_unit_of_its_column(session):
    coarse = CoarseReadings("length", 1e-5, tuple(range(len(session))))
    sentence = sentences.coarse(session, coarse).sentence
    assert "readings of length_mm are multiples of 0.01:" in sentence


def test_a_value_outside_its_range_is_the_farthest(session, rng):
    ranges: Ranges = session.predict_ranges(rng)
    y = session.y.copy()
    y[4] += 20.0 * ranges.sd[4]
    y[9] -= 90.0 * ranges.sd[9]
    finding = sentences.outside(session.with_y(y), ranges, np.array([4, 9]))
    rows = session.values["row"].to_numpy()[[4, 9]]
    assert finding.rows == tuple(sorted(rows))
    assert finding.sentence.startswith("2 readings lie outside")
    assert f"row {rows[1]}, column length_mm = {1e3 * y[9]:.7g}" in finding.sentence
