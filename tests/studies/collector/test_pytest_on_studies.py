"""Studies as parametrised tests of pytest."""

import subprocess
import sys

import pytest
import sample
from few_poses import PLAN, write

from pkm_studies.study import Study


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
