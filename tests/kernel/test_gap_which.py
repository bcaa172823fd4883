"""The search over sets of effects against sums over every form, and what it says of planted effects."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pandas as pd
import pytest
from scipy import special

from oed.effect import Column, Effect, State
from oed.gap import diagnose as diagnosing
from oed.gap import evidence, library, waves, which
from oed.gap import problem as problems
from oed.gap.diagnosis import UNKNOWN, Answer
from oed.gap.law import Law, Metric, plain
from oed.gap.problem import Problem
from oed.gap.which import SIZES, Search
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof

LINES, LENGTH = 8, 31


def _problem(seed: int) -> Problem:
    """Lines of a planar machine read by RM 5, each both ways, with times and feeds, noise alone."""
    measurement = Measurement(planar_2dof.machine, [mount(relative.rm5, "lines")])
    y = np.linspace(-1.4, 1.4, LENGTH)
    ways = [1 if k % 2 == 0 else -1 for k in range(LINES)]
    command = np.vstack([np.column_stack([y[::w], np.full(LENGTH, 0.4 * (k // 2))]) for k, w in enumerate(ways)])
    labels = [f"line {k}" for k in range(LINES) for _ in range(LENGTH)]
    series = measurement.series("lines", command, labels)
    n = LENGTH - 1
    covariates = pd.DataFrame(
        {
            "setup": "lines",
            "run": series.run,
            "order": np.tile(np.arange(2, LENGTH + 1), LINES),
            "time": 40.0 * np.arange(len(series)),
            "direction": np.repeat(np.array(ways, dtype=float), n),
            "feed": np.repeat([1 / 60.0, 3 / 60.0], LINES * n // 2),
        }
    )
    made = problems.planned(measurement, (series,), covariates)
    rng = np.random.default_rng(seed)
    noise = made.slopes @ rng.standard_normal(made.slopes.shape[1])
    for k, members in enumerate(made.blocks):
        noise[members] += np.linalg.cholesky(plain(made).block(made, k)) @ rng.standard_normal(len(members))
    return made.with_residual(noise)


def _bow(state: State, turns: float) -> list[Column]:
    return [
        Column(f"leg {i + 1}", 5e-6, f"leg {i + 1}", {i: np.cos(turns * np.pi * state.joints[:, i])})
        for i in state.limbs
    ]


def _slip(state: State) -> list[Column]:
    return [Column(f"leg {i + 1}", 5e-6, f"leg {i + 1}", {i: state.sense[:, i]}) for i in state.limbs]


def _drift(state: State) -> list[Column]:
    return [Column("drift", 5e-6, reading={"dy": np.nan_to_num(state.time) / 1e4})]


BOW = Effect(name="bow", source="test", about="bow", columns=_bow, constants={"turns": (2.0, 3.0)}, remedy="straighten")
SLIP = Effect(
    name="slip", source="test", about="slip", columns=_slip, needs=("direction: both",), exposed_by="both ways"
)
DRIFT = Effect(name="drift", source="test", about="drift", columns=_drift, needs=("time",))
EFFECTS = (BOW, SLIP, DRIFT)


def _search(problem: Problem, effects: tuple[Effect, ...] = EFFECTS, law: Law | None = None) -> Search:
    made = library.build(problem, effects)
    none = library.build(problem, ())
    return Search(problem, made, none, plain(problem) if law is None else law, 0.0)


def _with(problem: Problem, effect: Effect, factors: dict[str, float], **constants: float) -> Problem:
    made = library.build(problem, [dataclasses.replace(effect, constants={k: (v,) for k, v in constants.items()})])
    change = sum(factors[n] * made.columns[:, k] for k, n in enumerate(made.names) if n in factors)
    return problem.with_residual(problem.residual + np.asarray(change))


def _brute(search: Search, effects: tuple[str, ...]) -> float:
    """Log evidence of a set of effects, summed over every form and size of each."""
    told = []
    for atoms in itertools.product(*[search.library.atoms_of(e) for e in effects]):
        for sizes in itertools.product(range(len(SIZES)), repeat=len(effects)):
            weight = sum(search._shares[a, s] for a, s in zip(atoms, sizes, strict=True))
            if np.isfinite(weight):
                told.append(weight + search.given(atoms, [float(SIZES[s]) for s in sizes]).base)
    return float(special.logsumexp(told))


@pytest.mark.parametrize("strength", [0.0, 1.0])
def test_evidence_is_the_sum_over_all_forms(strength: float) -> None:
    problem = _with(_with(_problem(1), BOW, {"leg 1": strength}, turns=3.0), SLIP, {"leg 2": strength})
    search = _search(problem)
    found = {h.key: h for h in search.run()}
    for names in ((), ("bow",), ("slip",)):
        assert found[frozenset(names), False].log_evidence == pytest.approx(_brute(search, names), abs=1e-6)
    # of pairs the sum is taken about the best forms: exact where they are clear, near where nothing acts
    pair = found[frozenset({"bow", "slip"}), False]
    assert pair.log_evidence == pytest.approx(_brute(search, ("bow", "slip")), abs=0.02 if strength else 0.6)


def test_prior_shares_add_up() -> None:
    search = _search(_problem(2))
    for effect in search.library.effects:
        mine = search.library.atoms_of(effect)
        assert np.exp(search._shares[mine]).sum() == pytest.approx(1.0)
    assert sum(which.PRIOR.values()) == pytest.approx(1.0)


def test_planted_effects_are_named_and_no_others() -> None:
    problem = _with(_with(_problem(3), BOW, {"leg 1": 2.0}, turns=2.0), SLIP, {"leg 2": 2.0})
    best = which.compare([_search(problem)])[0]
    assert set(best.effects) == {"bow", "slip"}
    atom = _search(problem).library.atoms[best.atoms[best.effects.index("bow")]]
    assert atom.constants == {"turns": 2.0}
    assert which.compare([_search(_problem(3))])[0].effects == ()


def test_an_unknown_takes_nothing_from_a_selected_effect() -> None:
    """A process that lies in the span of what is selected explains nothing more."""
    problem = _with(_problem(4), BOW, {"leg 1": 2.0, "leg 2": -1.0}, turns=2.0)
    same = dataclasses.replace(BOW, name="process", constants={"turns": (2.0,)})
    search = Search(problem, library.build(problem, [BOW]), library.build(problem, [same]), plain(problem), 0.0)
    known = next(h for h in search.run() if h.key == (frozenset({"bow"}), False))
    full = [k for k in search.library.atoms_of("bow") if len(search.columns_of(k)) == 2]
    known = dataclasses.replace(known, atoms=(full[0],))
    mixed = search.with_unknown(known)
    assert mixed.log_evidence == pytest.approx(known.log_evidence, abs=1e-6)
    alone = search.with_unknown(next(h for h in search.run() if h.key == (frozenset(), False)))
    assert alone.log_evidence > known.log_evidence - 12.0


def test_a_steady_wave_is_found_at_its_period() -> None:
    problem = _problem(5)
    time = problem.rows["time"].to_numpy()
    dy = (problem.rows["channel"] == "dy").to_numpy()
    hum = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0 + 1.0), 0.0)
    none = library.build(problem, ())
    made = waves.added(none, problem.with_residual(problem.residual + hum), plain(problem))
    assert made.atoms[0].constants["period_s"] == pytest.approx(173.0, rel=0.01)
    search = Search(problem.with_residual(problem.residual + hum), none, made, plain(problem), 0.0)
    best = which.compare([search])[0]
    assert best.key == (frozenset(), True)
    quiet = Search(problem, none, waves.added(none, problem, plain(problem)), plain(problem), 0.0)
    assert which.compare([quiet])[0].key == (frozenset(), False)


def test_untestable_without_its_covariates() -> None:
    problem = _problem(6)
    states = tuple(
        dataclasses.replace(s, time=np.full(len(s), np.nan), direction=np.ones(len(s))) for s in problem.states
    )
    made = library.build(dataclasses.replace(problem, states=states), EFFECTS)
    assert made.effects == ("bow",)
    assert "time" in made.not_testable["drift"]
    assert "direction" in made.not_testable["slip"]


def test_many_constants_keep_the_few_that_explain() -> None:
    dense = dataclasses.replace(BOW, constants={"turns": tuple(np.linspace(1.0, 8.0, 57))})
    problem = _with(_problem(7), BOW, {"leg 1": 2.0}, turns=5.0)
    law = plain(problem)
    made = library.build(problem, [dense], Metric(problem, law))
    kept = {a.constants["turns"] for a in made.atoms}
    assert len(kept) == library.KEPT
    assert min(abs(k - 5.0) for k in kept) < 0.07
    assert max(a.log_weight for a in made.atoms) < -np.log(57.0)


def test_diagnosis_from_end_to_end() -> None:
    problem = _with(_problem(8), SLIP, {"leg 1": 2.0})
    found = diagnosing.diagnose(problem, EFFECTS, np.random.default_rng(0))
    assert found.verdict == "effect"
    assert found.answers[0].effects == ("slip",)
    assert found.answers[0].probability > 0.8
    assert sum(a.probability for a in found.answers) == pytest.approx(1.0, abs=0.02)
    assert found.where[0].block.endswith(("leg 1", "leg 2"))  # on lines both legs turn back at once
    told = {c.label: c for c in found.coefficients}["leg 1"]
    assert told.mean == pytest.approx(10e-6, abs=4.0 * told.sd)
    assert np.sqrt(np.mean(found.after**2)) < 0.6 * np.sqrt(np.mean(found.before**2))
    assert all(c.value == pytest.approx(1.0, abs=0.1) for c in found.closure)
    again = diagnosing.diagnose(problem, EFFECTS, np.random.default_rng(0))
    assert again.answers == found.answers
    assert again.where == found.where


def test_verdicts() -> None:
    for effects, classes, wanted in (
        ((), (), "none"),
        ((UNKNOWN,), (), "unknown"),
        (("a",), (("a",),), "effect"),
        (("a",), (("a", "b"),), "class"),
        (("a", UNKNOWN), (("a",),), "mixture"),
        (("a", "b"), (("a",), ("b",)), "mixture"),
    ):
        assert diagnosing.verdict(Answer(effects, 1.0, classes)) == wanted


def test_level_is_that_of_what_is_left() -> None:
    problem = _problem(9)
    search = _search(problem.with_residual(3.0 * problem.residual))
    assert search.level(search.run()[0]) == pytest.approx(3.0, rel=0.1)
    assert evidence.level(search.grams) == pytest.approx(3.0, rel=0.1)
