"""[gap] of a study: its effects, its mistakes, and `oed diagnose` with its section."""

import contextlib
import dataclasses
import io
import json
from collections.abc import Iterator
from pathlib import Path

import gap_fixture
import msgspec
import numpy as np
import pandas as pd
import pytest
import sample

from oed import result
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.resolve import GapRequest
from pkm_studies.study import Study

#: the small study with half of its readings, where their number does not matter
FEW = sample.changed(gap_fixture.STUDY, ("count = 24", "count = 12"))
#: accuracy at two poses in place of a whole workspace
PREDICTION = """
[prediction]
z_mm = 1176.0
psi_deg = [0.0, 120.0]
theta_deg = 20.0
"""
pytestmark = pytest.mark.usefixtures("own_folder")


@pytest.fixture(scope="module", autouse=True)
def diagnosis_by_hand() -> Iterator[None]:
    """The search for effects has tests of its own.

    So has the accuracy over all hypotheses: few draws are as good here.
    """
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "oed.gap.procedure.diagnose",
            lambda problem, effects, rng: gap_fixture.diagnosis(problem),
        )
        patch.setattr("oed.corrected.answer_fits.N_DRAWS", 200)
        patch.setattr("oed.corrected.answer_fits.MIN_DRAWS", 60)
        yield


@pytest.fixture
def without_mixture(monkeypatch: pytest.MonkeyPatch) -> None:
    """The accuracy over all hypotheses has tests of its own, and takes half of the time."""
    monkeypatch.setattr("pkm_studies.stages.order.mix_answers", lambda state: state)


CLAIMS = """
[expect]
verdict = { of = "gap.verdict", equals = "effect" }
closed = { of = "gap.closure[0].low", min = 0.9 }
cause = { of = "gap.answers[0].effects", contains = "gravity" }
accuracy = { of = "prediction.components.z.after.rms", max = 1.0 }
"""


@dataclasses.dataclass(frozen=True)
class Diagnosed:
    """A study with claims, the folder of its diagnosis, and how the command ended."""

    study: Path
    folder: Path
    code: int
    err: str


@pytest.fixture(scope="module")
def virtual(tmp_path_factory: pytest.TempPathFactory) -> Diagnosed:
    """The diagnosis of readings of the virtual machine; of another seed than the study's."""
    folder = tmp_path_factory.mktemp("virtual")
    study = gap_fixture.written(folder, FEW + PREDICTION + CLAIMS)
    err, out = io.StringIO(), folder / "out"
    command = ["diagnose", str(study), "--out", str(out), "--quiet", "--seed", "8"]
    with contextlib.redirect_stderr(err):
        code = main(command)
    return Diagnosed(study, out, code, err.getvalue())


# -- the table ----------------------------------------------------------------------
def test_all_known_effects_are_tried_but_those_left_out():
    names = {e.name for e in sample.resolved(sample.STUDY + "[gap]\n").gap.effects}
    assert {"gravity", "backlash", "leg_thermal"} <= names
    without = sample.resolved(sample.STUDY + '[gap]\nwithout = ["gravity"]\n').gap
    assert names - {e.name for e in without.effects} == {"gravity"}
    assert sample.resolved().gap is None


def test_a_user_s_effect_replaces_one_of_the_library(tmp_path):
    path = gap_fixture.written(
        tmp_path, sample.STUDY + '[gap]\neffects = ["all", "effects.py:backlash"]\n'
    )
    request = GapRequest.from_study(Study.load(path), sample.resolved().machine)
    (backlash,) = [e for e in request.effects if e.name == "backlash"]
    assert backlash.source == "by hand"


MISTAKES = {
    "effect": ('[gap]\neffects = ["gravty"]', "gap.effects[1]", "gravity"),
    "without": ('[gap]\nwithout = ["gravty"]', "gap.without[1]", "did you mean gravity"),
    "none left": ('[gap]\neffects = ["gravity"]\nwithout = ["gravity"]', "gap.effects",
     "no effect is left"),
    "gravity": ("[gap]\ngravity = [0, 0, 0]", "gap.gravity", "[0, 0, -1]"),
    "payload": ("[gap.conditions]\npayload_N = [-1]", "gap.conditions.payload_N[1]", ">= 0"),
    "no feed": ("[gap.conditions]\nfeed_mm_min = []", "gap.conditions.feed_mm_min", "list"),
    "warming": ("[gap.conditions.temperature]\nleg = { rise_C = 1 }",
     "gap.conditions.temperature.leg", "after_min"),
    "acting": ('[[gap.acting]]\neffect = "gravty"', "gap.acting[1].effect", "gravity"),
    "constant": ('[[gap.acting]]\neffect = "gravity"\nconstants = { raito = 1 }',
     "gap.acting[1].constants.raito", "did you mean ratio"),
    "field": ('[[gap.acting]]\neffect = "gravity"\nsizes = 2', "gap.acting[1].sizes",
     "did you mean size"),
}  # fmt: skip


@pytest.mark.parametrize("case", MISTAKES)
def test_a_mistake_is_refused_with_field_and_remedy(case):
    text, field, remedy = MISTAKES[case]
    with pytest.raises(InputError) as error:
        sample.resolved(sample.STUDY + text + "\n")
    assert field in str(error.value)
    assert remedy in str(error.value)


# -- the section --------------------------------------------------------------------
@pytest.mark.usefixtures("without_mixture")
def test_the_command_diagnoses_readings(oed, tmp_path):
    study = gap_fixture.written(tmp_path, gap_fixture.STUDY + PREDICTION)
    assert oed("simulate", study, "--out", "r.csv")[0] == 0
    code, out, err = oed("diagnose", study, "--readings", "r.csv", "--out", "out")
    assert (code, err) == (0, "")
    assert (
        "The residual error comes from backlash or friction (probability 98 %)." in out
    )
    assert "If it is backlash, it changes length by 9." in out
    text = (tmp_path / "out/result.json").read_text()
    assert "NaN" not in text
    gap = msgspec.json.decode(text, type=result.StudyResult).gap
    assert gap.verdict == "effect"
    assert gap.selected == ["backlash"]
    assert gap.closure[1].value is None
    assert gap.not_testable == ["cold"]
    assert gap.about["cold"].column == "temp_frame_C"
    # of the estimate with the parameters, at the reach that it chose
    reach = gap.constants["backlash"]["reach"]
    value = {c.name: reach * c.value for c in gap.coefficients}
    assert value["leg 2"] == pytest.approx(15e-6, rel=0.03)
    assert value["leg 3"] == pytest.approx(-3.75e-6, rel=0.15)
    assert gap.rms_after["length"] < 0.6 < 5.0 < gap.rms_before["length"]
    decoded = json.loads(text)
    assert decoded["posterior"] is None
    assert decoded["prediction"] is None


def test_claims_can_point_into_the_diagnosis(virtual):
    assert virtual.code == 1
    assert (
        virtual.err
        == "oed: claim cause: not met: gap.answers[0].effects contains 'gravity',"
        ' measured ["backlash"]\n'
    )


def test_nothing_to_diagnose(oed, tmp_path):
    text = sample.changed(
        gap_fixture.STUDY, ("[readings]\nsimulate = true\ndraw = true\n", "")
    )
    study = gap_fixture.written(tmp_path, text)
    code, _, err = oed("diagnose", study, "--out", "x")
    assert code == 2
    assert "--readings" in err
    assert not (tmp_path / "x").exists()


@pytest.mark.usefixtures("without_mixture")
def test_a_study_without_a_table_is_diagnosed_with_all_effects(oed, tmp_path):
    study = gap_fixture.written(tmp_path, FEW[: FEW.index("[gap]")] + PREDICTION)
    assert oed("diagnose", study, "--out", "x", "--quiet")[0] == 0
    decoded = json.loads((tmp_path / "x/result.json").read_text())
    assert "gravity" in decoded["gap"]["tried"]
    assert oed("run", study, "--out", "y", "--quiet")[0] == 0
    assert json.loads((tmp_path / "y/result.json").read_text())["gap"] is None


# -- a second session ----------------------------------------------------------------
def _two_sessions(folder: Path) -> None:
    """r.csv with a clock, and its runs of one height and of the other apart: both call
    their runs alike and begin their clocks at 0.
    """
    whole = pd.read_csv(folder / "r.csv", dtype={"run": str})
    half = whole["z_mm"].eq(whole["z_mm"].iloc[0])
    parts = [whole[half].copy(), whole[~half].copy()]
    names = {run: f"run {k % 2}" for k, run in enumerate(whole["run"].unique())}
    for k, part in enumerate(parts):
        part["run"] = part["run"].map(names)
        part["time_s"] = 10.0 * np.arange(len(part))
        part.to_csv(folder / f"s{k + 1}.csv", index=False)
    later = parts[1].assign(
        time_s=parts[1]["time_s"] + 10.0 * (len(parts[0]) - 1) + 1.0
    )
    later["run"] += " (session 2)"
    pd.concat([parts[0], later]).to_csv(folder / "one.csv", index=False)


@pytest.mark.slow
@pytest.mark.usefixtures("without_mixture")
def test_two_sessions_together_are_as_one_file_of_both(oed, tmp_path):
    """And a third session finds both in the second's folder."""
    study = gap_fixture.written(tmp_path, FEW + PREDICTION)
    assert oed("simulate", study, "--out", "r.csv")[0] == 0
    _two_sessions(tmp_path)
    options = ("diagnose", study, "--quiet", "--out")
    assert oed(*options, "one", "--readings", "one.csv")[0] == 0
    assert oed(*options, "first", "--readings", "s1.csv")[0] == 0
    after = ("--readings", "s2.csv", "--after", "first")
    assert oed(*options, "second", *after)[0] == 0
    for again in ("s1.csv", "s2.csv"):
        after = ("--readings", again, "--after", "second")
        code, _, err = oed(*options, "third", *after)
        assert (code, "would count twice" in err) == (2, True)
    one, first, second = (
        json.loads((tmp_path / name / "result.json").read_text())
        for name in ("one", "first", "second")
    )
    assert first["goodness"] != one["goodness"]
    for section in ("goodness", "estimate", "gap"):
        assert second[section] == one[section]
    clock = [w for w in second["warnings"] if "clock of session 2 starts again" in w]
    assert len(clock) == 1
    for number in (1, 2):
        stored = tmp_path / f"second/session{number}_1.readings.csv"
        assert stored.read_bytes() == (tmp_path / f"s{number}.csv").read_bytes()


def test_a_second_session_needs_readings_and_a_first_one(oed, virtual):
    study, earlier = virtual.study, virtual.folder
    assert oed("simulate", study, "--out", "r.csv")[0] == 0
    code, _, err = oed("diagnose", study, "--out", "x", "--after", earlier)
    assert (code, "give --readings" in err) == (2, True)
    after = ("--readings", "r.csv", "--after", earlier)
    code, _, err = oed("diagnose", study, "--out", "x", *after)
    assert (code, "keeps no readings files" in err) == (2, True)
