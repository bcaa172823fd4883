"""Explanations beside the best one: no sentence contradicts another one's probability."""

import msgspec
import report_fixture
from result_sample import whole

from oed.result import AnswerRecord, GapSection
from pkm_studies.stages.gap.sentences import add_sentences, second_explanation


def _gap(verdict: str, answers: list[AnswerRecord]) -> GapSection:
    section = report_fixture.result_of(whole()).gap
    assert section is not None
    return msgspec.structs.replace(
        section, verdict=verdict, answers=answers, selected=[]
    )


def test_what_is_more_likely_than_noise_alone_is_not_the_next_most_likely():
    """No gap stands by noise and what is too small to be seen, 56 % together."""
    answers = [
        AnswerRecord((), 0.36),
        AnswerRecord(("gravity",), 0.44, (("gravity",),), unseen=0.06),
        AnswerRecord(("unknown",), 0.20, unseen=0.14),
    ]
    gap = add_sentences(_gap("none", answers))
    assert gap.words[0] == (
        "No effect is found: noise alone may explain what calibration leaves (probability"
        " 36 %)."
    )
    assert second_explanation(gap) == [
        "More likely than noise alone is gravity (probability 38 %), but not than noise"
        " and what is too small to be seen together."
    ]


def test_what_is_less_likely_than_noise_alone_is_the_next():
    answers = [AnswerRecord((), 0.6), AnswerRecord(("gravity",), 0.4, (("gravity",),))]
    assert second_explanation(_gap("none", answers)) == [
        "The next most likely explanation is gravity (probability 40 %)."
    ]


def test_a_gap_that_is_less_likely_than_noise_says_so_at_once():
    """The first sentence is all that the report's first page has of it."""
    answers = [
        AnswerRecord(("gravity",), 0.3, (("gravity",),)),
        AnswerRecord((), 0.45),
        AnswerRecord(("unknown",), 0.25, unseen=0.25),
    ]
    gap = add_sentences(_gap("effect", answers))
    assert gap.words[0] == (
        "The residual error may come from gravity (probability 30 %; noise alone 45 %)."
    )
    assert second_explanation(gap) == [
        "Noise alone is more likely, but not enough to exclude an effect."
    ]
    assert not gap.effect_likely
