"""The search over sets of effects against sums over every form, and its noise laws."""

import dataclasses
import itertools

import numpy as np
import pytest
from scipy import special
from shipped_models import (
    backlash,
    frame_thermal,
    friction,
    leg_thermal,
    mount_drift,
    step,
)

from kernel.gap_lines import BOW, DRIFT, EFFECTS, SLIP, planted, readings, search_of
from kernel.laws import STATED_LAW, noise_law
from oed.effect_model import Column, Effect, State
from oed.gap import procedure as diagnosing
from oed.gap.cause import search as searching_one
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.search import EFFECT_SIZE_VALUES, PRIOR, Search
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import library


def _brute(search: Search, effects: tuple[str, ...]) -> float:
    """Log evidence of a set of effects, summed over every form and size of each."""
    terms = []
    prior = search._log_prior
    for atoms in itertools.product(*[search.library.atoms_of(e) for e in effects]):
        every = range(len(EFFECT_SIZE_VALUES))
        for sizes in itertools.product(every, repeat=len(effects)):
            weight = sum(prior[a, s] for a, s in zip(atoms, sizes, strict=True))
            if np.isfinite(weight):
                sized = [float(EFFECT_SIZE_VALUES[s]) for s in sizes]
                terms.append(weight + search.grams_with(atoms, sized).base)
    return float(special.logsumexp(terms))


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_evidence_is_the_sum_over_all_forms(strength):
    bowed = planted(readings(1), BOW, {"leg 1": strength}, turns=3.0)
    problem = planted(bowed, SLIP, {"leg 2": strength})
    search = search_of(problem)
    by_key = {h.key: h for h in search.run()}
    for names in ((), ("bow",), ("slip",)):
        assert by_key[frozenset(names), False].log_evidence == pytest.approx(
            _brute(search, names), abs=1e-6
        )
    # of pairs the sum is taken about the best forms: exact where they are clear, near
    # where nothing acts
    pair = by_key[frozenset({"bow", "slip"}), False]
    assert pair.log_evidence == pytest.approx(
        _brute(search, ("bow", "slip")), abs=0.02 if strength else 0.6
    )


def test_constants_that_make_no_difference_are_one_form():
    """The same columns, the same evidence, once."""

    def columns(state: State, turns: float, idle: float) -> list[Column]:
        return list(BOW.columns(state, turns))

    idle = dataclasses.replace(
        BOW, columns=columns, constants={**BOW.constants, "idle": (1.0, 2.0, 3.0)}
    )
    problem = planted(readings(1), BOW, {"leg 1": 1.0}, turns=3.0)
    plainly, twice = search_of(problem, (BOW,)), search_of(problem, (idle,))
    assert len(twice.library.atoms) == len(plainly.library.atoms)
    log_evidences = [
        s.fit(("bow",), (0,), (1.0,)).log_evidence for s in (plainly, twice)
    ]
    assert log_evidences[0] == pytest.approx(log_evidences[1])


def test_prior_shares_add_up():
    search = search_of(readings(2))
    for effect in search.library.effects:
        mine = search.library.atoms_of(effect)
        assert np.exp(search._log_prior[mine]).sum() == pytest.approx(1.0)
    assert sum(PRIOR.values()) == pytest.approx(1.0)


def test_an_unknown_takes_nothing_from_a_selected_effect():
    """A process that lies in the span of what is selected explains nothing more."""
    problem = planted(readings(4), BOW, {"leg 1": 2.0, "leg 2": -1.0}, turns=2.0)
    same = dataclasses.replace(BOW, name="process", constants={"turns": (2.0,)})
    search = search_of(problem, [BOW], library.build(problem, [same]))
    known = next(h for h in search.run() if h.key == (frozenset({"bow"}), False))
    full = [k for k in search.library.atoms_of("bow") if len(search.columns_of(k)) == 2]
    known = dataclasses.replace(known, atoms=(full[0],))
    mixed = search.add_unknown(known)
    assert mixed.log_evidence == pytest.approx(known.log_evidence, abs=1e-6)
    alone = search.add_unknown(
        next(h for h in search.run() if h.key == (frozenset(), False))
    )
    assert alone.log_evidence > known.log_evidence - 12.0


def test_an_unknown_is_added_to_the_most_probable_sets(monkeypatch):
    """And to none and every single effect, where not all sets are extended."""
    monkeypatch.setattr(searching_one, "N_SETS", 2)
    problem = planted(readings(4), BOW, {"leg 1": 2.0, "leg 2": -1.0}, turns=2.0)
    process = dataclasses.replace(BOW, name="process")
    search = search_of(problem, EFFECTS, library.build(problem, [process]))
    hypotheses = search.run()
    known = [h for h in hypotheses if not h.key[1]]
    best = sorted(known, key=lambda h: h.score)[-2:]
    mixed = {h.key[0] for h in hypotheses if h.key[1]}
    assert len(known) > 3
    single = {h.key[0] for h in known if len(h.effects) == 1}
    assert mixed == {frozenset(), *single, *(h.key[0] for h in best)}


def test_a_search_of_few_candidates_answers_as_one_of_all_does():
    problem = planted(readings(1), BOW, {"leg 1": 1.5}, turns=3.0)
    every = search_of(problem)
    candidates = [h for h in every.run() if len(h.effects) < 2][:2]
    some = Search(
        problem, every.library, every.processes, every.law, 0.0, candidates=candidates
    )
    by_key = {h.key: h for h in every.run()}
    for h in some.run():
        wanted = by_key[h.key].log_evidence
        assert h.log_evidence == pytest.approx(wanted, abs=1e-8)
        assert some.noise_level(h) == pytest.approx(every.noise_level(h), rel=1e-9)
    rivals = every.screen((), (), ())
    for name, further in some.screen((), (), ()).items():
        assert further.log_evidence == pytest.approx(rivals[name].log_evidence)


def test_pairs_extend_the_most_probable_single_effects_alone(monkeypatch):
    """Bows of 1.7 and 2.3 turns are likeliest together, one of 2 turns alone."""
    monkeypatch.setattr(searching_one, "MAX_LOG_DEFICIT", 1e6)
    problem = planted(readings(4), BOW, {"leg 1": 5.0}, turns=1.7)
    problem = planted(problem, BOW, {"leg 1": 5.0}, turns=2.3)
    effects = tuple(
        dataclasses.replace(BOW, name=f"bow {turns}", constants={"turns": (turns,)})
        for turns in (1.7, 2.0, 2.3)
    )
    both = {"bow 1.7", "bow 2.3"}
    assert set(search_of(problem, effects).run()[0].effects) >= both
    monkeypatch.setattr(searching_one, "N_SETS", 1)
    pairs = [
        h.effects for h in search_of(problem, effects).run() if len(h.effects) == 2
    ]
    assert len(pairs) == 2
    assert all("bow 2.0" in pair for pair in pairs)


def test_untestable_without_its_covariates():
    """Shipped effects as well: nothing thermal without times, no play of one direction."""
    problem = readings(6)
    timed = (leg_thermal.effect, frame_thermal.effect, mount_drift.effect, step.effect)
    turning = (backlash.effect, friction.effect)
    assert not library.build(problem, (*timed, *turning)).not_testable
    states = tuple(
        dataclasses.replace(s, time=np.full(len(s), np.nan), direction=np.ones(len(s)))
        for s in problem.states
    )
    effects = (*EFFECTS, *timed, *turning)
    testable = library.build(dataclasses.replace(problem, states=states), effects)
    assert testable.effects == ("bow",)
    assert all("time" in testable.not_testable[e.name] for e in (DRIFT, *timed))
    assert all("direction" in testable.not_testable[e.name] for e in (SLIP, *turning))


def _curl(state: State, turns: float, bend: float) -> list[Column]:
    """A bow that grows along the travel, from nothing to `bend` times itself."""
    forms = [np.cos(turns * np.pi * q) * (1.0 + bend * q) for q in state.joints.T]
    names = [f"leg {i + 1}" for i in range(len(forms))]
    return [Column(n, 5e-6, n, {i: forms[i]}) for i, n in enumerate(names)]


TURNS, BENDS = tuple(np.linspace(1.0, 8.0, 57)), (0.0, -0.1, 0.3, 1.0, 3.0)


GRID = {"turns": TURNS, "bend": BENDS}
CURL = Effect(name="curl", source="test", about="curl", columns=_curl, constants=GRID)


def test_a_large_grid_is_looked_through_whole():
    assert len(CURL.constant_grid()) > library.MAX_GRID
    problem = planted(
        readings(10), CURL, {"leg 1": 2.0, "leg 2": -1.0}, turns=TURNS[31], bend=-0.1
    )
    metric = Metric(problem, STATED_LAW)
    forms = library.build(problem, [CURL], metric)
    constants = {(a.constants["turns"], a.constants["bend"]) for a in forms.atoms}
    assert (TURNS[31], -0.1) in constants
    assert len(constants) == library.N_BEST_FORMS
    best = compare(
        [Search(problem, forms, library.build(problem, ()), STATED_LAW, 0.0)]
    )[0]
    assert forms.atoms[best.atoms[0]].constants == {"turns": TURNS[31], "bend": -0.1}
    blind = library.build(problem, [CURL])
    assert {a.constants["bend"] for a in blind.atoms} == {0.0}
    assert {a.constants["turns"] for a in blind.atoms} == set(TURNS)
    assert np.exp([a.log_weight for a in blind.atoms]).sum() == pytest.approx(1.0)


@pytest.mark.parametrize("bends", [BENDS, BENDS[:1], BENDS[:3]])
def test_forms_have_the_prior_of_one_effect_before_any_is_dropped(bends, monkeypatch):
    problem, chosen = planted(readings(10), BOW, {"leg 1": 2.0}, turns=5.0), []
    dropping = library._best

    def best(problem, metric, forms, *count):  # type: ignore[no-untyped-def]
        every = list(forms)
        chosen.append([(dict(f.constants), w) for f, w in every])
        return dropping(problem, metric, every, *count)

    monkeypatch.setattr(library, "_best", best)
    effect = dataclasses.replace(CURL, constants={"turns": TURNS, "bend": bends})
    metric = Metric(problem, STATED_LAW)
    kept = library._forms(problem, effect, metric)
    forms, large = chosen[-1], len(effect.constant_grid()) > library.MAX_GRID
    weights = np.exp([w for _, w in forms])
    if not large:  # all have the same, which their number tells
        weights = np.full(len(forms), np.exp(kept[0][1]))
    assert weights.sum() == pytest.approx(1.0)
    points = [tuple(c.values()) for c, _ in forms]
    assert len(set(points)) == len(points) == 57 * len(bends)
    if large:  # half of the prior is for the first values
        plainly = np.array([c["bend"] == bends[0] for c, _ in forms])
        assert weights[plainly].sum() == pytest.approx(0.5)
        np.testing.assert_allclose(weights[~plainly], 0.5 / (57 * (len(bends) - 1)))
    else:
        np.testing.assert_allclose(weights, 1.0 / (57 * len(bends)))


def test_a_form_of_a_large_grid_adapts_once_it_is_chosen():
    """The grid is looked through without columns that adapt; what is kept of it has them."""

    def bent(state: State, turns: float, bend: float) -> list[Column]:
        forms = _curl(state, turns, bend)
        more = [(c, {"name": f"{c.name} more", "joints": _cubed(c)}) for c in forms]
        return [*forms, *(dataclasses.replace(c, shape=True, **m) for c, m in more)]

    problem = planted(
        readings(10), CURL, {"leg 1": 2.0, "leg 2": -1.0}, turns=TURNS[31], bend=-0.1
    )
    forms = library.build(
        problem, [dataclasses.replace(CURL, columns=bent)], Metric(problem, STATED_LAW)
    )
    names_by_constants = {
        (a.constants["turns"], a.constants["bend"]): [] for a in forms.atoms
    }
    for a in forms.atoms:
        names_by_constants[a.constants["turns"], a.constants["bend"]] += [
            forms.names[k] for k in a.columns
        ]
    assert (TURNS[31], -0.1) in names_by_constants
    assert all(
        set(names) == {"leg 1", "leg 2", "leg 1 more", "leg 2 more"}
        for names in names_by_constants.values()
    )


def _cubed(column: Column) -> dict[int, np.ndarray]:
    return {i: change**3 for i, change in column.joints.items()}


def test_diagnosis_from_end_to_end():
    problem = planted(readings(8), SLIP, {"leg 1": 2.0})
    diagnosis = diagnosing.diagnose(problem, EFFECTS, np.random.default_rng(0))
    assert diagnosis.verdict == "effect"
    assert diagnosis.answers[0].effects == ("slip",)
    assert diagnosis.answers[0].probability > 0.8
    assert sum(a.probability for a in diagnosis.answers) == pytest.approx(1.0, abs=0.02)
    # on lines both legs turn back at once
    assert {"leg 1", "leg 2"} & {b.block for b in diagnosis.where}
    coefficient = {c.label: c for c in diagnosis.coefficients}["leg 1"]
    assert coefficient.value == pytest.approx(10e-6, abs=4.0 * coefficient.sd)
    assert np.sqrt(np.mean(diagnosis.after**2)) < 0.6 * np.sqrt(
        np.mean(diagnosis.before**2)
    )
    assert all(c.value == pytest.approx(1.0, abs=0.1) for c in diagnosis.closure)


def test_level_is_that_of_what_is_left():
    problem = readings(9)
    search = search_of(problem.with_residual(3.0 * problem.residual))
    assert search.noise_level(search.run()[0]) == pytest.approx(3.0, rel=0.1)
    assert evidence.noise_level(search.grams) == pytest.approx(3.0, rel=0.1)


def _under(problem: GapProblem, run_sd: float, log_prior: float = 0.0) -> Search:
    law = noise_law(run_sd=run_sd)
    forms, none = library.build(problem, [BOW]), library.build(problem, ())
    return Search(problem, forms, none, law, log_prior)


def test_a_law_that_was_searched_needs_no_search_for_another_weight():
    problem = planted(readings(4), BOW, {"leg 1": 1.0}, turns=2.0)
    search = _under(problem, 0.3)
    search.run()
    weighed, anew = search.with_weight(-1.7), _under(problem, 0.3, -1.7)
    pairs = zip(weighed.run(), anew.run(), strict=True)
    assert [h.key for h in weighed.run()] == [h.key for h in anew.run()]
    for h, other in pairs:
        assert h.log_evidence == pytest.approx(other.log_evidence)
    refitted = weighed.fit(("bow",), (0,), (1.0,))
    assert refitted.log_evidence == pytest.approx(
        anew.fit(("bow",), (0,), (1.0,)).log_evidence
    )


def test_laws_are_drawn_where_a_likely_gap_rests_on_few():
    """Under laws one of which suits far better; not where all suit alike."""
    problem = planted(readings(4), BOW, {"leg 1": 2.0, "leg 2": -1.0}, turns=2.0)
    for sizes, count in (((0.0, 30.0, 100.0), 1), ((0.1,) * 4, 0)):
        several = [_under(problem, size) for size in sizes]
        best = compare(several)[0]
        assert best.effects == ("bow",)
        alike = [h for s in several for h in s.run() if h.key == best.key]
        shares = special.softmax([h.log_evidence for h in alike])
        assert best.effective_laws == pytest.approx(1.0 / (shares**2).sum())
        posteriors: dict = {}
        searching._add_scarce(posteriors, several)
        assert len(posteriors) == count


def test_a_law_in_a_corner_is_the_only_one(monkeypatch):
    """As where all rows are copies of others: no law is drawn about the mode."""
    problem = planted(readings(4), BOW, {"leg 1": 1.0}, turns=2.0)
    monkeypatch.setattr(evidence, "MAX_COORDINATE", 0.0)
    posterior = evidence.posterior(problem, evidence.compress(problem))
    assert np.isfinite(posterior.log_evidence)
    assert (posterior.draws == posterior.draws[0]).all()
