"""Roots, products, folds, kernels and expansions of a diagnosis, against dense matrices."""

import dataclasses
import functools
import itertools
import tracemalloc

import numpy as np
import pytest

from kernel import gap_lines, gap_problem
from kernel import gap_problem as case
from kernel.gap_lines import BOW, EFFECTS, planted, readings, search_of, white_lines
from kernel.laws import STATED_LAW, noise_covariance, residual_covariance
from oed.effect_model import Column, Effect, State
from oed.gap.before.detect import RIVAL_SD, Form, RemainingForms, visible_root
from oed.gap.cause import closure
from oed.gap.cause.closure import N_FOLDS, Paths
from oed.gap.cause.compare import compare, compare_expanded
from oed.gap.cause.search import Search, energies
from oed.gap.cause.searches import WIDE_RMS, wide_model
from oed.gap.data import evidence
from oed.gap.data.columns import Block, Columns
from oed.gap.data.linearisation import ActingEffectForm, settle
from oed.gap.data.problem import GapProblem, Metric, Signature
from oed.gap.forms import discrepancy, library, waves
from oed.gap.forms import library as libraries
from oed.gap.procedure import explain


def test_a_root_leaves_out_what_readings_do_not_show(rng):
    columns = rng.standard_normal((20, 3)) * np.array([10.0, 1.0, 1e-4])
    gram = columns.T @ columns
    whole = visible_root(gram[:2, :2])
    np.testing.assert_allclose(whole @ whole.T, np.linalg.inv(gram[:2, :2]), rtol=1e-6)
    part = visible_root(gram)
    assert part.shape == (3, 2)
    values, vectors = np.linalg.eigh(gram)
    wanted = (vectors[:, 1:] / values[1:]) @ vectors[:, 1:].T
    np.testing.assert_allclose(part @ part.T, wanted, rtol=1e-8, atol=1e-12)


def forms_of(effect: str, first: int, counts: list[int]) -> list[Form]:
    """Forms of an effect, their columns from a number on; one of each adapts the form."""
    forms = []
    for count in counts:
        shape = np.arange(count) == count - 1
        none = np.zeros((0, count))
        names = tuple(map(str, range(count)))
        of_form = Signature(effect, {}, none, names, names, np.ones(count), shape, 1.0)
        precision = np.where(shape, 1.0, RIVAL_SD**-2)
        at = np.arange(first, first + count)
        forms.append(Form(effect, at, precision, of_form))
        first += count
    return forms


def test_forms_of_two_effects_are_separated_pair_by_pair(rng):
    """By each pair's dense formula, without the 2,559 x 2,559 products (52 MB)."""
    counts = [[8, 9] * 150, [3, 4, 2]]
    columns = rng.standard_normal((30, sum(map(sum, counts))))
    one = forms_of("one", 0, counts[0])
    other = forms_of("other", sum(counts[0]), counts[1])
    tracemalloc.start()
    left, rival = RemainingForms(one, columns), RemainingForms(other, columns)
    traces, back = left.traces_left_by(rival), rival.traces_left_by(left)
    angles = left.smallest_angle(rival), rival.smallest_angle(left)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 20e6
    for (i, a), (j, b) in itertools.product(enumerate(one[:9]), enumerate(other)):
        for form, by, trace in ((a, b, traces[i, j]), (b, a, back[j, i])):
            r, s = columns[:, form.at], columns[:, by.at]
            inner = s.T @ s + np.diag(by.precision)
            whole = r.T @ r - r.T @ s @ np.linalg.solve(inner, s.T @ r)
            assert trace == pytest.approx(np.trace(whole), rel=1e-10)
    bases = [
        [np.linalg.qr(columns[:, f.at[:-1]])[0] for f in fs] for fs in (one, other)
    ]
    cosines = [np.linalg.norm(a.T @ b, 2) for a, b in itertools.product(*bases)]
    smallest = np.rad2deg(np.arccos(max(cosines)))
    assert angles == pytest.approx((smallest, smallest), rel=1e-9)


def test_products_are_those_in_the_dense_metric(rng, monkeypatch):
    problem = case.circles(8)
    problem = problem.with_residual(rng.standard_normal(len(problem)))
    law = dataclasses.replace(case.law(problem), level=1.0)
    metric = np.linalg.inv(case.dense(problem, law))
    values = rng.standard_normal((len(problem), 2, 3))
    weights = rng.standard_normal((2, len(problem), 2))
    forms = Columns(len(problem), [Block(w, values) for w in weights])
    dense = np.hstack([np.einsum("nj,njk->nk", w, values) for w in weights])
    np.testing.assert_allclose(forms.all(), dense)
    some = Columns(len(problem), forms.some(np.array([5, 1, 2]), 2.0))
    np.testing.assert_allclose(some.all(slice(3, 9)), 2.0 * dense[3:9, [5, 1, 2]])
    monkeypatch.setattr(evidence, "VALUES_AT_ONCE", 2 * len(problem))
    needed, known = np.array([0, 4, 2]), Metric(problem, law)
    b = dense.T @ metric @ problem.residual
    gram = dense.T @ metric @ dense
    grams = evidence.grams_of(problem, known, forms, needed)
    np.testing.assert_allclose(grams.gram, gram[np.ix_(needed, needed)], rtol=1e-7)
    np.testing.assert_allclose(grams.b, b[needed], atol=1e-9)
    cross = forms.products(known.precision(dense[:, [2]]))
    np.testing.assert_allclose(cross, gram[[2]], rtol=1e-7, atol=1e-9)
    choices = [np.array(choice) for choice in ([2, 0], [5, 1, 3], [3, 1], [4], [1, 4])]
    products = evidence.ChoiceGrams(problem, known, forms, choices)
    for choice, block in zip(choices, products.grams, strict=True):
        np.testing.assert_allclose(block, gram[np.ix_(choice, choice)], rtol=1e-7)
    np.testing.assert_allclose(products.b, b, atol=1e-9)
    np.testing.assert_allclose(products.diagonal, gram.diagonal(), rtol=1e-7)
    energy = energies(products.diagonal, [np.array([0, 1])])[0]
    assert energy == pytest.approx(gram[0, 0] + gram[1, 1])


def test_repeats_are_of_one_fold_and_a_path_is_cut_in_fifths():
    problem = case.circles(20, (1.10, 1.16), 2)
    paths = Paths(problem)
    height = problem.series[0].reading_commands()[:, 0]
    groups = paths.groups()
    assert sorted(len(group) for group in groups) == [4, 4]
    fold, unit = paths.whole()
    for number in np.unique(fold):
        assert len(np.unique(height[fold == number])) == 1
    fold, unit = paths.within()
    assert np.unique(fold).size == N_FOLDS
    psi = problem.series[0].reading_commands()[:, 1]
    for number in range(N_FOLDS):
        assert len(np.unique(psi[fold == number].round(9))) == 20 // N_FOLDS
    assert np.unique(unit).size == N_FOLDS * 8


def test_held_out_readings_are_those_of_a_ridge_without_them(rng):
    h, r = 2.0 * rng.standard_normal((30, 5)), rng.standard_normal(30)
    information = np.eye(5) + h.T @ h, h.T @ r
    held, rest = np.arange(30) < 8, np.arange(30) >= 8
    white = np.column_stack([h, r])[held]
    mean, log_evidence = closure.learn(information, white)
    precision = np.eye(5) + h[rest].T @ h[rest]
    wanted = np.linalg.solve(precision, h[rest].T @ r[rest])
    np.testing.assert_allclose(mean, wanted, atol=1e-10)
    log_det = np.linalg.slogdet(precision)[1]
    assert log_evidence == pytest.approx(
        0.5 * wanted @ precision @ wanted - 0.5 * log_det
    )
    # the first three are parameters, the others effects
    before, after = closure.standardise(information, 3, white, r[held])
    p = h[:, :3]
    of_rest = np.eye(3) + p[rest].T @ p[rest]
    error = r[held] - p[held] @ np.linalg.solve(of_rest, p[rest].T @ r[rest])
    spread = np.eye(8) + p[held] @ np.linalg.solve(of_rest, p[held].T)
    assert before @ before == pytest.approx(error @ np.linalg.solve(spread, error))
    wanted_after = r[held] @ np.linalg.solve(spread, r[held])
    assert after @ after == pytest.approx(wanted_after)


def test_the_wide_model_has_every_effect_at_one_size():
    problem = gap_lines.readings(1)
    forms = library.build(problem, gap_lines.EFFECTS)
    processes = discrepancy.build(problem)
    columns = wide_model(problem, forms, processes)
    assert len(columns) == len(problem)
    broad = [e for e in processes.effects if e != discrepancy.IN_A_RUN]
    effects = len(forms.effects) + len(broad)
    energy = ((columns**2).sum() - (problem.slopes**2).sum()) / len(columns)
    assert energy == pytest.approx(effects * WIDE_RMS**2)


@pytest.mark.parametrize("reach", [0.3, 1.0])
def test_modes_have_the_kernel(reach):
    places = np.random.default_rng(4).integers(-99, 99, (30, 2, 2)) / 100.0
    modes = discrepancy.modes(places, reach, 60)
    flat = places.reshape(-1, 2)
    distance = np.linalg.norm(flat[:, None] - flat, axis=-1)
    factor = modes.reshape(len(flat), -1)
    scaled = np.sqrt(3.0) * distance / reach  # Matern's correlation of order 3/2
    remainder = (1.0 + scaled) * np.exp(-scaled) - factor @ factor.T
    assert np.linalg.eigvalsh(remainder).min() > -1e-9
    assert np.trace(remainder) <= (1.0 - discrepancy.VARIANCE_SHARE) * len(flat) + 1e-9
    few = discrepancy.modes(places, reach, 5)
    np.testing.assert_allclose(few, modes[:, :, :5])


@pytest.mark.parametrize("problem", [readings(3), gap_problem.circles(passes=2)])
def test_forms_of_a_kind_share_its_prior(problem):
    library = discrepancy.build(problem)
    assert np.isfinite(library.columns.all()).all()
    for kind in library.effects:
        shares = [np.exp(library.atoms[k].log_weight) for k in library.atoms_of(kind)]
        assert sum(shares) == pytest.approx(1.0)


def test_kinds_come_under_the_conditions_of_listed_effects():
    """Of five effects three need nothing, one the time; the last cannot be tested."""
    problem = readings(3)
    named = ("", "", "", "time: 3 or temp_leg", "payload")
    needs = [(need,) if need else () for need in named]
    effects = [
        dataclasses.replace(BOW, name=f"bow {k}", needs=n) for k, n in enumerate(needs)
    ]
    listed = libraries.build(problem, effects)
    terms = discrepancy.build(problem)
    logs = discrepancy.log_shares(terms, listed)
    shares = {a.effect: np.exp(p) for a, p in zip(terms.atoms, logs, strict=True)}
    counts = {"over the workspace": 4, "over time": 2}
    total = len(shares) + 4
    assert sum(shares.values()) == pytest.approx(1.0)
    for kind, share in shares.items():
        assert share == pytest.approx(counts.get(kind, 1) / total)


def test_units_of_length_change_nothing():
    """Readings, noise and slopes in millimetres, as of a machine 1000 times as large."""
    problem = readings(3)
    scaled = dataclasses.replace(problem, sigma=1e3 * problem.sigma)
    for form in (discrepancy.build(problem), discrepancy.build(scaled)):
        sizes = np.linalg.norm(form.columns.all(), axis=0)
        assert 0.01 < np.median(sizes) / np.sqrt(len(problem)) < 1.0
    one, other = (discrepancy.build(p).columns.all() for p in (scaled, problem))
    np.testing.assert_allclose(one, other, atol=1e-12)


def test_what_was_not_recorded_or_did_not_change_is_no_term():
    problem = readings(3)
    kinds = set(discrepancy.build(problem).effects)
    assert {"over time", "with the direction", "with the feed"} <= kinds
    assert "with the payload" not in kinds
    unknown = np.full(len(problem.states[0]), np.nan)
    states = tuple(dataclasses.replace(s, feed=unknown) for s in problem.states)
    less = dataclasses.replace(problem, states=states)
    assert set(discrepancy.build(less).effects) == kinds - {"with the feed"}


def test_a_joint_or_a_set_up_may_err_alone():
    library = discrepancy.build(readings(3))
    alone = {
        frozenset(library.labels[c] for c in atom.columns)
        for atom in library.atoms
        if atom.effect == "over time"
    }
    assert frozenset({"leg 2"}) in alone
    assert frozenset({"channel dy in lines"}) in alone
    assert frozenset({"leg 1", "leg 2"}) in alone


FORM = ActingEffectForm(BOW, {"turns": 3.0}, ("leg 1", "leg 2"), 3.0)


@functools.cache
def bowed() -> GapProblem:
    """Lines of a machine whose first leg is bowed by four expected sizes."""
    return planted(white_lines(), BOW, {"leg 1": 4.0}, turns=3.0)


def test_small_effects_settle_at_the_linear_estimate():
    """In expected sizes: the mean of coefficients of prior N(0, 1) times the form's."""
    problem = bowed()
    law, none = STATED_LAW, np.zeros(len(problem))
    settled = settle(problem, [FORM], law, none)
    signature = problem.signature(BOW, FORM.constants)
    rows = [signature.names.index(name) for name in FORM.names]
    columns = FORM.size * problem.noise_units(signature.columns[:, rows])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(2)
    exact = FORM.size * np.linalg.solve(precision, weighed.T @ problem.residual)
    assert settled.coefficients == pytest.approx(exact, abs=0.02)
    assert settled.coefficients[0] == pytest.approx(4.0, abs=0.5)
    assert settled.departure < 0.3
    assert settled.problem.residual == pytest.approx(problem.residual, abs=0.3)


@functools.cache
def searched() -> Search:
    return search_of(bowed())


def test_small_effects_ask_for_no_other_point():
    comparison = compare_expanded(bowed(), EFFECTS, lambda p: [search_of(p)])
    assert len(comparison.searches) == 1
    plain = compare([searched()])
    assert [h.key for h in comparison.hypotheses] == [h.key for h in plain]
    assert comparison.hypotheses[0].effects == ("bow",)


def test_parts_of_the_residual_are_the_dense_estimates():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    parts, sigma = explain(problem, search, best, {"bow"}), problem.sigma
    columns = search.library.scaled_columns(best.atoms[0], best.sizes[0])
    weighed = np.linalg.solve(residual_covariance(problem, STATED_LAW), columns)
    precision = columns.T @ weighed + np.eye(columns.shape[1])
    mean = np.linalg.solve(precision, weighed.T @ problem.residual)
    explained = parts.explained / sigma
    assert explained == pytest.approx(columns @ mean, abs=1e-6)
    assert parts.unexplained == pytest.approx(0.0, abs=1e-9)
    noise = noise_covariance(problem, STATED_LAW)
    # what parameters leave of r is R (R + H H^T)^-1 r
    left = noise @ np.linalg.inv(residual_covariance(problem, STATED_LAW))
    assert parts.before / sigma == pytest.approx(left @ problem.residual, abs=1e-6)
    corrected = problem.residual - columns @ mean
    assert parts.after / sigma == pytest.approx(left @ corrected, abs=1e-6)
    (size,) = parts.sizes
    energy = explained @ np.linalg.solve(
        residual_covariance(problem, STATED_LAW), explained
    )
    level = search.noise_level(best)
    assert size.detectability == pytest.approx(np.sqrt(energy) / level)
    channel = problem.rows["channel"].to_numpy()
    for name, rms in size.rms.items():
        values = parts.explained[channel == name]
        assert rms == pytest.approx(np.sqrt(np.mean(values**2)))


def test_effects_that_are_not_named_count_as_unknown():
    problem, search = bowed(), searched()
    best = next(h for h in compare([search]) if h.key == (frozenset({"bow"}), False))
    named, unnamed = (explain(problem, search, best, n) for n in ({"bow"}, set()))
    assert unnamed.coefficients == ()
    assert unnamed.explained == pytest.approx(0.0)
    assert unnamed.unexplained == pytest.approx(named.explained)


PERIOD, SIZE = 700.0, 1e-6


def _problem(name: str) -> GapProblem:
    """Lines read against their own beginning, or circles of a ball bar."""
    return readings(1) if name == "lines" else case.circles()


def _hum(state: State) -> list[Column]:
    wave = np.sin(2.0 * np.pi * state.time / PERIOD)
    moved = {f"leg {i + 1}": {i: wave} for i in state.limbs}
    moved |= {f"tool {k}": state.displacing_joints(k, wave) for k in range(3)}
    moved["longer"] = {i: state.joints_per_extension[:, i] * wave for i in state.limbs}
    return [Column(name, SIZE, joints=joints) for name, joints in moved.items()]


@pytest.mark.parametrize("name", ["lines", "circles"])
def test_a_wave_on_a_joint_or_the_tool_is_what_an_effect_of_it_would_read(name):
    """At the pose read and at what it is read against, each at its own time."""
    problem = _problem(name)
    effect = Effect(
        name="hum", source="test", about="hum", columns=_hum, needs=("time",)
    )
    signature = problem.signature(effect, {})
    wanted = dict(
        zip(signature.names, problem.noise_units(signature.columns).T, strict=True)
    )
    form = discrepancy.values_of_poses(
        problem, [np.sin(2.0 * np.pi * s.time / PERIOD) for s in problem.states]
    )[..., None]
    _, joints, tool, tool_length = discrepancy.carriers_of(problem)
    legs, tools = (
        [f"leg {i + 1}" for i in problem.states[0].limbs],
        [f"tool {k}" for k in range(3)],
    )
    pairs = [(joints, legs), (tool, tools), (tool_length, ["longer"])]
    zeros = np.zeros(len(problem))
    for carrier, columns in pairs:
        change = discrepancy.apply_carrier(carrier.columns, form)[:, :, 0]
        expected = np.column_stack([wanted.get(name, zeros) for name in columns])
        assert np.sqrt((carrier.columns**2).sum(axis=2).mean()) == (pytest.approx(1.0))
        size = np.linalg.norm(expected) / np.linalg.norm(change)
        assert size * change == pytest.approx(expected, abs=1e-6 * np.ptp(expected))


def test_readings_are_carried_by_set_up_and_channel():
    problem = readings(1)
    each = discrepancy.readings(problem)
    assert each.labels == ("channel dy in lines", "channel dz in lines")
    assert (each.columns.sum(axis=(1, 2)) == 1.0).all()
    assert [
        part.name for part in discrepancy.readings(problem, by_setup=False).parts()
    ] == ["the readings of dy", "the readings of dz"]
    _, _, tool, _ = discrepancy.carriers_of(problem)
    assert len(tool.parts()) == 1


@pytest.mark.parametrize("count", [3, 40])
def test_what_a_wave_explains_is_that_of_least_squares(rng, count):
    problem = case.circles()
    law = case.law(problem)
    r, f = 2.0 * rng.standard_normal(len(problem)), np.linspace(0.1, 0.4, count)
    problem, covariance = problem.with_residual(r), case.dense(problem, law)
    clock, columns = rng.uniform(0.0, 60.0, (2, len(problem), 2))
    carrier = discrepancy.Carrier("", columns[:, None], ("",))
    precision = waves.WavePrecision(problem, Metric(problem, law))
    (tails,) = precision.log_tails(waves.Band("", "s", clock, (carrier,), f))
    wave = columns[:, :, None] * np.exp(2j * np.pi * clock[:, :, None] * f)
    inverse = np.linalg.inv(covariance)
    for tail, column in zip(tails, wave.sum(axis=1).T, strict=True):
        G = np.column_stack([column.real, column.imag])
        energy = r @ inverse @ G @ np.linalg.solve(G.T @ inverse @ G, G.T @ inverse @ r)
        # of two degrees of freedom
        assert tail == pytest.approx(-0.5 * energy, rel=1e-3)
