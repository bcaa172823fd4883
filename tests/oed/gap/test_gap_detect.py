"""Before measuring: what is detected and confused, and runs that tell effects apart."""

import dataclasses
import functools
import itertools

import numpy as np
import pytest
from scipy import stats

from kernel import a3_plans, gap_a3
from kernel.gap_a3 import noise_columns
from kernel.laws import STATED_LAW, noise_law, residual_covariance
from oed import design
from oed.design import Rules
from oed.gap.before import choose, detect
from oed.gap.before.choose import pool_runs
from oed.gap.before.detect import RIVAL_SD, combination_words, needed_lambda
from oed.gap.before.separation import Separation

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


WANTED = [gap_a3.gravity, gap_a3.encoder_scale]


@functools.cache
def laid_out(
    tools=(0.0, 0.1),
    strokes=(0.0, 0.05, 0.1, 0.15, 0.2),
    payloads=(0.0, 50.0),
    points=12,
):
    m = a3_plans.measurement(tools=tools)
    candidates = gap_a3.circles(m, strokes, points, payloads)
    return candidates, *choose.problem_of_runs(m, candidates)


@functools.cache
def pool(**layout):
    _, p, rows = laid_out(**layout)
    return pool_runs(p, STATED_LAW, rows, WANTED)


def least_lambda(separation: Separation, plan):
    return separation.lambdas(separation.of(plan)).min()


def dense(p, law, rows, target, rival):
    """lambda of a target (N,) beside a rival's columns (N, k) of a very wide prior."""
    c = residual_covariance(p, law) + RIVAL_SD**2 * rival @ rival.T
    return target[rows] @ np.linalg.solve(c[np.ix_(rows, rows)], target[rows])


def test_lambdas_of_a_plan_are_those_of_its_readings_covariance():
    _, p, rows = laid_out()
    law = noise_law(0.4, 0.7, 3.0, 1.3)
    candidates = pool_runs(p, law, rows, WANTED)
    plan = np.array([1, 6, 12, 17])
    at = np.concatenate([rows[k] for k in plan])
    g, _ = gap_a3.noise_columns(p, gap_a3.gravity)
    s, _ = gap_a3.noise_columns(p, gap_a3.encoder_scale)
    separations = {(t.effect, t.words): t.separation for t in candidates.pairs(plan)}
    assert separations["gravity", "legs"] ** 2 == pytest.approx(
        dense(p, law, at, g[:, 0], s), rel=1e-5
    )
    assert separations["encoder_scale", "leg 2"] ** 2 == pytest.approx(
        dense(p, law, at, s[:, 1], g), rel=1e-5
    )
    alike = next(
        v
        for (e, w), v in separations.items()
        if e == "encoder_scale" and w.startswith("common")
    )
    assert alike**2 == pytest.approx(dense(p, law, at, s.sum(axis=1), g), rel=1e-5)


def test_a_pool_has_a_direction_for_each_parameter_and_each_target():
    """As many as a plan of all runs determines: its parameters, and one a target."""
    candidates = pool()
    everything = candidates.of(np.arange(candidates.count))
    parameters = everything[: candidates.size, : candidates.size]
    determined = np.linalg.matrix_rank(parameters)
    targets = len(candidates.lambdas(everything))
    assert targets > 1
    assert candidates.directions == determined + targets


def test_gradient_and_curvature_are_those_of_differences_and_the_line_lies_above():
    objective = dataclasses.replace(pool(), share=0.3)
    rng = np.random.default_rng(0)
    active = np.arange(objective.count)
    w = rng.uniform(0.2, 1.0, objective.count)
    smooth = dataclasses.replace(objective, sharp=3.0)
    slopes, curvature = smooth.derivatives(active, w)
    for k in (0, 7, 15):
        step = 1e-5 * np.eye(objective.count)[k]
        up, down = smooth.value(active, w + step), smooth.value(active, w - step)
        assert slopes[k] == pytest.approx((up - down) / 2e-5, rel=1e-5)
        bent = (
            smooth.derivatives(active, w + step)[0]
            - smooth.derivatives(active, w - step)[0]
        ) / 2e-5
        np.testing.assert_allclose(
            -bent, curvature[k], rtol=1e-4, atol=1e-6 * np.abs(curvature).max()
        )
    line = objective.tangent(active, w)
    for _ in range(50):
        other = rng.uniform(0.0, 1.0, objective.count)
        assert (
            float(objective.worth(objective.at(active, other)))
            <= line.bound(float(other @ line.gradient)) + 1e-9
        )


@pytest.mark.parametrize("share", [0.0, 0.3])
def test_bounds_hold_for_every_plan_and_the_search_ends_near_the_best(
    share, monkeypatch
):
    monkeypatch.setattr(choose, "MAX_ENUMERATED", 0)
    candidates, size = pool(), 4
    choice = choose.choose(
        candidates, Rules(size=size), np.random.default_rng(0), share=share
    )
    everything = dataclasses.replace(candidates, share=share)
    plans = np.array(list(itertools.combinations(range(everything.count), size)))
    m = [
        everything.base + everything.grams[p].sum(axis=1)
        for p in np.array_split(plans, 60)
    ]
    values = (
        np.concatenate([everything.worth(x) for x in m])
        + share * candidates.log_scale / everything.size
    )
    least = np.concatenate([everything.lambdas(x).min(axis=0) for x in m]) ** 0.5
    assert choice.above >= values.max() - 1e-9
    assert choice.bound >= least.max() * (1 - 1e-9)
    assert choice.value >= values.max() - 0.05
    assert choice.bound <= 2.0 * least.max()


def test_payload_and_second_tool_tell_gravity_from_scale():
    """The published circles leave sqrt(lambda) of 1.2; four chosen ones 29 and more."""
    candidates, p, rows = laid_out(
        strokes=(0.0, 0.08, 0.14, 0.2), payloads=(0.0, 100.0), points=15
    )
    separation = pool_runs(
        p, STATED_LAW, rows, [gap_a3.gravity], [gap_a3.encoder_scale]
    )
    names = [(r.setup, r.name) for r in candidates]
    paper = np.array(
        [names.index(("cup", "80 mm, 0 N")), names.index(("cup", "200 mm, 0 N"))]
    )
    assert separation.pairs(paper)[0].separation < 2.0
    choice = choose.choose(separation, Rules(size=4), np.random.default_rng(0))
    assert choice.pairs[0].separation > 29.0
    assert len({candidates[k].condition["payload"] for k in choice.runs}) == 2
    # without the load as a factor four circles and a second tool do not
    idle = [k for k, r in enumerate(candidates) if not r.condition["payload"]]
    best = max(
        least_lambda(separation, np.array(c)) for c in itertools.combinations(idle, 4)
    )
    assert best**0.5 < 5.0


def test_share_one_is_the_d_optimal_choice_of_runs():
    _, p, rows = laid_out()
    blocks = np.array([p.slopes[r] for r in rows])
    d = design.choose(
        blocks, 4, np.random.default_rng(0), "D", prior=np.eye(blocks.shape[2])
    )
    choice = choose.choose(pool(), Rules(size=4), np.random.default_rng(0), share=1.0)
    assert choice.volume == pytest.approx(d.value, abs=1e-6)
    # and telling effects apart costs volume
    assert (
        choose.choose(pool(), Rules(size=4), np.random.default_rng(0), share=0.0).volume
        <= d.value + 1e-9
    )


def test_budget_pays_runs_and_mounting():
    candidates = laid_out()[0]
    tool = np.array([0 if r.setup == "cup" else 1 for r in candidates])
    cost = np.array([r.seconds for r in candidates])
    rules = Rules.build(
        seconds=cost, budget=1900.0, setup=tool, mounting=np.array([900.0, 900.0])
    )
    choice = choose.choose(pool(), rules, np.random.default_rng(0), rounds=3)
    # 1900 s do not pay for two set-ups and a run, but for one and eight runs
    assert len({candidates[k].setup for k in choice.runs}) == 1
    assert len(choice.runs) == 8
    assert choice.seconds == pytest.approx(1860.0)
    assert choice.above >= choice.value - 1e-9


def test_runs_kept_are_part_of_every_plan():
    fixed = np.array([0, 10])
    choice = choose.choose(pool(), Rules(size=2), np.random.default_rng(0), fixed=fixed)
    assert set(fixed) <= set(choice.runs)
    assert len(choice.runs) == 4
    every = [
        least_lambda(pool(), np.append(fixed, c))
        for c in itertools.combinations(sorted(set(range(20)) - {0, 10}), 2)
    ]
    assert choice.bound == pytest.approx(max(every) ** 0.5)
    assert choice.efficiency == pytest.approx(1.0)


def test_runs_are_laid_out_in_order_and_direction():
    m = laid_out()[1].measurement
    command = a3_plans.bar_commands(m, np.full(4, 0.1), np.arange(4) * 1.0, "cup")
    shared = {"setup": "cup", "command": command}
    condition = {"direction": 1.0, "time": 10.0}
    there = choose.Run(name="a", condition=condition, seconds=40.0, **shared)
    back = choose.Run(
        name="b", condition={"direction": -1.0, "payload": 50.0}, **shared
    )
    series, covariates = choose.lay_out(m, [there, back])
    np.testing.assert_allclose(series[0].reading_commands()[4:], command[::-1])
    assert covariates["time"].tolist()[:4] == [10.0, 20.0, 30.0, 40.0]
    assert covariates["time"].isna().sum() == 4
    assert covariates["order"].tolist() == [0, 1, 2, 3] * 2
    assert covariates["payload"].tolist()[4:] == [50.0] * 4


def test_bad_input_is_refused_with_a_remedy():
    _, p, rows = laid_out()
    command = np.zeros((3, 3))
    with pytest.raises(ValueError, match="no condition \\['load'\\]; there are"):
        choose.Run(name="a", setup="cup", command=command, condition={"load": 1.0})
    with pytest.raises(ValueError, match="direction is \\+1 or -1, not 2"):
        choose.Run(name="a", setup="cup", command=command, condition={"direction": 2.0})
    with pytest.raises(ValueError, match="used twice"):
        choose.lay_out(
            p.measurement, [choose.Run(name="a", setup="cup", command=command)] * 2
        )
    with pytest.raises(ValueError, match="nothing to tell apart"):
        pool_runs(p, STATED_LAW, rows, [gap_a3.gravity])
    with pytest.raises(ValueError, match="cannot choose 40 different runs out of 20"):
        choose.choose(pool(), Rules(size=40), np.random.default_rng(0))
    with pytest.raises(ValueError, match="share of D"):
        choose.choose(pool(), Rules(size=4), np.random.default_rng(0), share=1.5)
