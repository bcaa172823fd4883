"""Detectability and confusability before measuring: dense formulas, simulation."""

import dataclasses
import functools

import numpy as np
import pytest
from scipy import stats

from kernel import a3_plans, gap_a3
from kernel.gap_a3 import noise_columns
from kernel.laws import STATED_LAW, noise_law, residual_covariance
from oed.gap.before import choose, detect
from oed.gap.before.detect import RIVAL_SD, combination_words, needed_lambda

FIVE = (0.0, 0.05, 0.1, 0.15, 0.2)
ALL = [gap_a3.encoder_scale, gap_a3.bar_length, gap_a3.gravity]


@functools.cache
def problem(tools=(0.0,), strokes=FIVE, points=12):
    m = a3_plans.measurement(tools=tools)
    return choose.problem_of_runs(m, gap_a3.circles(m, strokes, points))[0]


def row(table, name):
    """The record of one effect."""
    return next(record for record in table.effects if record.name == name)


def pair(values, table, effect, rival):
    """The value of an effect (row) and a rival (column) in a matrix of the table."""
    return values[table.names.index(effect)][table.names.index(rival)]


def test_size_needed_for_90_percent_at_1_percent():
    assert [round(needed_lambda(k)) for k in (1, 2, 6, 12)] == [15, 17, 23, 29]


def test_size_needed_is_that_of_simulated_tests():
    rng, lam, k = np.random.default_rng(1), needed_lambda(6), 6
    draws = rng.standard_normal((40_000, k))
    draws[:, 0] += np.sqrt(lam)
    power = np.mean(np.sum(draws**2, axis=1) > stats.chi2.ppf(0.99, k))
    assert power == pytest.approx(0.90, abs=0.006)


@pytest.mark.parametrize("tools", [(0.0,), (0.0, 0.1)])
def test_lambdas_are_those_of_the_dense_covariance(tools):
    p = problem(tools, strokes=(0.0, 0.1, 0.2))
    law = noise_law(0.4, 0.7, 3.0, 1.4, level=1.3)
    detection = detect.detect(p, law, [*ALL, gap_a3.warming], np.random.default_rng(0))
    c = residual_covariance(p, law)
    for name in ("gravity", "encoder_scale"):
        g, _ = noise_columns(p, getattr(gap_a3, name))
        assert row(detection, name).detectability == pytest.approx(
            np.sqrt(np.trace(g.T @ np.linalg.solve(c, g))), rel=1e-6
        )
        # a rival that is as good as free has a very wide covariance of its own; a shape
        # column keeps its prior
        roots = []
        for tau in (900.0, 3600.0):
            r, rival = noise_columns(p, gap_a3.warming, tau=tau)
            wide = c + (r * np.where(rival.shape, 1.0, RIVAL_SD**2)) @ r.T
            roots.append(np.sqrt(np.trace(g.T @ np.linalg.solve(wide, g))))
        separation = pair(detection.separation, detection, name, "warming")

        assert separation == pytest.approx(min(roots), rel=1e-5)


def test_least_size_is_found_nine_times_in_ten():
    p, rng = problem(strokes=(0.0, 0.1, 0.2)), np.random.default_rng(5)
    record = detect.detect(p, STATED_LAW, [gap_a3.encoder_scale], rng).effects[0]
    g, scale = noise_columns(p, gap_a3.encoder_scale)
    c = residual_covariance(p, STATED_LAW)
    root = np.linalg.cholesky(c)
    inner = np.linalg.solve(root, g)
    change = (
        inner[:, 1] * record.sizes["leg 2"] / scale.scales[1]
    )  # leg 2 alone at its least size
    noise = rng.standard_normal((4000, len(p)))
    basis = np.linalg.qr(inner)[0]
    power = np.mean(
        np.sum(((noise + change) @ basis) ** 2, axis=1) > stats.chi2.ppf(0.99, 3)
    )
    assert power == pytest.approx(0.90, abs=0.02)
    assert record.least["length"] <= record.median["length"]
    # the most visible combination needs no more than leg 2 alone does
    change = 1e6 * p.sigma * g[:, 1] / scale.scales[1]
    alone = record.sizes["leg 2"] * np.sqrt(np.mean(change**2))
    assert record.least["length"] <= alone * (1 + 1e-9)


def free(p):
    """The same readings with parameters of (as good as) no prior."""
    return dataclasses.replace(p, slopes=p.slopes * 1e3)


def test_common_scale_and_bar_length_are_one_class_with_one_tool():
    p = free(problem(points=36))
    detection = detect.detect(p, STATED_LAW, ALL, np.random.default_rng(0))
    assert detection.exact == [["encoder_scale", "bar_length"]]
    scale = row(detection, "encoder_scale")
    bar = next(r for r in scale.rivals if r.name == "bar_length")
    assert bar.angle_deg == pytest.approx(0.0, abs=0.01)
    # it is the common scale that the bar imitates, and nothing else of the three legs
    (shared,) = bar.shared
    assert "common to leg 1, leg 2 and leg 3" in shared.words
    assert shared.detectability > 4.0
    assert shared.separation < 0.1
    assert bar.separation > 10.0
    # the other way round the bar is absorbed whole
    back = next(
        r for r in row(detection, "bar_length").rivals if r.name == "encoder_scale"
    )
    assert back.separation < 0.1


def test_two_tool_lengths_tell_scale_from_bar():
    p = free(problem((0.0, 0.1)))
    detection = detect.detect(p, STATED_LAW, ALL, np.random.default_rng(0))
    assert not detection.exact
    angle = pair(detection.angles_deg, detection, "encoder_scale", "bar_length")
    assert 3.5 <= angle <= 13.6


def test_classes_name_who_is_absorbed_by_whom():
    # joints measured to 20 um before: both are visible, and the bar is imitated by the
    # scale, not the other way
    p = problem()
    p = dataclasses.replace(p, slopes=p.slopes * 0.02)
    detection = detect.detect(p, STATED_LAW, ALL, np.random.default_rng(0))
    assert row(detection, "bar_length").visible
    assert row(detection, "encoder_scale").visible
    assert detection.classes == [["encoder_scale", "bar_length"]]
    assert detection.absorbed == [["bar_length", "encoder_scale"]]


def test_calibration_absorbs_most_of_static_gravity():
    p = problem(strokes=FIVE, points=24)
    detection = detect.detect(p, STATED_LAW, ALL, np.random.default_rng(0))
    g, _ = noise_columns(p, gap_a3.gravity)
    share = np.sqrt(
        np.trace(g.T @ np.linalg.solve(residual_covariance(p, STATED_LAW), g))
        / np.sum(g**2)
    )
    assert 1.0 - row(detection, "gravity").absorbed == pytest.approx(share, rel=1e-6)
    assert share < 0.12


def test_what_is_missing_is_told_and_nothing_is_claimed():
    p = problem(strokes=(0.0, 0.2))
    both = dataclasses.replace(
        gap_a3.gravity, name="both_ways", needs=("direction: both",)
    )
    detection = detect.detect(
        p, STATED_LAW, [both, gap_a3.encoder_scale], np.random.default_rng(0)
    )
    reason = "the readings do not have direction: both"
    assert row(detection, "both_ways").not_testable == reason
    assert row(detection, "encoder_scale").not_testable is None
    assert detection.names == ["encoder_scale"]
    assert not row(detection, "both_ways").visible
    unseen = dataclasses.replace(gap_a3.bar_length, columns=lambda s: [])
    detection = detect.detect(p, STATED_LAW, [unseen], np.random.default_rng(0))
    assert "changes none" in row(detection, "bar_length").not_testable
    assert detection.classes == []


def test_combinations_in_words():
    assert combination_words({"leg 1": 1.0, "leg 2": 0.98, "leg 3": 0.99}).startswith(
        "common to leg 1, leg 2"
    )
    assert (
        combination_words({"leg 1": 1.0, "leg 2": -0.9, "leg 3": 0.05})
        == "leg 1 - 0.9 leg 2"
    )
    assert combination_words({"bar": 1.0}) == "bar"


def test_same_seed_same_figures_and_bad_input():
    p = problem(strokes=(0.0, 0.2))
    one, two = (
        detect.detect(p, STATED_LAW, ALL, np.random.default_rng(4)) for _ in range(2)
    )
    assert one.effects == two.effects
    with pytest.raises(ValueError, match="each once"):
        detect.detect(
            p, STATED_LAW, [gap_a3.gravity, gap_a3.gravity], np.random.default_rng(0)
        )
