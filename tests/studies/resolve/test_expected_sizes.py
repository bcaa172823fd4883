"""[effects] of a study: sizes expected of effects, in units of a user's choice."""

import effects_sample
import pytest
import sample

from oed.effect_model import Effect
from pkm_studies.base import InputError


def scales(effect: Effect) -> dict[str, float]:
    """Prior standard deviations of the coefficients on an A3 head, SI."""
    (state, *_) = effects_sample.session("a3_head").states
    constants = effect.constant_grid()[0]
    return {c.name: c.scale for c in effect.columns(state, **constants)}


def effects(text: str) -> dict[str, Effect]:
    resolved = sample.resolved(sample.STUDY + "[gap]\n" + text)
    return {e.name: e for e in resolved.gap.effects}


def test_a_stated_size_is_that_of_the_coefficients():
    """Textbook's ones have it; what adapts the form keeps its ratio; others stay."""
    usual = effects("")
    stated = effects("[effects]\nbacklash_mm = 0.03\nmount_drift_urad = 50\n")
    play, before = scales(stated["backlash"]), scales(usual["backlash"])
    assert play["leg 1"] == pytest.approx(30e-6)
    assert play.keys() == before.keys()
    for name, scale in play.items():
        assert scale == pytest.approx(3.0 * before[name]), name
    drift, before = scales(stated["mount_drift"]), scales(usual["mount_drift"])
    turned = {n for n in drift if stated["mount_drift"].unit(n) == "rad"}
    assert drift.keys() - turned
    for name, scale in drift.items():
        assert scale == pytest.approx((5.0 if name in turned else 1.0) * before[name])
    assert scales(stated["gravity"]) == scales(usual["gravity"])


def test_a_warm_leg_has_a_size_in_kelvin_and_one_per_kelvin():
    both = "[effects]\nleg_thermal_C = 1\nleg_thermal_ppm_per_C = 23\n"
    effect = effects(both)["leg_thermal"]
    for name, scale in scales(effect).items():
        if name in {f"leg {k} rise" for k in (1, 2, 3)}:
            assert scale == pytest.approx(1.0)
        if name in {f"leg {k} per kelvin" for k in (1, 2, 3)}:
            assert scale == pytest.approx(23e-6)


@pytest.mark.parametrize(("field", "words"), [
    ("gravty_um", "gravity_um"),
    ("backlash_C", "backlash_um"),
    ("backlash", "backlash_um"),
    ("leg_thermal_K", "leg_thermal_ppm_per_C, leg_thermal_C"),
])  # fmt: skip
@pytest.mark.parametrize("gap", ["", "[gap]\n"])
def test_a_field_that_is_no_size_is_refused(gap, field, words):
    with pytest.raises(InputError, match=r"effects\.") as caught:
        sample.resolved(f"{sample.STUDY}{gap}[effects]\n{field} = 1\n")
    assert caught.value.field == f"effects.{field}"
    assert words in str(caught.value)


def test_a_size_is_above_zero():
    with pytest.raises(InputError, match=r"effects\.gravity_um"):
        sample.resolved(f"{sample.STUDY}[effects]\ngravity_um = 0\n")
