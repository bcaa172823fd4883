"""Claims of a study: paths into its result, and whether the values there meet them."""

from pathlib import Path

import pytest
import sample

from pkm_studies import study
from pkm_studies.results import check_claims, value_at

RESULT = {
    "identifiability": {"rank": 18, "words": [{"kind": "seen", "text": "all"}], "ok": True},
    "design": {"plans": [{"name": "paper 2 x 15", "kappa": 3748.0}, {"name": "v1.2", "kappa": float("nan")}]},
    "estimate": {"parameters": {"cup.cup_x": {"value": 0.01}, "cup": {"value": 3.0}}, "bound": None},
    "kappa_maps": [{"title": "taught", "kappa": [[1.0, 2.0], [3.0, 4.0]]}],
}  # fmt: skip


@pytest.mark.parametrize(("path", "value"), [
    ("identifiability.rank", 18),
    ("design.plans.paper 2 x 15.kappa", 3748.0),
    ("design.plans[0].kappa", 3748.0),
    ("design.plans.0.name", "paper 2 x 15"),
    ("estimate.parameters.cup.cup_x.value", 0.01),
    ("estimate.parameters.cup.value", 3.0),
    ("kappa_maps.taught.kappa[1][0]", 3.0),
])  # fmt: skip
def test_paths_lead_to_results(path, value):
    assert value_at(RESULT, path) == value


@pytest.mark.parametrize(("claim", "met"), [
    ('of = "identifiability.rank", equals = 18', True),
    ('of = "identifiability.rank", equals = 17', False),
    ('of = "identifiability.rank", min = 17.5, max = 18', True),
    ('of = "identifiability.rank", max = 17', False),
    ('of = "identifiability.ok", equals = true', True),
    ('of = "identifiability.ok", equals = 1', False),
    ('of = "identifiability.words", contains = "all"', True),
    ('of = "identifiability.words", min = 1', False),
    ('of = "design.plans.v1.2.kappa", max = 5000', False),
    ('of = "estimate.bound", max = 1', False),
    ('of = "identifiability.rang", equals = 18', False),
])  # fmt: skip
def test_claims_are_measured(claim, met):
    parsed = study.Study.parse(
        sample.STUDY.split("[expect]")[0] + f"[expect]\nit = {{ {claim} }}\n", Path("x")
    )
    (checked,) = check_claims(parsed, RESULT)
    assert checked.met is met
    assert checked.claim == "it"


def test_an_unknown_path_says_what_there_is():
    with pytest.raises(
        LookupError, match=r"no such result: design.plan.0: .* did you mean plans"
    ):
        value_at(RESULT, "design.plan.0")


def test_a_claim_has_the_unit_of_its_figure_alone():
    """A share that stands in one table with a unit has none."""
    result = {"held_out": [{"name": "S1", "rms": 58.2, "coverage": 0.93, "unit": "um"}]}
    expect = (
        '[expect]\nrms = { of = "held_out.S1.rms", max = 50 }\n'
        'share = { of = "held_out.S1.coverage", min = 0.95 }\n'
    )
    text = sample.STUDY[: sample.STUDY.index("[expect]")] + expect
    rms, share = check_claims(study.Study.parse(text, Path("a.study.toml")), result)
    where = "a.study.toml:3 [expect]"
    expected = f"rms: measured 58.2 um, claimed held_out.S1.rms <= 50 um ({where})"
    assert rms.failure(where) == expected
    expected = f"share: measured 0.93, claimed held_out.S1.coverage >= 0.95 ({where})"
    assert share.failure(where) == expected
