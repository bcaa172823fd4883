"""Studies and sweeps over varied studies as tests of pytest."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest
import sample
from few_poses import PLAN, write

from pkm_studies import stages
from pkm_studies.base import Location
from pkm_studies.collector import sweep
from pkm_studies.study import Study

#: nothing to choose and nothing to fit: a plan is looked at
SWEPT = sample.changed(
    sample.STUDY,
    ("[[design.candidates]]", '[[design.reference]]\nname = "circles"'),
    ("count = 4 }", "count = 2 }"),
    ("html = false", "html = false\ncorner = 3"),
)
SUITE = """\
import pytest

NOISE = [0.5, 1.0]
sweep = pytest.mark.study_sweep(
    "plan.study.toml", vary={"noise.length_um": NOISE, "design.reference.circles.z_mm": [1100, [1100, 1200]]}
)


@sweep
def test_rank(varied_study):
    varied_study.check("identifiability.rank", min=12)


@sweep
def test_own_claims(varied_study):
    varied_study.check_claims()


@sweep
def test_noise_is_the_setting_s(varied_study):
    noise = varied_study.setting["noise.length_um"]
    (setup,) = varied_study.result.setups
    assert noise in setup.sigma.values()
"""


def _suite(folder: Path, texts: Sequence[str], *options: str) -> str:
    """What pytest prints on a suite of files with these texts in the folder."""
    (folder / "plan.study.toml").write_text(SWEPT, encoding="utf-8")
    names = [f"test_mine_{k}.py" for k in range(len(texts))]
    for name, text in zip(names, texts, strict=True):
        (folder / name).write_text(text, encoding="utf-8")
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", *options]
    command += ["--basetemp", str(folder / "temporary"), *names]
    done = subprocess.run(
        command, capture_output=True, text=True, check=False, cwd=folder
    )
    return done.stdout + done.stderr


@pytest.mark.slow
def test_each_combination_is_a_test_on_two_processes(tmp_path):
    """A circle of 12 readings sees 12 directions: the claim of 18 fails, in words."""
    printed = _suite(tmp_path, [SUITE], "-n", "2")
    assert "2 workers" in printed or "gw1" in printed or "bringing up" in printed
    assert "2 failed, 10 passed" in printed, printed
    line = "rank: measured 12, claimed identifiability.rank = 18 (plan.study.toml with"
    assert f"{line} noise.length_um = 0.5" in printed
    assert "Traceback" not in printed
    assert "def test_own_claims" not in printed  # no source, the message alone
    results = list((tmp_path / "temporary" / "studies").iterdir())
    assert len(results) == 4
    assert all((folder / "result.json").is_file() for folder in results)


def test_a_sweep_that_makes_no_sense_is_an_error_in_words(tmp_path):
    marks = {
        "": "varied_study needs the mark study_sweep",
        '@pytest.mark.study_sweep("plan.study.toml", vary={"setup.x.y": [1]})': (
            "no entry 'x'"
        ),
    }
    text = "import pytest\n\n{}\ndef test_it(varied_study):\n    varied_study.result\n"
    printed = _suite(tmp_path, [text.format(m) for m in marks], "-p", "no:xdist")
    for words in marks.values():
        assert words in printed
    assert "Traceback" not in printed


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "plan.study.toml"
    path.write_text(SWEPT, encoding="utf-8")
    return path


def test_tests_of_one_combination_share_its_run(study, tmp_path, monkeypatch):
    runs = []
    run = stages.run_study

    def counted(*arguments: object, **options: object) -> object:
        runs.append(arguments)
        return run(*arguments, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(stages, "run_study", counted)
    base = Study.load(study)
    (tmp_path / "results").mkdir()
    for value in (0.5, 1.0, 0.5):
        setting = {"noise.length_um": value}
        varied = base.vary_setting(setting, Location("test"))
        combination = sweep.Combination(varied, setting)
        case = sweep.VariedStudy(combination, tmp_path / "results")
        assert case.figure("identifiability.n") == 21
        assert case.result.study == "small"
    assert len(runs) == 2


def test_a_failing_figure_says_measured_against_claimed(study, tmp_path):
    (tmp_path / "results").mkdir()
    combination = sweep.Combination(
        Study.load(study), {"setup": [{"instrument": "camera"}]}
    )
    case = sweep.VariedStudy(combination, tmp_path / "results")
    case.check("identifiability.rank", max=21)
    with pytest.raises(pytest.fail.Exception) as failed:
        case.check("identifiability.n", max=9)
    assert str(failed.value) == (
        "n: measured 21, claimed identifiability.n <= 9 (plan.study.toml with setup ="
        " camera)"
    )
    with pytest.raises(pytest.fail.Exception, match="no such result"):
        case.figure("identifiability.nothing")
    with pytest.raises(pytest.fail.Exception, match="no claim none"):
        case.check_claims("none")


def pytest_on(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [
        sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p",
        "no:xdist", *map(str, arguments),
    ]  # fmt: skip
    return subprocess.run(command, capture_output=True, text=True, check=False)


@pytest.mark.slow
def test_each_claim_is_a_test(tmp_path):
    claims = (
        'wrong = { of = "identifiability.n", equals = 20 }\nnowhere = { of ='
        ' "identifiability.m", min = 1 }\n'
    )
    good = write(tmp_path / "good.study.toml", PLAN + claims)
    gone = (
        sample.DELTA
        + '[readings]\nsource = "delta_v400"\npath = "gone"\n[expect]\nany = { of ='
        ' "seed", min = 0 }\n'
    )
    write(tmp_path / "gone.study.toml", gone)
    write(tmp_path / "broken.study.toml", "schema = 1\n")
    write(
        tmp_path / "slow.study.toml",
        PLAN.replace("schema = 1", "schema = 1\nslow = true"),
    )
    done = pytest_on(
        tmp_path, "-rs", "-m", "not slow", "--continue-on-collection-errors"
    )
    assert "1 passed, 1 skipped, 1 deselected, 1 error" in done.stdout
    assert "2 failed" in done.stdout
    line = 1 + (PLAN + claims).splitlines().index(claims.splitlines()[0])
    where = f"good.study.toml:{line} [expect]"
    expected = f"wrong: measured 21, claimed identifiability.n = 20 ({where})"
    assert expected in done.stdout
    assert "no such result" in done.stdout
    assert "name: missing" in done.stdout
    assert "looked in" in done.stdout
    assert "Traceback" not in done.stdout
    assert "1 passed in" in pytest_on(f"{good}::rank").stdout


def test_a_study_of_one_claim_names_its_line(tmp_path):
    from pkm_studies import collector

    text = Study.load(write(tmp_path / "p.study.toml", PLAN)).text
    assert text.splitlines()[collector._line(text, "rank")].startswith("rank =")
