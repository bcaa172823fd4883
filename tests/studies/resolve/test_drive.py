"""Gears, zeros of joints and sizes of effects as a study declares them."""

from pathlib import Path

import effects_sample
import numpy as np
import pytest
import sample

from oed.effect_model import Effect
from pkm_studies import stages
from pkm_studies.base import InputError
from pkm_studies.resolve import GapRequest, resolve, study_machine
from pkm_studies.study import Study

STUDY = """\
schema = 1
name = "arm"
[machine]
model = "{model}"
{drive}
[[setup]]
name = "grid"
instrument = "{instrument}"
[noise]
read_x_um = 5
read_y_um = 5
[posterior]
enabled = false
[gap]
effects = ["gear_eccentricity", "screw_cyclic", "encoder_scale", "backlash"]
[report]
html = false
pdf = false
"""


def study(
    folder: Path,
    drive: str,
    model: str = "five_bar",
    instrument: str = "planar_position",
) -> Study:
    path = folder / "arm.study.toml"
    path.write_text(STUDY.format(drive=drive, model=model, instrument=instrument))
    return Study.load(path)


@pytest.mark.parametrize(("drive", "ratios"), [
    ('drive = { kind = "gear", ratio = 63 }', (1.0, 63.0)),
    ('drive = { kind = "gear", stages = [7, 9] }', (1.0, 7.0, 63.0)),
    ('drive = { kind = "belt", ratio = 2.5 }', (1.0, 2.5)),
])  # fmt: skip
def test_wheels_turn_as_the_drive_states(drive, ratios, tmp_path):
    """The wheel at the joint, then each further stage."""
    arm = study(tmp_path, drive)
    request = GapRequest.from_study(arm, study_machine(arm))
    effects = {e.name: e for e in request.effects}
    assert effects["gear_eccentricity"].constants == {"ratio": ratios}
    assert resolve(arm, readings=()).machine.drive in drive


def test_a_drive_without_numbers_tries_usual_ones(tmp_path):
    arm = study(tmp_path, 'drive = { kind = "gear" }')
    request = GapRequest.from_study(arm, study_machine(arm))
    effects = {e.name: e for e in request.effects}
    assert len(effects["gear_eccentricity"].constants["ratio"]) > 5


def test_the_lead_of_a_screw(tmp_path):
    text = 'drive = { kind = "screw", lead_mm = 7 }'
    head = study(tmp_path, text, "planar_2dof", "rm5")
    request = GapRequest.from_study(head, study_machine(head))
    effects = {e.name: e for e in request.effects}
    assert effects["screw_cyclic"].constants["pitch"] == pytest.approx((7e-3,))


@pytest.mark.parametrize(("model", "drive", "reason"), [
    ("five_bar", '{ kind = "screw", ratio = 3 }', r"drive\.ratio: a screw on the"),
    ("five_bar", '{ kind = "gear", lead_mm = 5 }', r"drive\.lead_mm: a gear"),
    ("linear_delta", '{ kind = "gear", ratio = 5 }', r"drive\.ratio: a gear on the"),
    ("five_bar", '{ kind = "gear", ratio = 6, stages = [2, 3] }', r"given as well"),
    ("five_bar", '{ kind = "gear", teeth = 3 }', r"teeth"),
    ("five_bar", '{ kind = "gear", ratio = 0 }', r"drive\.ratio"),
    ("five_bar", '{ kind = "worm" }', r"machine\.drive"),
])  # fmt: skip
def test_what_no_drive_has(model, drive, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        study_machine(study(tmp_path, f"drive = {drive}", model))


def tool(angles: np.ndarray) -> np.ndarray:
    """Tool points (n, 2), m, of a five-bar by the circles of its struts."""
    centres = np.array([[-0.1, 0.0], [0.1, 0.0]])
    knees = centres + 0.2 * np.stack([np.cos(angles), np.sin(angles)], axis=2)
    between = knees[:, 1] - knees[:, 0]
    half = np.linalg.norm(between, axis=1, keepdims=True) / 2.0
    across = np.column_stack([-between[:, 1], between[:, 0]]) / (2.0 * half)
    return np.asarray(knees.mean(axis=1) + np.sqrt(0.3**2 - half**2) * across)


@pytest.mark.slow  # a whole diagnosis: 13 s
def test_the_diagnosis_finds_the_motor_gear(tmp_path):
    """63 turns a turn of the joint, which no usual single stage has."""
    turn = np.linspace(0.0, 1.0, 90)
    angles = np.column_stack(
        [np.radians(115.0 + 30.0 * turn), np.radians(60.0) + 0 * turn]
    )
    angles = np.vstack([angles, np.radians(180.0) - angles[:, ::-1]])
    wrong = 3e-4 * np.sin(63.0 * angles[:, :1] + 0.4) * [[1.0, 0.0]]
    rng = np.random.default_rng(1)
    read = tool(angles + wrong) + rng.normal(0.0, 5e-6, (len(angles), 2))
    names = "setup,run,order,q1_deg,q2_deg,read_x_mm,read_y_mm"
    rows = [
        f"grid,{1 + k // 90},{1 + k % 90},{np.degrees(a):.9f},{np.degrees(b):.9f},"
        f"{1e3 * x:.6f},{1e3 * y:.6f}"
        for k, ((a, b), (x, y)) in enumerate(zip(angles, read, strict=True))
    ]
    file = tmp_path / "arm.readings.csv"
    file.write_text("\n".join([names, *rows]))
    arm = study(tmp_path, 'drive = { kind = "gear", ratio = 63 }')
    gap = stages.diagnose_study(arm, [file], tmp_path / "out").gap
    best = gap.answers[0]
    assert tuple(best.effects) == ("gear_eccentricity",), gap.findings
    assert best.probability > 0.7


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
