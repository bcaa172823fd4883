"""What every effect must do on every machine, and how effects are named. One by one:
test_effects_by_hand.py.
"""

import dataclasses

import numpy as np
import pytest
from effects_sample import (
    CABLES,
    CARRIAGES,
    HERE,
    NAMES,
    REFERENCES,
    ROUND,
    columns,
    effect_of,
    session,
    small,
)

from kernel.cases import CASES
from oed.gap import GapProblem, exact_readings, untestable
from pkm_studies import catalogue
from pkm_studies import study as studies
from pkm_studies.base import InputError
from pkm_studies.resolve import machine
from pkm_studies.user_code import Origin

#: effects that only cables have, and those that they cannot have
OF_CABLES = {
    "cable_stretch", "cable_sag", "post_compliance", "pulley_radius", "drum_runout",
}  # fmt: skip
NEVER_OF_CABLES = {
    "screw_cyclic", "encoder_subdivision", "joint_runout", "joint_clearance",
    "pitch_accumulation",
}  # fmt: skip


def fits(machine: str, name: str) -> bool:
    if name == "guideway":
        return machine in CARRIAGES
    if name == "gear_eccentricity":
        return False  # none of these machines has rotary drives
    if name in OF_CABLES:
        return machine in CABLES
    return not (machine in CABLES and name in NEVER_OF_CABLES)


PAIRS = [(machine, name) for machine in CASES for name in NAMES]
FITTING = [(machine, name) for machine, name in PAIRS if fits(machine, name)]


# -- every effect ----------------------------------------------------------------------
def test_the_library_is_that_of_the_contract():
    entries = catalogue.listing("effects")
    assert sorted(e.name for e in entries) == sorted([*NAMES, *REFERENCES])
    assert all(e.where == f"pkm_models.effects.{e.name}:effect" for e in entries)


@pytest.mark.parametrize("name", [*NAMES, *REFERENCES])
def test_an_effect_says_what_it_is_and_what_to_do(name):
    effect = effect_of(name)
    # one short sentence each
    for text in (effect.about, effect.remedy, effect.exposed_by, effect.nature):
        assert 10 < len(text) <= 120
        assert not text.endswith(".")
        assert ". " not in text
    assert effect.source
    assert 0.0 < effect.textbook_share <= 1.0
    # a larger grid is looked through by turns, this one first
    first = next(iter(effect.constants.values()), ())
    assert len(effect.constant_grid()) <= (
        1000 if len(first) <= 64 < len(effect.constant_grid()) else 64
    )


#: columns a leg, of effects that adapt by more than 16
MANY = {"frame_bending": 26, "guideway": 20, "joint_runout": 32, "mount_drift": 22}


@pytest.mark.parametrize(("machine", "name"), PAIRS)
def test_it_fits_or_says_why_not(machine, name):
    reason = effect_of(name).unfit(CASES[machine].machine)
    assert (reason is None) == fits(machine, name)


@pytest.mark.parametrize(("drive", "reason"), [
    ("", None),
    ("screw", None),
    ("belt", "a belt moves each joint: it has no screws"),
    ("linear_motor", "a linear motor moves each joint: it has no screws"),
])  # fmt: skip
def test_a_screw_s_error_needs_a_screw(drive, reason):
    machine = dataclasses.replace(CASES["linear_delta"].machine, drive=drive)
    assert effect_of("screw_cyclic").unfit(machine) == reason


def test_the_drive_of_a_study_is_the_machine_s(tmp_path):
    """An unknown drive is refused with those that there are."""
    path = tmp_path / "my.study.toml"
    text = (
        'schema = 1\nname = "my"\nseed = 1\n[machine]\nmodel = "linear_delta"\n'
        'drive = "belt"\n[[setup]]\nname = "probe"\ninstrument = "height_probe"\n'
    )
    path.write_text(text, encoding="utf-8")
    assert machine.study_machine(studies.Study.load(path)).drive == "belt"
    path.write_text(text.replace("belt", "steam"), encoding="utf-8")
    with pytest.raises(InputError) as error:
        studies.Study.load(path)
    assert "drive" in str(error.value)
    assert "linear_motor" in str(error.value)


@pytest.mark.parametrize(("machine", "name"), FITTING)
def test_columns_are_finite_and_of_the_poses_length(machine, name):
    s = session(machine)
    for state in s.states:
        made = columns(name, state)
        legs = max(len(state.limbs), 3)
        assert 1 <= sum(not c.shape for c in made.values()) <= 6 * legs
        assert len(made) <= MANY.get(name, 16) * legs
        for c in made.values():
            assert c.scale > 0.0
            assert c.label in (
                "",
                f"set-up {state.setup}",
                *(f"leg {i + 1}" for i in state.limbs),
            )
            changes = [
                *c.joints.values(),
                *c.parameters.values(),
                *c.nuisances.values(),
                *c.reading.values(),
            ]
            assert changes
            assert all(
                v.shape == (len(state),) and np.isfinite(v).all() for v in changes
            )


@pytest.mark.parametrize(("machine", "name"), FITTING)
def test_the_signature_is_the_slope_of_the_exact_machine(machine, name, rng):
    """The error of first order falls with the square of the size."""
    s, effect = session(machine), effect_of(name)
    points = [
        p
        for p in effect.constant_grid()
        if any(True for _ in effect.columns(s.states[0], **p))
    ]
    point = points[len(points) // 2]
    found = GapProblem.signature(s, effect, point)
    assert found.names
    assert np.isfinite(found.columns).all()
    drawn = rng.standard_normal(len(found.names))
    theta = s.measurement.nominal
    zero = s.measurement.readings(s.series, s.measurement.nominal)
    errors = []
    for size in (4.0, 2.0):
        factors = {n: size * d for n, d in zip(found.names, drawn, strict=True)}
        real = (
            exact_readings(
                s.measurement, s.series, theta, s.states, [(effect, point, factors)]
            )
            - zero
        )
        first = found.columns @ (size * drawn)
        errors.append(np.linalg.norm(real - first))
        assert errors[-1] < 0.02 * np.linalg.norm(real) + 1e-11
    assert errors[1] < 0.3 * errors[0] + 1e-11


@pytest.mark.parametrize("name", [n for n in NAMES if n != "gear_eccentricity"])
def test_without_covariates_it_is_not_testable_or_does_without(name):
    wanted = {
        "leg_thermal": "time or temp_leg or temp_leg1",
        "frame_thermal": "time or temp_frame", "bar_thermal": "time or temp_bar",
        "mount_drift": "time", "step": "time", "backlash": "direction: both",
        "friction": "direction: both", "servo_lag": "feed", "cable_stretch": "tension",
        "cable_sag": "tension", "post_compliance": "tension",
    }  # fmt: skip
    machine = "cable_robot" if name in OF_CABLES else "planar_2dof"
    bare, full = session(machine, ()), session(machine)
    assert untestable(effect_of(name), full.states) is None
    reason = untestable(effect_of(name), bare.states)
    if name in wanted:
        assert reason == f"the readings do not have {wanted[name]}"
    else:
        assert reason is None
    for (
        state
    ) in bare.states:  # nor does one set-up without them spoil a session that has them
        for c in columns(name, state).values():
            assert all(
                np.isfinite(v).all()
                for v in (
                    *c.joints.values(),
                    *c.nuisances.values(),
                    *c.reading.values(),
                )
            )


def test_one_direction_alone_shows_no_backlash():
    state = session("a3_head").states[0]
    one = small(state, ROUND)
    assert (
        untestable(effect_of("backlash"), [one])
        == "the readings do not have direction: both"
    )
    assert untestable(effect_of("backlash"), [state]) is None


def test_a_temperature_stands_for_time():
    warm = session("planar_2dof", ("temp_leg",))
    assert untestable(effect_of("leg_thermal"), warm.states) is None
    assert untestable(effect_of("frame_thermal"), warm.states) is not None


@pytest.mark.parametrize("name", [
    "leg_thermal", "gravity", "friction", "joint_runout", "joint_clearance", "guideway",
])  # fmt: skip
def test_a_machine_without_struts_is_told(name):
    machine = dataclasses.replace(CASES["a3_head"].machine, struts=None)
    assert (
        effect_of(name).unfit(machine)
        == "it does not tell its struts: give Machine.struts"
    )
    # the tool is displaced, whatever carries it
    assert effect_of("frame_bending").unfit(machine) is None


# -- names in a study ------------------------------------------------------------------
OWN = """\
import numpy as np

from oed.effect_model import Column, Effect

effect = Effect(
    name="wind", source="the weather", about="wind on the head", columns=lambda state: [Column("wind", 1e-6)]
)
"""


def test_an_effect_of_ones_own(tmp_path):
    (tmp_path / "wind.py").write_text(OWN, encoding="utf-8")
    assert catalogue.effect("wind.py", Origin(tmp_path), HERE).name == "wind"
    assert (
        catalogue.effect("wind.py:effect", Origin(tmp_path), HERE).about
        == "wind on the head"
    )
    assert catalogue.effect(
        "pkm_models.effects.backlash:effect", Origin(tmp_path), HERE
    ) is effect_of("backlash")


@pytest.mark.parametrize(("column", "words"), [
    ("joints={9: state.time}", "joint index 9, but the machine has 0 to 2"),
    ("reading={'*': 1.0}", r"reading\['\*'\] has shape \(\), and not a number"),
    ("joints={0: 0.0 * state.time / 0.0}", r"joints\[0\] is not finite"),
])  # fmt: skip
def test_a_column_that_fits_no_pose_is_refused(column, words, tmp_path):
    own = OWN.replace('Column("wind", 1e-6)', f'Column("wind", 1e-6, {column})')
    (tmp_path / "wind.py").write_text(own, encoding="utf-8")
    effect = catalogue.effect("wind.py", Origin(tmp_path), HERE)
    state = session("a3_head").states[0]
    with np.errstate(invalid="ignore"), pytest.raises(InputError, match=words):
        list(effect.columns(state))


def test_a_need_that_no_reading_records_is_refused():
    with pytest.raises(ValueError, match="no reading records tiem"):
        dataclasses.replace(effect_of("backlash"), needs=("time or tiem",))


@pytest.mark.parametrize(("reference", "words"), [
    ("backlesh", "no such effect; did you mean backlash?"),
    ("wind.py:storm", "there is no storm in it"),
    ("pkm_models.machines.a3_head:machine", "machine is no Effect"),
    ("calm.py", "there is no such file"),
])  # fmt: skip
def test_a_wrong_name_is_told(reference, words, tmp_path):
    (tmp_path / "wind.py").write_text(OWN, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        catalogue.effect(reference, Origin(tmp_path), HERE)
    assert words in str(caught.value)
    assert "gap.effects" in str(caught.value)
