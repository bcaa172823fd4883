"""What is stated of the noise, against a covariance written out reading by reading."""

import dataclasses

import numpy as np
import pandas as pd
import pytest
from oracles import a3_geometry as a3
from reference import tian_2016 as paper
from scipy import linalg, stats

from kernel import a3_plans
from kernel.laws import dense_covariance, law_covariance, noise_law
from oed.accuracy import BudgetModel
from oed.design import Candidates
from oed.estimation import identify
from oed.gap import assemble
from oed.gap.data import evidence as gap_laws
from oed.measurement import Measurement, Series, draw_errors, reading_structure
from oed.noise import NOTHING_STATED, Laws, Noise, NoiseLaw, NoiseStatement
from oed.noise_law import KNOWN_TO, NoisePrior, detect_outliers

SIGMA, SEATING, SHARE, REACH, RUN = 0.5e-6, 0.8e-6, 0.4, 3.0, 0.7e-6
STATED = NoiseStatement(seating=SEATING, correlated=SHARE, reach=REACH)
ONES = Noise(np.ones(60))  #: independent errors of unit size
NOTHING_ELSE = NoiseStatement(
    levels=frozenset({"length"}),
    seating=0.0,
    correlated=0.0,
    outlier_share=0.0,
    has_course=False,
)


@pytest.mark.parametrize("factor", [0.1, 1.0, 10.0])
def test_an_assumed_noise_has_one_scale_that_follows_the_readings(factor):
    """Within a decade, whatever was assumed; weights stay near the assumed ones."""
    statement = dataclasses.replace(NOTHING_ELSE, is_assumed=True)
    m = stating(statement)
    series = circles(m)
    rng = np.random.default_rng(6)
    y = m.readings([series], m.nominal) + factor * SIGMA * rng.standard_normal(24)
    estimate = identify(m, [series], y, estimate_noise=True)
    posterior = estimate.noise_posterior
    assert posterior.prior.names == ("noise of all readings",)
    assert posterior.prior.is_common
    scale = posterior.prior.laws(posterior.draws).scale
    # some ten degrees of freedom: two standard deviations of a scale
    assert posterior.weights @ scale[:, 0] == pytest.approx(factor, rel=0.45)
    names = ("noise of all readings", "noise of a", "noise of b")
    two = NoisePrior(names, 2, statement=statement, is_common=True)
    scales = two.laws(np.array([[-1.0, 0, 0], [1.0, 0, 0], [0.0, -1.0, 0.0]])).scale
    expected = [[0.1, 0.1], [10.0, 10.0], [KNOWN_TO ** (-17 / 16), 1.0]]
    assert scales == pytest.approx(np.array(expected))


def stating(statement: NoiseStatement, run: float = 0.0) -> Measurement:
    """The head with a bar of which something is stated."""
    m = a3_plans.measurement()
    setup = m.setups["cup"]
    channel = dataclasses.replace(setup.instrument.channels[0], shared=run / SIGMA)
    instrument = dataclasses.replace(setup.instrument, channels=(channel,))
    changed = dataclasses.replace(setup, instrument=instrument, statement=statement)
    return m.with_setups([changed])


def circles(m: Measurement) -> Series:
    """Three circles of eight readings, each a run."""
    plan = a3_plans.circles(m, 8, strokes=(0.05, 0.1, 0.2)).reading_commands()
    return m.series("cup", plan, [f"circle {k // 8}" for k in range(24)])


def expected(series: Series, run: float = 0.0) -> np.ndarray:
    """Covariance (24, 24), SI, of the oracle's cup and what STATED says."""
    cup = np.array([0.0, 0.0, paper.TEACH_Z])
    over_cup = a3.bar_rows(*series.reading_commands().T, cup)[:, 24:]
    total = np.zeros((24, 24))
    for i in range(24):
        for j in range(24):
            if series.run[i] == series.run[j]:
                carried = SHARE * np.exp(-abs(i - j) / REACH)
                alone = 1.0 - SHARE if i == j else 0.0
                total[i, j] = SIGMA**2 * (alone + carried) + run**2
                total[i, j] += SEATING**2 * over_cup[i] @ over_cup[j]
    return total


@pytest.mark.parametrize("run", [0.0, RUN])
def test_the_stated_covariance_holds_what_is_stated(run):
    levels = frozenset({"length"}) if run else frozenset()
    m = stating(dataclasses.replace(STATED, levels=levels), run)
    series = circles(m)
    exact = expected(series, run)
    noise = m.noise([series])
    covariance = np.linalg.inv(noise.precision(np.eye(24)))
    assert covariance == pytest.approx(exact, rel=1e-9, abs=1e-9 * SIGMA**2)
    assert noise.sigma == pytest.approx(np.sqrt(np.diag(exact)))
    structure = reading_structure(m, [series], m.nominal)
    law = Laws.stated(structure)
    process = SIGMA**2 * dense_covariance(structure, law)
    assert process == pytest.approx(exact, rel=1e-9, abs=1e-9 * SIGMA**2)
    y = np.random.default_rng(0).standard_normal((24, 2))
    gram = law.whitening(structure).gram(structure.standardise(y))[0]
    assert gram == pytest.approx(y.T @ np.linalg.solve(exact, y), rel=1e-9)
    of_budget = BudgetModel.of(m, [series], m.nominal).readings
    whole = of_budget.weigh(exact / SIGMA**2, {})
    assert whole == pytest.approx(np.eye(24), abs=1e-8)


@pytest.mark.parametrize("run", [0.0, RUN])
def test_the_stated_noise_is_that_of_its_covariance(run):
    """Of two series, one times a factor: every product against the dense covariance."""
    levels = frozenset({"length"}) if run else frozenset()
    m = stating(dataclasses.replace(STATED, levels=levels), run)
    series, rng = circles(m), np.random.default_rng(4)
    one = expected(series, run)
    exact = linalg.block_diag(one, one)
    wider = exact * 1.7**2
    noise, values = m.noise([series, series]), rng.standard_normal((48, 2))
    for other, covariance in ((noise, exact), (noise.scaled(1.7), wider)):
        inverse, root = np.linalg.inv(covariance), np.linalg.cholesky(covariance)
        assert other.sigma == pytest.approx(np.sqrt(np.diag(covariance)))
        assert other.precision(values) == pytest.approx(inverse @ values)
        assert other.precision_diagonal() == pytest.approx(np.diag(inverse))
        white = other.whiten(values)
        assert white.T @ white == pytest.approx(values.T @ inverse @ values)
        assert other.whiten_last(values.T) == pytest.approx(white.T)
        errors = other.draw(np.random.default_rng(1), (3, 48))
        normal = np.random.default_rng(1).standard_normal((3, 48))
        assert errors == pytest.approx(normal @ root.T, rel=1e-9, abs=1e-9 * SIGMA)


def test_series_with_and_without_related_readings_stand_together():
    m = stating(dataclasses.replace(STATED, levels=frozenset({"length"})), RUN)
    related, alone = circles(m).setup, "alone"
    setup = dataclasses.replace(a3_plans.measurement().setups[related], name=alone)
    both = m.with_setups([m.setups[related], setup])
    series = [circles(both), dataclasses.replace(circles(both), setup=alone)]
    parts = [both.noise([one]) for one in series]
    whole = both.noise(series)
    values = np.random.default_rng(2).standard_normal((48, 2))
    assert parts[1].is_independent
    white = np.random.default_rng(1).standard_normal(24)
    drawn = parts[1].draw(np.random.default_rng(1), (24,))
    assert drawn == pytest.approx(SIGMA * white)
    expected_parts = [
        n.precision(v) for n, v in zip(parts, np.split(values, 2), strict=True)
    ]
    assert whole.precision(values) == pytest.approx(np.concatenate(expected_parts))
    assert whole.sigma == pytest.approx(np.concatenate([n.sigma for n in parts]))


def test_designs_take_the_seating_as_unknowns_of_each_run():
    m = stating(dataclasses.replace(NOTHING_STATED, seating=SEATING))
    series = circles(m)
    chosen = Candidates.build(m, [series], m.nominal, "tolerance")
    rows = chosen.blocks.reshape(24, -1)
    total = rows.T @ rows + chosen.prior_information
    n = chosen.columns
    inner = total[:n, :n] - total[:n, n:] @ np.linalg.solve(
        total[n:, n:], total[n:, :n]
    )
    exact = expected(series) - SIGMA**2 * np.where(
        series.run[:, None] == series.run,
        SHARE * np.exp(-np.abs(np.subtract.outer(range(24), range(24))) / REACH),
        0.0,
    )
    exact += SHARE * SIGMA**2 * np.eye(24)
    h = (m.jacobian([series], m.nominal) * m.tolerance)[:, m.free]
    information = h.T @ np.linalg.solve(exact, h)
    scale = np.abs(information).max()
    assert inner == pytest.approx(information, rel=1e-6, abs=1e-8 * scale)


def law_coordinates(statement: NoiseStatement, run: float = 0.0) -> NoisePrior:
    m = stating(statement, run)
    return NoisePrior.of(reading_structure(m, [circles(m)], m.nominal))


def test_what_is_stated_narrows_the_prior_and_nought_takes_it_out():
    wide = law_coordinates(NOTHING_STATED)
    assert wide.names == (
        "noise of cup.length", NoisePrior.CORRELATED, NoisePrior.REACH, NoisePrior.RUN, NoisePrior.SEAT,
        NoisePrior.COURSE,
    )  # fmt: skip
    assert law_coordinates(NOTHING_ELSE).names == ("noise of cup.length",)
    levels = frozenset({"length"})
    stated = law_coordinates(dataclasses.replace(STATED, levels=levels), RUN)
    assert stated.names[1:] == (
        NoisePrior.CORRELATED, NoisePrior.REACH, NoisePrior.STATED_RUN, NoisePrior.STATED_SEATING,
        NoisePrior.COURSE,
    )  # fmt: skip
    rng = np.random.default_rng(1)
    drawn = stated.laws(rng.standard_normal((20_000, stated.dimensions)))
    before = wide.laws(rng.standard_normal((20_000, wide.dimensions)))
    assert np.median(drawn.correlated) == pytest.approx(SHARE, abs=0.01)
    assert drawn.correlated.std() < 0.6 * before.correlated.std()
    assert np.median(drawn.reach) == pytest.approx(REACH, rel=0.02)
    assert np.log(drawn.reach).std() < 0.5 * np.log(before.reach).std()
    for factor in (drawn.stated_level, drawn.stated_seat):
        assert np.median(factor) == pytest.approx(1.0, rel=0.02)
        assert np.log(factor).std() < 0.5 * np.log(before.level).std()
    assert not drawn.level.any()
    assert not drawn.seat.any()


def test_set_ups_state_one_law():
    m = a3_plans.measurement(tools=(0.0, 0.1))
    first, second = m.setups.values()
    other = dataclasses.replace(second, statement=NoiseStatement(correlated=0.2))
    m = m.with_setups([first, other])
    series = [a3_plans.circles(m, 4, name) for name in m.setups]
    with pytest.raises(ValueError, match="same carried share"):
        reading_structure(m, series, m.nominal)


@pytest.mark.parametrize("dof", [3.0, 5.0])
def test_stated_tails_are_drawn(dof):
    m = stating(NoiseStatement(student_dof=dof))
    series = circles(m)
    rng = np.random.default_rng(4)
    e = draw_errors(m, [series], rng, (2000, 24)).ravel() / SIGMA
    unit = np.sqrt((dof - 2.0) / dof)
    assert stats.kstest(e / unit, stats.t(dof).cdf).pvalue > 1e-3
    structure = reading_structure(m, [series], m.nominal)
    whitening = Laws.stated(structure, 2000).whitening(structure)
    e = whitening.draw(rng, structure.statement, estimated=True).ravel()
    # in units of the pseudo-values' scatter, whose square is 1 / I
    unit = np.sqrt((dof + 1.0) / (dof + 3.0))
    assert stats.kstest(e / unit, stats.t(dof).cdf).pvalue > 1e-3
    m = stating(NoiseStatement(outlier_share=0.1))
    e = draw_errors(m, [series], rng, (2000, 24)).ravel() / SIGMA
    beyond = np.mean(np.abs(e) > 4.5)
    assert beyond == pytest.approx(0.1, abs=4.0 * np.sqrt(0.1 * 0.9 / e.size) + 0.003)


def test_stated_tails_go_before_those_that_are_tried():
    residual = np.random.default_rng(5).standard_normal(60)
    residual[17] += 50.0
    assert detect_outliers(residual, ONES, statement=NOTHING_ELSE) is None
    share = detect_outliers(
        residual, ONES, statement=NoiseStatement(outlier_share=0.02)
    )
    assert share.density.outlier_share == 0.02
    assert int(np.argmax(np.abs(share.pseudo_residual - residual))) == 17
    student = detect_outliers(residual, ONES, statement=NoiseStatement(student_dof=3.0))
    assert student.density.dof == 3.0
    assert student.has_converged
    light = detect_outliers(residual[:17], Noise(np.ones(17)))
    assert light is None


def test_a_diagnosis_has_the_prior_of_an_identification():
    """With all stated, laws are about the stated covariance, up to a common factor."""
    statement = dataclasses.replace(
        STATED, levels=frozenset({"length"}), outlier_share=0.0
    )
    m = stating(statement, RUN)
    series = circles(m)
    rows = {"setup": "cup", "run": series.run, "order": np.tile(np.arange(8), 3)}
    problem = assemble(m, [series], pd.DataFrame(rows))
    law = gap_laws.posterior(problem, problem.slopes[:, :0])
    structure = reading_structure(m, [series], m.nominal)
    assert (
        law.draws.shape[1]
        == NoisePrior.of(structure).without(NoisePrior.COURSE).dimensions - 1
    )
    middle = NoiseLaw(gap_laws._laws(problem, np.zeros((1, 4))))
    for members in problem.members:
        sigma = problem.sigma[members]
        block = law_covariance(middle, problem, members) * np.outer(sigma, sigma)
        exact = expected(series, RUN)[np.ix_(members, members)]
        assert block == pytest.approx(exact, rel=1e-9)
    assert len(gap_laws.mixture(problem, [law])) == gap_laws.DRAWS_OF_EACH


def test_a_diagnosis_without_statement_has_all_parts():
    m = a3_plans.measurement()
    series = circles(m)
    rows = {"setup": "cup", "run": series.run, "order": np.tile(np.arange(8), 3)}
    problem = assemble(m, [series], pd.DataFrame(rows))
    law = gap_laws.posterior(problem, problem.slopes[:, :0])
    assert law.draws.shape[1] == 4


def test_a_law_in_words_names_each_part_that_is_large():
    law = noise_law(level=2.0, seat_sd=0.8)
    assert [words for words in law.describe() if "seats anew" in words] == [
        "what a run seats anew, such as a cup on its magnet, repeats to 1.6 times the"
        " stated noise"
    ]
    assert len(law.describe()) == 2
    assert len(noise_law(level=2.0, seat_sd=0.1).describe()) == 1
