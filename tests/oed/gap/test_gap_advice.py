"""What to do next: the beginning of each sentence, in order."""

import dataclasses

import pytest

from kernel.gap_lines import BOW, DRIFT, SLIP
from oed.gap.cause.answers import advise
from oed.result import UNKNOWN, AnswerRecord


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
