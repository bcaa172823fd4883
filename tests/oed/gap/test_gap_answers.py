"""Answers from hypotheses: verdicts, classes, the 95 % set, limbs alike, advice."""

import dataclasses

import numpy as np
import pytest

from kernel.gap_lines import BOW, DRIFT, SLIP, planted, readings, search_of
from oed.effect_model import Column, Effect, State
from oed.gap.cause import answers as answering
from oed.gap.cause.answers import advise
from oed.gap.cause.compare import probabilities
from oed.gap.cause.search import PRIOR, Hypothesis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.gap.forms.library import LIMB_DIFFERENCE, Library
from oed.result import UNKNOWN, AnswerRecord, GapSection


def test_verdicts():
    for effects, classes, wanted in (
        ((), (), "none"),
        ((UNKNOWN,), (), "unknown"),
        (("a",), (("a",),), "effect"),
        (("a",), (("a", "b"),), "class"),
        (("a", UNKNOWN), (("a",),), "mixture"),
        (("a", "b"), (("a",), ("b",)), "mixture"),
    ):
        assert answering.verdict(AnswerRecord(effects, 1.0, classes)) == wanted


MANY = tuple(f"m{k}" for k in range(answering.MIN_VAGUE_MEMBERS))


def _said(*parts: tuple[list[tuple[str, ...]], bool, float]) -> list[AnswerRecord]:
    answers: list[AnswerRecord] = []
    for members, unknown, probability in parts:
        answering._add(answers, _group(members, unknown, probability))
    return answers


def test_a_name_drawn_from_many_beside_a_named_effect_is_told_as_unknown():
    assert _said(([("a", "b"), MANY], False, 0.4)) == [
        AnswerRecord(("a", UNKNOWN), 0.4, (("a", "b"),))
    ]
    assert _said(([MANY, ("a",)], False, 0.4)) == [
        AnswerRecord(("a", UNKNOWN), 0.4, (("a",),))
    ]
    few = MANY[:-1]
    assert _said(([("a",), few], False, 0.4)) == [
        AnswerRecord(("a", few[0]), 0.4, (("a",), few))
    ]
    assert _said(([("a",), few], True, 0.4)) == [
        AnswerRecord(("a", few[0], UNKNOWN), 0.4, (("a",), few))
    ]


def test_of_two_vague_classes_the_smaller_stays_and_a_lone_one_as_it_is():
    more = tuple(f"n{k}" for k in range(answering.MIN_VAGUE_MEMBERS + 1))
    for members in ([more, MANY], [MANY, more]):
        assert _said((members, False, 0.4)) == [
            AnswerRecord((MANY[0], UNKNOWN), 0.4, (MANY,))
        ]
    assert _said(([more], False, 0.4)) == [AnswerRecord((more[0],), 0.4, (more,))]
    assert _said(([more], True, 0.4)) == [
        AnswerRecord((more[0], UNKNOWN), 0.4, (more,))
    ]


def test_probabilities_of_answers_that_say_the_same_are_added():
    same = _said(
        ([("a", "b")], True, 0.3),
        ([("b",), MANY], False, 0.2),
        ([("a",), MANY], True, 0.1),
    )
    assert [(a.effects, a.classes) for a in same] == [(("a", UNKNOWN), (("a", "b"),))]
    assert same[0].probability == pytest.approx(0.6)
    few = [([("a",)], False, 0.2), ([("a",)], True, 0.1), ([], True, 0.1)]
    others = _said(([], False, 0.3), ([], True, 0.3), *few)
    assert [a.effects for a in others] == [(), (UNKNOWN,), ("a",), ("a", UNKNOWN)]
    assert [a.probability for a in others] == pytest.approx([0.3, 0.4, 0.2, 0.1])


def _group(members, unknown, probability):
    return answering.AnswerGroup(None, tuple(members), unknown, probability)


def test_the_set_names_each_set_of_effects_once_and_keeps_all_names():
    """With and without a remainder is one; a second that could be any of many stays."""
    groups = [
        _group([("a", "b")], False, 0.35),
        _group([("a", "b")], True, 0.1),
        _group([("a",), MANY], False, 0.2),
        _group([MANY, ("a", "b")], True, 0.16),
        _group([], False, 0.09),
        _group([], True, 0.06),
        _group([("c",)], False, 0.04),
    ]
    answers = answering.credible_set(groups)
    assert [(a.effects, a.classes) for a in answers] == [
        (("a",), (("a", "b"),)),
        (("a", MANY[0]), (("a",), MANY)),
        ((), ()),
        ((UNKNOWN,), ()),
    ]
    assert [a.probability for a in answers] == pytest.approx([0.45, 0.36, 0.09, 0.06])


def test_the_set_has_an_unknown_once_and_what_is_too_small_by_itself():
    """What is too small to be seen has no name."""
    unseen = answering.AnswerGroup(None, (), True, 0.2, 0.2)
    told = (
        ([], False, 0.4),
        ([], True, 0.15),
        ([], True, 0.1),
        ([("a",)], False, 0.15),
    )
    answers = answering.credible_set([*(_group(*t) for t in told), unseen])
    assert [(a.effects, a.classes) for a in answers] == [
        ((), ()),
        ((UNKNOWN,), ()),
        ((UNKNOWN,), ()),
        (("a",), (("a",),)),
    ]
    assert [a.probability for a in answers] == pytest.approx([0.4, 0.25, 0.2, 0.15])
    assert answers[2].visible == 0.0


def test_a_remainder_is_told_in_the_set_where_it_is_likelier_than_not():
    (answer,) = answering.credible_set(
        [_group([("a",)], False, 0.4), _group([("a",)], True, 0.6)]
    )
    assert answer == AnswerRecord(("a", UNKNOWN), 1.0, (("a",),))


def _hypothesis(effects, probability, unknown=False):
    log_evidence, atoms = float(np.log(probability)), (0,) * len(effects)
    return Hypothesis(effects, unknown, atoms, (), None, 0.0, log_evidence, 0.0)


def test_the_first_answer_is_told_by_a_hypothesis_of_its_own(monkeypatch):
    """Two that say the same, b beside an unknown, are together likelier than a."""
    vague = tuple("cdefgh")
    sets = [(("a",), 0.4, False), (("b", "c"), 0.3, False), (("b",), 0.3, True)]
    monkeypatch.setattr(
        answering,
        "equivalent_effects",
        lambda search, h, *_: [vague if e == "c" else (e,) for e in h.effects],
    )
    hypotheses = [_hypothesis(*one) for one in sets]
    groups = answering.group([None], hypotheses, np.array([0.4, 0.3, 0.3]))
    answers, leading = answering.rank(groups)
    assert answers[0].effects == ("b", UNKNOWN)
    assert answers[0].probability == pytest.approx(0.6)
    assert leading[0].effects == ("b", "c")


@pytest.mark.parametrize("members", [1, answering.MIN_VAGUE_MEMBERS])
@pytest.mark.parametrize("margin", [0.01, -0.01])
def test_no_gap_is_told_only_where_it_is_sure(monkeypatch, members, margin):
    limit = GapSection.MISSED_GAP_COST / (GapSection.MISSED_GAP_COST + 1.0)
    assert 0.5 < limit < 1.0
    none, further = limit + margin, range(1, members)
    monkeypatch.setattr(
        answering,
        "equivalent_effects",
        lambda search, h, *_: [(e, *(f"{e}{k}" for k in further)) for e in h.effects],
    )
    shares = {(): none, ("a",): 0.6 * (1.0 - none), ("b",): 0.4 * (1.0 - none)}
    hypotheses = [_hypothesis(*one) for one in shares.items()]
    groups = answering.group([None], hypotheses, np.array(list(shares.values())))
    answers, leading = answering.rank(groups)
    assert answers[0].effects == (() if margin > 0.0 else ("a",))
    for h, answer in zip(leading, answers, strict=True):
        assert h.effects == answer.effects or answer.unseen >= answer.probability
    silent = sum(a.unseen for a in answers)
    nothing = next(a.probability for a in answers if not a.effects)
    assert nothing + silent == pytest.approx(none)
    share = PRIOR["unseen"] / (PRIOR["unseen"] + PRIOR["none"])
    assert silent / none == pytest.approx(share)
    assert sum(a.probability for a in answers) == pytest.approx(1.0)


def test_probabilities_are_by_evidence_and_prior():
    blank = {"atoms": (), "sizes": (), "process": None, "process_size": 0.0}
    stated = [((), False, 1.0, -0.5), (("a",), False, 3.0, -2.0), ((), True, 0.5, -1.0)]
    hypotheses = [
        Hypothesis(effects=e, unknown=u, log_evidence=s, log_prior=p, **blank)
        for e, u, s, p in stated
    ]
    weights = np.exp([0.5, 1.0, -0.5])
    assert probabilities(hypotheses) == pytest.approx(weights / weights.sum())
    assert probabilities(hypotheses[:1]) == pytest.approx([1.0])


def _answer(probability: float, *effects: str) -> AnswerRecord:
    named = tuple((e,) for e in effects if e != UNKNOWN)
    return AnswerRecord(effects, probability, named)


EFFECTS = (BOW, SLIP, DRIFT)
NONE, BOWED = _answer(0.05), _answer(0.95, "bow")
SIX = tuple(f"slip {k}" for k in range(6))
SLIPS = [dataclasses.replace(SLIP, name=name) for name in SIX]
OILED = (BOW, dataclasses.replace(SLIP, remedy="oil"), DRIFT)
EXPOSED = (dataclasses.replace(BOW, exposed_by="a straightedge"), SLIP, DRIFT)
ANY_OF_MANY = AnswerRecord(("slip", UNKNOWN), 0.4, (("slip", *SIX),))
UNSEEN = AnswerRecord(("slip",), 0.3, (("slip", "bow"),), unseen=0.3)
UNTIMED = {"drift": "the readings do not have time"}
LOST = {
    **UNTIMED,
    "leg_warm": "the readings do not have time or temp_leg",
    "slack": "the readings do not have direction: both",
    "slip": "it changes none of these readings",
}
AGAIN = "Noise alone has a probability of {} %: read again before you correct anything."
SLIPPING = f"{AGAIN} What would show slip: both ways."
SURE = "Nothing beyond the geometry and the noise is seen: compensate the geometry."
DOUBT = "An effect is not excluded (probability {} %): one run taken again"
MAKE_SURE = "To make sure that it is not slip: both ways."
UNEXPLAINED = "that no effect of the library explains: look at where it lies"
BESIDE = "Something of unknown form may act beside it: read again after a remedy."
RECORD = (
    "These readings cannot test all effects. Record with the next ones, and vary: time."
)
VARY = "What acts may be what these readings cannot test: record and vary direction and time."
ALIKE = "These readings cannot tell 6 effects apart. What would help first: both ways."
TWICE = "A reading scatters 1.8 times as much as stated"


@pytest.mark.parametrize(("answers", "effects", "lost", "sentences"), [
    ([BOWED, NONE], EFFECTS, {}, ["bow: straighten."]),
    ([_answer(0.6, "bow"), _answer(0.4, "slip")], EFFECTS, {}, [MAKE_SURE, "If it is bow: straighten."]),
    ([_answer(0.5, "bow", "slip"), _answer(0.4, "bow"), _answer(0.1)], OILED, {},
     [SLIPPING.format(10), "bow: straighten.", "If it is slip: oil."]),
    ([_answer(0.6, "bow"), _answer(0.4, "bow", UNKNOWN)], EFFECTS, {}, ["bow: straighten.", BESIDE]),
    ([_answer(0.6, UNKNOWN), ANY_OF_MANY], EFFECTS, {}, [f"Something acts {UNEXPLAINED}"]),
    ([_answer(0.5, UNKNOWN), _answer(0.3, "bow"), _answer(0.2)], (), {},
     [AGAIN.format(20), f"Something may act {UNEXPLAINED}"]),
    ([AnswerRecord(SIX[:1], 0.9, (SIX,))], SLIPS, {}, [ALIKE]),
    ([_answer(0.3, "slip"), _answer(0.66)], EFFECTS, {}, [SLIPPING.format(66)]),
    ([_answer(0.9), _answer(0.1, "bow")], EFFECTS, UNTIMED, [SURE, DOUBT.format(10), RECORD]),
    # what is too small to be seen is no rival
    ([_answer(0.6), UNSEEN, _answer(0.1, "bow")], EFFECTS, {}, [SURE, DOUBT.format(10)]),
    ([_answer(0.4), UNSEEN, _answer(0.25, "slip")], EFFECTS, {}, [SURE, DOUBT.format(25), MAKE_SURE]),
    ([_answer(0.97), _answer(0.03, "bow")], EFFECTS, {}, [SURE]),
    ([_answer(0.92), _answer(0.08, "bow")], EFFECTS, {}, [SURE, DOUBT.format(8)]),
    ([_answer(0.95, UNKNOWN), NONE], EFFECTS, LOST, [f"Something acts {UNEXPLAINED}", VARY]),
    ([BOWED, NONE], EFFECTS, LOST, ["bow: straighten."]),
    # not `it`, which could be the noise
    ([_answer(0.6, "bow"), _answer(0.3)], EXPOSED, {},
     [f"{AGAIN.format(30)} What would show bow: a straightedge.", "If it is bow: straighten."]),
])  # fmt: skip
def test_advice_begins_with(answers, effects, lost, sentences):
    advice = advise(answers, effects, lost)
    assert len(advice) == len(sentences)
    assert all(map(str.startswith, advice, sentences))


def test_unstated_noise_is_read_again_before_the_geometry_is_compensated():
    answers = [_answer(0.97), _answer(0.03, "bow")]
    assert advise(answers, EFFECTS, {}, unstated=1.83)[0].startswith(TWICE)


LOOSE = dataclasses.replace(BOW, constants={"turns": (2.0,)})
TWINS = dataclasses.replace(LOOSE, name="twins", common_to_limbs=True)


def _more(state: State, turns: float) -> list[Column]:
    columns = list(BOW.columns(state, turns=turns))
    more = [
        (c, {"name": f"{c.name} more", "joints": _along(state, c)}) for c in columns
    ]
    return [*columns, *(dataclasses.replace(c, shape=True, **m) for c, m in more)]


def _along(state: State, column: Column) -> dict[int, np.ndarray]:
    return {i: change * state.joints[:, i] for i, change in column.joints.items()}


ADAPTING = dataclasses.replace(TWINS, columns=_more)


def _covariance(forms: Library, atom: library.Atom) -> np.ndarray:
    columns = forms.columns.take(atom.columns)
    return np.asarray(columns @ columns.T)


def test_prior_of_limbs_that_are_alike():
    """Coefficients of N(0, s^2 (1 1^T + DIFFER^2 I)), whatever columns they are told in."""
    problem = readings(1)
    free, twins = library.build(problem, [LOOSE]), library.build(problem, [TWINS])
    (joined,) = [
        a for a in twins.atoms if any("all legs" in twins.names[c] for c in a.columns)
    ]
    prior = np.ones((2, 2)) + LIMB_DIFFERENCE**2 * np.eye(2)
    columns = free.columns.all()
    wanted = columns @ prior @ columns.T
    np.testing.assert_allclose(_covariance(twins, joined), wanted, atol=1e-9)
    assert [twins.labels[c] for c in joined.columns] == ["", "leg 1", "leg 2"]


@pytest.mark.parametrize("effect", [TWINS, ADAPTING], ids=["textbook", "adapting"])
def test_shares_of_forms_add_up(effect):
    forms = library.build(readings(1), [effect])
    assert np.exp([a.log_weight for a in forms.atoms]).sum() == pytest.approx(1.0)


def test_what_adapts_is_alike_too():
    forms = library.build(readings(1), [ADAPTING])
    joined = [tuple(forms.names[c] for c in a.columns) for a in forms.atoms]
    differences = ("leg 1 apart", "leg 2 apart")
    assert ("all legs", *differences) in joined
    assert ("all legs", "all legs more", *differences) in joined


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_an_effect_says_how_likely_its_textbook_form_is(share):
    forms = library.build(
        readings(1), [dataclasses.replace(ADAPTING, textbook_share=share)]
    )
    plain_forms = [
        a for a in forms.atoms if not any("more" in forms.names[c] for c in a.columns)
    ]
    assert np.exp([a.log_weight for a in plain_forms]).sum() == pytest.approx(share)


def test_limbs_of_unequal_kinds_are_not_alike():
    lame = dataclasses.replace(
        TWINS, columns=lambda state, turns: list(_more(state, turns))[:3]
    )
    forms = library.build(readings(1), [lame])
    assert not [n for n in forms.names if "all legs" in n]


@pytest.mark.parametrize(
    ("sizes", "alike"), [((1.0, 1.1), True), ((1.0, -1.0), False), ((1.0, 0.0), False)]
)
def test_evidence_is_for_what_limbs_are(sizes, alike):
    """Limbs that are alike are likelier so; else the even chance of it is lost."""
    problem = planted(
        readings(3), LOOSE, {"leg 1": sizes[0], "leg 2": sizes[1]}, turns=2.0
    )
    gain = _evidence(problem, TWINS) - _evidence(problem, LOOSE)
    assert gain > 0.2 if alike else -np.log(2.0) - 0.01 < gain < 0.1


def _evidence(problem: GapProblem, effect: Effect) -> float:
    hypotheses = search_of(problem, [effect]).run()
    return next(h for h in hypotheses if h.effects).log_evidence
