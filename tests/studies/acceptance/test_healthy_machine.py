"""`oed verify` beside what a plan said of a healthy machine."""

from types import SimpleNamespace

import pytest
from shipped_models import planar_2dof

from oed.result import (
    AlternativePlan,
    PlanEffects,
    PlanSection,
    PromiseRecord,
    VerdictRecord,
    VerificationSection,
)
from pkm_studies.acceptance import verification
from pkm_studies.base import InputError

DEMANDS = {
    "z": PromiseRecord(promised=30.0, limit=36.0, power=0.9, uncertainty=6.0, unit="um")
}


def planned(*, effects: bool, machine: str = "a3") -> SimpleNamespace:
    """A result with a plan that leaves 40 um in z."""
    without = AlternativePlan(["bar"], [12], 30.0, 1.0, {"z_um": 55.0})
    allowed = PlanEffects(3, 2, without, {"z_um": 1.0}, "") if effects else None
    accuracy = {"z_um": 40.0, "theta_arcsec": 2.0}
    plan = PlanSection([], 30.0, [], accuracy=accuracy, effects=allowed)
    return SimpleNamespace(
        plan=plan, design=None, machine=SimpleNamespace(name=machine)
    )


def test_the_plan_says_what_a_healthy_machine_reaches():
    said = verification.healthy_accuracy(planned(effects=True), None, DEMANDS)
    assert said == {"z": 40.0}
    assert verification.healthy_accuracy(planned(effects=False), None, DEMANDS) == {}
    verdict = VerdictRecord(
        rms=60.0, max=90.0, limit=36.0, promised=30.0, unit="um", passed=False
    )
    section = VerificationSection(False, 6, {"z": verdict}, healthy=said)
    (sentence,) = verification.healthy_sentences(section)
    assert "40 um rms for a healthy machine" in sentence
    assert "1.5 times that" in sentence


def test_a_plan_without_effects_says_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr(
        verification, "load_result", lambda folder: planned(effects=False)
    )
    with pytest.raises(InputError, match="nothing of a healthy machine"):
        verification.healthy_accuracy(planned(effects=True), tmp_path, DEMANDS)


def test_a_plan_for_another_machine_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(
        verification,
        "load_result",
        lambda folder: planned(effects=True, machine="delta"),
    )
    with pytest.raises(InputError, match="a plan for the machine delta"):
        verification.healthy_accuracy(planned(effects=True), tmp_path, DEMANDS)


@pytest.mark.parametrize("option", ["--plan", "--promise", "--uncertainty"])
def test_what_a_test_is_planned_with_is_refused_with_its_readings(
    option, tmp_path, oed
):
    given = ("verify", tmp_path, "--readings", "acceptance.csv", option, "z_um=30")
    code, _, error = oed(*given)
    assert code == 2
    assert f"{option} = z_um=30" in error
    assert "when the test is planned" in error


@pytest.mark.parametrize(
    ("reference", "meaning"),
    [("best_fit", "one shift and turn"), ("home", "at home is subtracted")],
)
def test_the_form_says_what_an_error_is(reference, meaning):
    section = SimpleNamespace(
        poses=[{}], components={}, further={}, reference=reference
    )
    lines = list(verification._comments(section, planar_2dof.machine))
    assert [line for line in lines if meaning in line]
