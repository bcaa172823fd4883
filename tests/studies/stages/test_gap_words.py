"""Sentences of a diagnosis: cause, place, closure, next steps."""

from typing import Any

import pytest

from oed.result import (
    AnswerRecord,
    ClosureRecord,
    CoefficientRecord,
    EffectNote,
    GapSection,
    PlaceRecord,
    SizeRecord,
)
from oed.text import format_probability
from pkm_studies.stages.gap.sentences import add_sentences, second_explanation


def _gap(
    verdict: str, effects: list[str], classes: list[list[str]], **more: Any
) -> GapSection:
    about = {
        "gravity": EffectNote("legs that give", "stiffen the legs", "a payload", "s"),
        "encoder_scale": EffectNote("scale", "measure the scale", "two bars", "s"),
        "servo_lag": EffectNote(
            "lag",
            "tune",
            "two feeds",
            "s",
            "the readings do not have feed",
            "feed_mm_min",
        ),
    }
    fields: dict[str, Any] = {
        "verdict": verdict,
        "answers": [AnswerRecord(effects, 0.9, classes)],
        "set95": [],
        "where": [PlaceRecord("time 600-1200", 0.0002), PlaceRecord("leg 1", 0.3)],
        "closure": [ClosureRecord("whole", 0.8, 0.6, 0.9, 0.01, 2.0, 1.2, 1.0, 90)],
        "not_testable": ["servo_lag"],
        "confusable": [],
        "selected": [n for n in effects if n != "unknown"],
        "tried": list(about), "marginal": {}, "about": about, "coefficients": [],
        "sizes": [
            SizeRecord(n, {"length": 12.34}, 20.0, {"length": 1.07})
            for n in effects
            if n != "unknown"
        ],
        "noise": [], "units": {"length": "um"}, "rms_before": {}, "rms_after": {},
        "traces": [], "spots": [], "spots_unit": "um", "words": [],
        "next": ["Look again."],
    }  # fmt: skip
    return add_sentences(GapSection(**fields | more))


def of_gravity(**more: Any) -> GapSection:
    """A diagnosis that names gravity."""
    return _gap("effect", ["gravity"], [["gravity"]], **more)


def test_no_gap_in_words():
    words = _gap("none", [], []).words
    assert (
        words[0] == "No effect is found: noise alone explains what calibration leaves"
        " (probability 90 %)."
    )
    assert len(words) == 2  # the other one is about what could not be tested


def test_an_effect_in_words():
    section = of_gravity()
    assert section.words == [
        "The residual error comes from gravity (probability 90 %).",
        (
            "Gravity changes length by 12.3 um rms; calibration leaves 1.1 um (9 %) of"
            " that."
        ),
        "It shows most in the time from 10 min to 20 min.",
        (
            "With gravity in the model, the mean square of what calibration leaves"
            " beyond the noise shrinks by 80 % (60 to 90 %) on whole held-out runs."
        ),
        (
            "Not tested, because the readings lack a column: servo lag (record"
            " feed_mm_min)."
        ),
    ]
    assert section.next == ["Look again.", "Remedy for gravity: stiffen the legs."]


def test_an_effect_at_a_size_that_no_machine_has_is_left_out_with_its_reason():
    more = {"left_out": ["leg_thermal"], "nearest": ["leg_thermal", "step"]}
    words = " ".join(
        _gap("unknown", ["unknown"], [], unknown={"drift": 1.0}, **more).words
    )
    assert "Leg thermal would fit, but only at a size that no machine has" in words
    assert "can test, at a size that a machine can have." in words
    assert "Known causes of that kind: step;" in words


def test_a_class_in_words():
    section = _gap("class", ["gravity"], [["gravity", "encoder_scale"]])
    assert section.words[0].startswith(
        "The residual error comes from gravity or encoder scale; these readings cannot tell which"
    )
    assert "To tell encoder scale from the others: two bars." in section.next
    assert "If it is gravity: stiffen the legs." in section.next


def test_a_class_of_many_is_told_by_what_its_effects_have_in_common():
    names = ["leg_thermal", "frame_thermal", "bar_thermal", "mount_drift", "step"]

    def words(natures: list[str]) -> str:
        notes = {
            name: EffectNote("about", "remedy", "test", "s", nature=nature)
            for name, nature in zip(names, natures, strict=True)
        }
        return _gap("class", names[:1], [names], about=notes, not_testable=[]).words[0]

    alike = words(["something that warms"] * 5)
    assert alike.startswith(
        "The residual error comes from something that warms: any of 5 effects; these readings"
        " cannot tell which"
    )
    assert words([*["something that warms"] * 4, "a sudden change"]).startswith(
        "The residual error comes from one of 5 effects: something that warms (4) or a sudden"
        " change (1); these readings"
    )
    assert "leg thermal, frame thermal" in words([""] * 5)


def test_mixtures_and_unknowns_in_words():
    both = _gap(
        "mixture", ["gravity", "encoder_scale"], [["gravity"], ["encoder_scale"]]
    ).words[0]
    assert both.startswith(
        "The residual error comes from gravity and encoder scale together"
    )
    with_unknown = _gap("mixture", ["gravity", "unknown"], [["gravity"]]).words[0]
    assert with_unknown.startswith("Part of the residual error comes from gravity")
    assert with_unknown.endswith("a remainder has a form that no known effect has.")
    unknown = _gap("unknown", ["unknown"], []).words[0]
    assert "no known effect explains" in unknown
    assert "2 effects" in unknown


def test_an_effect_beside_an_unknown_one_is_the_same_cause():
    """Its probability counts both; what is named elsewhere, or unseen, is another."""
    answers = [
        AnswerRecord(("gravity",), 0.54, (("gravity",),)),
        AnswerRecord(("gravity", "unknown"), 0.25, (("gravity",),)),
        AnswerRecord(("servo_lag",), 0.11, (("servo_lag",),)),
        AnswerRecord(("gravity",), 0.1, (("gravity", "servo_lag"),), unseen=0.1),
    ]
    words = _gap("effect", ["gravity"], [], answers=answers).words
    assert (
        words[0] == "The residual error probably comes from gravity (probability 79 %)."
    )
    beside = words.index(
        "An effect of unknown form may act beside it (probability 25 %)."
    )
    assert words[beside + 1] == (
        "The next most likely explanation is servo lag (probability 11 %)."
    )
    mixed = _gap("mixture", ["gravity"], [], answers=[answers[1], answers[0]]).words
    assert mixed[0] == (
        "Part of the residual error probably comes from gravity (probability 79 %); a remainder has a form"
        " that no known effect has (probability 25 %)."
    )
    assert not any("beside it" in sentence for sentence in mixed)


def test_an_unknown_effect_is_as_probable_as_all_answers_with_one():
    """Its place is where to look first; a rival that is any of many has no name."""
    many = ("gravity", *(f"effect_{k}" for k in range(6)))
    answers = [
        AnswerRecord(("unknown",), 0.57),
        AnswerRecord(("gravity", "unknown"), 0.31, (many,)),
        AnswerRecord((), 0.12),
    ]
    section = _gap("unknown", ["unknown"], [], answers=answers)
    assert section.words[0].startswith(
        "There is a residual error that no known effect explains (probability 88 %)"
    )
    assert section.words[1:3] == [
        "Any of 7 effects may act beside it (probability 31 %).",
        "The next most likely explanation is noise alone (probability 12 %).",
    ]
    unsure = _gap("unknown", ["unknown"], [], answers=[AnswerRecord(("unknown",), 0.4)])
    assert unsure.words[0].startswith(
        "There may be a residual error that no known effect"
    )
    assert "Look first at the time from 10 min to 20 min." in section.next
    spread = _gap("unknown", ["unknown"], [], where=[PlaceRecord("leg 1", 0.3)]).next
    assert not any("Look first" in step for step in spread)


def test_a_clear_effect_stands_before_a_class():
    classes = [["gravity", "encoder_scale"], ["servo_lag"]]
    section = _gap("class", ["gravity", "servo_lag"], classes)
    assert section.words[0].startswith(
        "The residual error comes from servo lag, and gravity or encoder scale; these readings"
    )
    answers = [
        AnswerRecord(("gravity", "servo_lag"), 0.52, classes),
        AnswerRecord(("gravity",), 0.41, classes[:1]),
    ]
    parts = _gap("class", ["gravity", "servo_lag"], classes, answers=answers).words
    assert parts[0] == (
        "The residual error probably comes from servo lag (probability 52 %), and gravity or encoder scale"
        " (probability 93 %); these readings cannot tell which (probability 52 %)."
    )
    assert any("explanation is gravity or encoder scale (pro" in w for w in parts)
    assert section.words[1].startswith("If it is gravity, it changes length by 12.3 um")
    assert section.words[2].startswith("Servo lag changes length by 12.3 um rms")


def test_no_gap_in_doubt_names_the_way_to_a_second_session():
    for probability, in_doubt in ((0.04, False), (0.08, True)):
        answers = [
            AnswerRecord((), 0.6),
            AnswerRecord(("gravity",), 0.3, (("gravity", "servo_lag"),), unseen=0.3),
            AnswerRecord(("unknown",), probability),
        ]
        section = _gap("none", [], [], answers=answers)
        assert any("--after DIR" in text for text in section.next) == in_doubt


def test_what_an_unknown_effect_resembles():
    """The likeliest form, and others that matter; nothing where there is none."""
    waves = {"leg 2 in a wave of 12 min": 0.62}
    forms = waves | {"the tool about the place 1, 2, 3 mm": 0.3, "drift": 0.04}
    gap = _gap("unknown", ["unknown"], [], unknown=forms, nearest=["step"])
    sentence, kinds = gap.words[1:3]
    assert (
        sentence
        == "What no known effect explains most resembles: leg 2 in a wave of 12 min"
        " (probability 62 %); or the tool about the place 1, 2, 3 mm (probability"
        " 30 %)."
    )
    assert kinds.startswith("Known causes of that kind: step;")
    single = _gap("unknown", ["unknown"], [], unknown={"drift": 0.06})
    assert single.words[1].endswith("drift (probability 6 %).")
    assert not any("resembles" in w for w in _gap("unknown", ["unknown"], []).words)


@pytest.mark.parametrize(("places", "said"), [
    (
        [("leg 1", 0.01, 0.8), ("run 2", 0.01, 0.7), ("time 0-60", 0.01, 0.2)],
        "It shows most in leg 1 (80 % of it) and run 2 (70 % of it).",
    ),
    ([("leg 1", 0.2, 0.5)], "No leg, set-up, run, time"),
    (
        [("set-up ruler", 0.01, 0.98, "time 0-1800")],
        "It shows most in set-up ruler or the time from 0 min to 30 min, which are the same readings (98 % of it).",
    ),
])  # fmt: skip
def test_places_that_hold_much_of_the_gap_are_named(places, said):
    """A set-up that was read in one stretch of time is that too."""
    words = of_gravity(where=[PlaceRecord(*place) for place in places]).words
    assert words[2].startswith(said)


def test_of_several_channels_each_has_its_amounts():
    sizes = [SizeRecord("gravity", {"y": 3.0, "a": 0.5}, 9.0, {"y": 3.4, "a": 0.1})]
    units = {"y": "um", "a": "arcsec"}
    words = of_gravity(sizes=sizes, units=units).words
    assert (
        words[1] == "Gravity changes y by 3 um rms and a by 0.5 arcsec rms; after"
        " calibration there remain 3.4 um of y and 0.1 arcsec of a."
    )


def _coefficient(value: float, **more: Any) -> CoefficientRecord:
    return CoefficientRecord(
        "encoder_scale", "leg 1", "leg 1", value, 7e-5, "1", 50e-6, **more
    )


def test_a_coefficient_far_beyond_its_expected_size_is_marked():
    """With the figure and what to check; no other is, nor one of its form alone."""

    def marked(*coefficients: CoefficientRecord) -> list[str]:
        section = _gap(
            "effect",
            ["encoder_scale"],
            [["encoder_scale"]],
            coefficients=list(coefficients),
            about={
                "encoder_scale": EffectNote("scale", "r", "e", "s", check="the lead")
            },
        )
        return [w for w in section.words if "implausible" in w]

    assert marked(_coefficient(-0.0599), _coefficient(-0.001)) == [
        "Encoder scale: leg 1 is -5.99 % (sd 70 ppm), 1200 times the 50 ppm expected."
        " That is implausible: check the lead."
    ]
    assert marked(_coefficient(2e-4)) == []
    assert marked(_coefficient(-0.0599, shape=True)) == []


@pytest.mark.parametrize(("closures", "said"), [
    ([(0.3, 0.35, 49.55)], ["(35 to 100 %) on whole held-out runs"]),
    ([(0.3, -7.0, 0.4)], ["(over 100 % more to 40 % less) on whole held-out runs"]),
    ([(0.3, -0.2, 1.2)], ["(20 % more to 100 % less) on whole held-out runs"]),
    ([(0.766, None, None)], ["shrinks by 77 % on whole"]),
    ([(0.9996, 0.9984, 1.0002)], ["shrinks by 99.9 % (99.8 to 100.0 %) on"]),
    ([(1.19, 0.8, 2.4)], ["shrinks by all that exceeds the noise (80 to 100 %) on"]),
    (
        [(0.8, 0.6, 0.9), (-0.21, -0.5, 0.1)],
        [
            "shrinks by 80 % (60 to 90 %) on held-out stretches of runs.",
            "grows by 21 % (50 % more to 10 % less) on whole",
        ],
    ),
])  # fmt: skip
def test_what_is_held_out_shrinks_or_grows(closures, said):
    """Never as a whole; an interval ends at the whole, and says what is growth."""
    splits = ("within", "whole")[-len(closures) :]
    records = [
        ClosureRecord(split, *closure, 0.1, 2.0, 1.2, 1.0, 9)
        for split, closure in zip(splits, closures, strict=True)
    ]
    words = of_gravity(closure=records).words[3:]
    for sentence, part in zip(words, said, strict=False):
        assert part in sentence
        assert ("grows" in part) != ("shrinks" in sentence)


@pytest.mark.parametrize(("lows", "proven"), [
    ((0.1, -0.2), True), ((-0.1, -0.2), False), ((None, -0.2), False), ((None,), True),
])  # fmt: skip
def test_what_no_held_out_reading_confirms_is_measured_first(lows, proven):
    closures = [
        ClosureRecord("whole", 0.3, low, 0.5, 0.1, 3.0, 2.4, 1.2, 200) for low in lows
    ]
    section = of_gravity(closure=closures)
    assert section.next[0].startswith("Measure before you exchange") != proven
    assert section.next[0].endswith("may do harm (probability 10 %).") != proven


def test_probabilities_under_one_noise_law_are_rough():
    for laws, rough in ((1.2, True), (1.6, False), (None, False)):
        words = of_gravity(effective_laws=laws).words
        assert any("probabilities are rough" in w for w in words) == rough


def test_an_open_answer_names_the_way_to_a_second_session():
    for verdict, probability, is_open in (
        ("effect", 0.9, False),
        ("effect", 0.7, True),
        ("class", 0.9, True),
        ("none", 0.6, False),
    ):
        effects = [] if verdict == "none" else ["gravity"]
        answers = [AnswerRecord(effects, probability, [effects])]
        section = _gap(verdict, effects, [effects], answers=answers)
        assert any("--after DIR" in text for text in section.next) == is_open


def test_advice_that_the_diagnosis_gives_is_not_given_twice():
    advice, named = ["encoder_scale: measure the scale."], ["encoder_scale"]
    section = _gap("effect", named, [named], next=advice)
    assert section.next == ["Encoder scale: measure the scale."]


@pytest.mark.parametrize(("share", "text"), [
    (1.0, "100 %"), (0.9999, "over 99 %"), (0.0001, "under 1 %"), (0.0, "0 %"),
    (0.734, "73 %"),
])  # fmt: skip
def test_a_probability_is_never_made_certain(share, text):
    assert format_probability(share) == text


def test_scatter_beyond_the_instrument_in_words():
    section = _gap("scatter", [], [], scatter=2.34, noise=["single readings scatter"])
    first, second, *_ = section.words
    assert first.startswith("The readings scatter 2.3 times as much as stated")
    assert second == "What scatters: single readings scatter."


# -- explanations beside the best one --------------------------------------------------
NOISE = "No effect is found: noise alone may explain what calibration leaves (probability 36 %)."
UNSEEN = (
    "More likely than noise alone is gravity (probability 38 %), but not than noise and"
    " what is too small to be seen together."
)
GRAVITY = (
    "The residual error may come from gravity (probability 30 %; noise alone 45 %)."
)
LIKELIER = "Noise alone is more likely, but not enough to exclude an effect."


@pytest.mark.parametrize(("verdict", "answers", "first", "second"), [
    ("none", [((), 0.36), ("gravity", 0.44, 0.06), ("unknown", 0.2, 0.14)], NOISE, UNSEEN),
    ("none", [((), 0.6), ("gravity", 0.4)], "", "The next most likely explanation is gravity (probability 40 %)."),
    ("effect", [("gravity", 0.3), ((), 0.45), ("unknown", 0.25, 0.25)], GRAVITY, LIKELIER),
])  # fmt: skip
def test_no_sentence_contradicts_the_probability_of_another(
    verdict, answers, first, second
):
    """No gap stands by noise and what is too small to be seen, 56 % together."""
    records = [
        AnswerRecord((name,) if name else (), share, ((name,),), unseen=sum(unseen))
        for name, share, *unseen in answers
    ]
    section = _gap(verdict, ["gravity"], [], answers=records, selected=[])
    assert section.words[0].startswith(first)
    assert second_explanation(section) == [second]
    assert not section.effect_likely
