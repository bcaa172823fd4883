"""What to do next."""

import dataclasses

from kernel.gap_lines import BOW, DRIFT, SLIP
from oed.gap.cause.answers import advise
from oed.result import UNKNOWN, AnswerRecord

EFFECTS = (BOW, SLIP, DRIFT)


def _answer(probability: float, *effects: str) -> AnswerRecord:
    return AnswerRecord(
        effects, probability, tuple((e,) for e in effects if e != UNKNOWN)
    )


def test_a_sure_cause_is_answered_with_its_remedy() -> None:
    assert advise([_answer(0.95, "bow"), _answer(0.05)], EFFECTS, {}) == (
        "bow: straighten.",
    )


def test_an_unsure_cause_is_answered_with_the_reading_that_tells_its_rival() -> None:
    advice = advise([_answer(0.6, "bow"), _answer(0.4, "slip")], EFFECTS, {})
    assert advice == (
        "To make sure that it is not slip: both ways.",
        "If it is bow: straighten.",
    )


def test_an_effect_that_acts_whatever_is_beside_it_has_its_remedy() -> None:
    oiled = dataclasses.replace(SLIP, remedy="oil")
    answers = [_answer(0.5, "bow", "slip"), _answer(0.4, "bow"), _answer(0.1)]
    advice = advise(answers, (BOW, oiled, DRIFT), {})
    assert {"bow: straighten.", "If it is slip: oil."} <= set(advice)


def test_an_unsure_cause_is_read_again_for_what_may_act_beside_it() -> None:
    advice = advise([_answer(0.6, "bow"), _answer(0.4, "bow", UNKNOWN)], EFFECTS, {})
    assert advice == (
        "bow: straighten.",
        "Something of unknown form may act beside it: read again after a remedy.",
    )


def test_a_rival_that_is_any_of_many_is_not_tested_by_name() -> None:
    many = ("slip", *(f"slip {k}" for k in range(6)))
    rival = AnswerRecord(("slip", UNKNOWN), 0.4, (many,))
    advice = advise([_answer(0.6, UNKNOWN), rival], EFFECTS, {})
    assert len(advice) == 1
    assert advice[0].startswith("Something acts that no effect of the library explains")
    unsure = advise([_answer(0.5, UNKNOWN), _answer(0.3, "bow"), _answer(0.2)], (), {})
    assert unsure[0].startswith("Noise alone has a probability of 20 %: read again")
    assert unsure[1].startswith("Something may act that no effect of the library")


def test_a_class_of_many_is_not_listed_effect_by_effect() -> None:
    names = tuple(f"slip {k}" for k in range(6))
    effects = [dataclasses.replace(SLIP, name=name) for name in names]
    answer = AnswerRecord(names[:1], 0.9, (names,))
    assert advise([answer], effects, {}) == (
        "These readings cannot tell 6 effects apart. What would help first: both ways.",
    )


def test_a_gap_that_noise_may_be_is_to_be_read_again() -> None:
    advice = advise([_answer(0.3, "slip"), _answer(0.66)], EFFECTS, {})
    assert "Noise alone has a probability of 66 %" in advice[0]
    assert "both ways" in advice[0]
    assert (
        "Noise alone" in advise([_answer(0.5, UNKNOWN), _answer(0.5)], EFFECTS, {})[0]
    )


def test_no_gap_asks_for_what_was_not_recorded() -> None:
    advice = advise(
        [_answer(0.9), _answer(0.1, "bow")],
        EFFECTS,
        {"drift": "the readings do not have time"},
    )
    assert advice[-1] == (
        "These readings cannot test all effects. Record with the next ones, and vary: time."
    )


def test_what_is_too_small_to_be_seen_is_no_rival() -> None:
    """No effect of it is advised to be tested, and no gap is as sure with it."""
    unseen = AnswerRecord(("slip",), 0.3, (("slip", "bow"),), unseen=0.3)
    sure = advise([_answer(0.6), unseen, _answer(0.1, "bow")], EFFECTS, {})
    assert not any("make sure" in sentence for sentence in sure)
    advice = advise([_answer(0.4), unseen, _answer(0.25, "slip")], EFFECTS, {})
    assert advice[-1] == "To make sure that it is not slip: both ways."


def test_geometry_is_compensated_where_no_effect_and_no_unstated_noise_is_probable() -> (
    None
):
    sure = [_answer(0.97), _answer(0.03, "bow")]
    sure_advice, *_ = advise(sure, EFFECTS, {})
    assert "compensate the geometry" in sure_advice
    doubtful = advise([_answer(0.92), _answer(0.08, "bow")], EFFECTS, {})
    assert doubtful[0] == sure_advice
    assert doubtful[1].startswith(
        "An effect is not excluded (probability 8 %): one run"
    )
    noisy = advise(sure, EFFECTS, {}, unstated=1.83)
    assert noisy[0].startswith("A reading scatters 1.8 times as much as stated")


def test_what_is_unknown_may_be_what_could_not_be_tested() -> None:
    lost = {
        "drift": "the readings do not have time",
        "leg_warm": "the readings do not have time or temp_leg",
        "slack": "the readings do not have direction: both",
        "slip": "it changes none of these readings",
    }
    advice = advise([_answer(0.95, UNKNOWN), _answer(0.05)], EFFECTS, lost)
    assert (
        advice[-1]
        == "What acts may be what these readings cannot test: record and vary direction"
        " and time."
    )
    assert not any(
        "ecord" in t
        for t in advise([_answer(0.95, "bow"), _answer(0.05)], EFFECTS, lost)
    )


def test_what_would_show_an_effect_names_it_beside_noise_alone() -> None:
    """Not `it`, which could be the noise."""
    effects = (dataclasses.replace(BOW, exposed_by="a straightedge"), SLIP, DRIFT)
    words = " ".join(advise([_answer(0.6, "bow"), _answer(0.3)], effects, {}))
    assert (
        "Noise alone has a probability of 30 %: read again before you correct anything. What"
        " would show bow: a straightedge."
    ) in words
