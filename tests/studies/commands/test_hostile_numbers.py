"""Numbers that no workshop has end in a sentence with file, field, value and remedy."""

import pytest
import sample

from pkm_studies.commands import main

TOLERANCE = "[[prior.tolerance]]\nparameters = ['dq*']\nsigma_mm = 1e30\n[report]"


@pytest.mark.parametrize(("change", "field", "remedy"), [
    (("length_um = 0.5", "length_um = 1e300"), "noise.length_um", "check its unit"),
    (("length_um = 0.5", "length_um = 1e-9"), "noise.length_um", "1e-12 to 1000 m"),
    (("[report]", TOLERANCE), "prior.tolerance[1].sigma_mm", "up to 1000 m"),
])  # fmt: skip
def test_noise_and_tolerances(change, field, remedy):
    error = sample.refused(sample.STUDY, change)
    assert error.field == field
    assert error.value
    assert remedy in error.remedy


def test_a_huge_reading_is_named(tmp_path, capsys):
    study, readings = tmp_path / "s.study.toml", tmp_path / "r.csv"
    study.write_text(sample.STUDY, encoding="utf-8")
    text = sample.changed(sample.READINGS, ("300.002", "1e300"))
    readings.write_text(text, encoding="utf-8")
    assert main(["check", str(study), str(readings)]) == 2
    error = capsys.readouterr().err
    assert (
        "row 3, column length_mm = 1e300: no number of a session is so large" in error
    )
