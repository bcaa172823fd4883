"""One verdict on a fit."""

import msgspec
from result_sample import whole

from oed import trust
from oed.result import CorrectedSection, EstimateSection, GoodnessSection, StudyResult


def result_of(**sections: object) -> StudyResult:
    """The whole result with the fields of sections changed, or a section replaced."""
    plain = whole()
    for name, value in sections.items():
        is_table = isinstance(value, dict) and isinstance(plain.get(name), dict)
        plain[name] = {**plain[name], **value} if is_table else value
    return msgspec.json.decode(msgspec.json.encode(plain), type=StudyResult)


def good(*, checked: dict[str, object] | None = None, **changes: object) -> StudyResult:
    """A fit with residuals of the size of the noise, and changes."""
    figures = {"chi2": 20.0, "dof": 20.0, "p_low": 0.5, "p_high": 0.5}
    calm = {"goodness": {**figures, **(checked or {})}, "gap": None, "corrected": None}
    return result_of(**{**calm, **changes})


#: the answer that noise alone explains the readings
NOTHING = {"effects": [], "probability": 0.6, "classes": [], "unseen": 0.0}


def at_nominal(**value: float) -> dict[str, object]:
    """The estimate's parameters, of no known truth, where the first has a value."""
    parameters = whole()["estimate"]["parameters"]
    for one in parameters.values():
        one |= {"truth": None, "value": one["nominal"], "prior_sd": 1.0}
    first = next(iter(parameters))
    parameters[first] |= value
    return {"parameters": parameters}


def test_a_fit_like_its_noise_has_no_objection():
    assert trust.objections(good()) == []
    assert trust.objections(good(estimate=None)) == []


def test_a_fit_that_fails_its_check_is_objected_to():
    mistakes = [{"what": "in um, not in mm", "evidence": "1000 times"}]
    (mistaken,) = trust.objections(
        good(checked={"bad_fit": True, "mistakes": mistakes})
    )
    assert "in um, not in mm" in mistaken
    large = {"bad_fit": True, "chi2": 2000.0, "p_high": 0.0}
    (sentence,) = trust.objections(good(checked=large))
    assert "10.0 times the stated noise" in sentence


def test_parameters_far_from_nominal_are_named():
    near = good(estimate=at_nominal(value=3.9))
    far = good(estimate=at_nominal(value=-4.1))
    assert trust.objections(near) == []
    (sentence,) = trust.objections(far)
    assert next(iter(far.estimate.parameters)) in sentence  # type: ignore[union-attr]
    known = good(estimate=at_nominal(value=-4.1, truth=0.0))
    assert trust.objections(known) == []


def test_a_gap_bends_a_fit_without_it():
    """Unless all that rests on the result is over all hypotheses."""
    gap = whole()["gap"]
    (sentence,) = trust.objections(good(gap=gap | {"mixture": None}))
    assert "reports a gap (effect)" in sentence
    assert gap["mixture"] is not None
    assert trust.objections(good(gap=gap)) == []


def test_a_gap_that_is_less_likely_than_none_bends_nothing():
    gap = whole()["gap"]
    (first, *_) = gap["answers"]
    unlikely = gap | {"answers": [first | {"probability": 0.4, "unseen": 0.0}, NOTHING]}
    assert trust.objections(good(gap=unlikely)) == []


def test_rows_left_out_are_counted_in_words():
    row = {"setup": "s", "run": "1", "order": 1, "row": 2, "pull": 9.0}
    section = good(checked={"outliers": [row], "doubtful": [row, row]}).goodness
    assert isinstance(section, GoodnessSection)
    assert section.fit_words == " without the 1 row set aside"
    assert section.chi2_words == f"{section.fit_words} and without the 2 rows in doubt"
    assert GoodnessSection.without_rows(0, "set aside") == ""


def test_the_corrected_model_is_final_where_there_is_one():
    both, plain = result_of(), result_of(corrected=None)
    assert both.final_estimate is both.corrected
    assert isinstance(both.corrected, CorrectedSection)
    assert plain.final_estimate is plain.estimate
    assert isinstance(plain.estimate, EstimateSection)
    assert plain.final_prediction is plain.prediction
