"""`[prior] from`: a study's prior from the results of other machines, and refusals."""

import json
import shutil
from pathlib import Path

import pytest
import sample

from pkm_studies.commands import main
from pkm_studies.study import Study

OPTIONS = "[posterior]\nenabled = false\n[report]\nhtml = false\npdf = false\n"
STUDY = sample.changed(sample.DELTA, ("schema = 1", "schema = 1\nseed = {seed}"))
STUDY = (
    STUDY.replace('name = "small_delta"', 'name = "machine{seed}"')
    + "[readings]\nsimulate = true\n[design]\nreadings = 15\n[[design.candidates]]\n"
    'setup = "probe"\nx_mm = [-80.0, -40.0, 0.0, 40.0, 80.0]\n'
    "y_mm = [-80.0, -40.0, 0.0, 40.0, 80.0]\nz_mm = [0.0]\n" + OPTIONS
)


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Results of two machines, and the file of a third."""
    folder = tmp_path_factory.mktemp("fleet")
    for seed in (1, 2):
        path = folder / f"m{seed}.study.toml"
        path.write_text(STUDY.format(seed=seed))
        out = str(folder / f"m{seed}")
        assert main(["run", str(path), "--out", out, "--quiet"]) == 0
    return folder


def third(folder: Path, prior: str, text: str = STUDY) -> Path:
    path = folder / "third.study.toml"
    path.write_text(text.format(seed=3) + f"[prior]\n{prior}\n")
    return path


def test_a_study_takes_the_fleet(fleet, oed):
    code, out, error = oed(
        "run", third(fleet, 'from = ["m1", "m2"]'), "--out", fleet / "third"
    )
    assert code == 0, error
    assert "The prior is the mean and spread of 2 other machines" in out
    result = json.loads((fleet / "third" / "result.json").read_text("utf-8"))
    assert result["machine"]["fleet"] == ["m1", "m2"]
    rows = {r["name"]: r for r in result["machine"]["parameters"]}
    first, second = (
        json.loads((fleet / m / "result.json").read_text("utf-8")) for m in ("m1", "m2")
    )
    for name in ("endstop1", "endstop2", "endstop3"):
        row = rows[name]
        values = [r["estimate"]["parameters"][name]["value"] for r in (first, second)]
        tolerance = first["estimate"]["parameters"][name]["prior_sd"]
        assert min(*values, row["nominal"]) <= row["expected"]
        assert row["expected"] <= max(*values, row["nominal"])
        assert row["tolerance"] < tolerance


def test_what_does_not_fit_is_refused(fleet, oed):
    oed("run", third(fleet, 'from = ["m1"]'), "--out", fleet / "third", "--quiet")
    shutil.copytree(fleet / "m1", fleet / "copy")
    larger = STUDY.replace(
        'model = "linear_delta"',
        'model = "linear_delta"\nnominal = {{ radius_mm = 130.0 }}',
    )
    for prior, text, words in (
        ('from = ["absent"]', STUDY, "there is no folder"),
        ('from = ["m1", "m1"]', STUDY, "named twice"),
        ('from = ["m1", "copy"]', STUDY, "readings are those of 'm1'"),
        ('from = ["no"]', STUDY, "would replace the one"),
        ('earlier = "no"', STUDY, "would replace the one"),
        ('from = ["m1", "third"]', STUDY, "would count twice"),
        ('from = ["m1"]\nearlier = "m2"', STUDY, "keep one"),
        ('from = ["m1"]', larger, "another size"),
        (
            'from = ["m1"]',
            sample.STUDY.replace("{", "{{").replace("}", "}}"),
            "another machine",
        ),
    ):
        code, _, error = oed("run", third(fleet, prior, text), "--out", fleet / "no")
        assert (code, "prior." in error, words in error) == (2, True, True), error
    assert Study.parse(STUDY.format(seed=1), fleet / "x.study.toml").prior.from_ == []
