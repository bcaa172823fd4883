"""Every shipped study through the whole line of commands, on readings of drawn machines.

Each study runs as shipped, with readings of its own simulation under five seeds. A study
that cannot be simulated by its nature is skipped with the command's own refusal.
"""

import csv
import re
from pathlib import Path

import pytest

from pkm_studies.study import SUFFIX

ROOT = Path(__file__).resolve().parents[2]
NAMES = sorted(
    p.name.removesuffix(SUFFIX) for p in (ROOT / "studies").glob(f"*{SUFFIX}")
)
#: why a study has no readings of a virtual machine, and why it promises no accuracy
NOTHING_TO_SIMULATE = "the study has neither readings nor a plan"
NO_PREDICTION = ("prediction", "predicts no accuracy")
pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("own_folder")]


def study_file(name: str, seed: int, folder: Path) -> Path:
    """The shipped study with another seed, and data where they are."""
    text = (ROOT / "studies" / f"{name}{SUFFIX}").read_text(encoding="utf-8")
    text = re.sub(r"^seed = \d+", f"seed = {seed}", text, flags=re.MULTILINE)
    text = text.replace("../../shared", str(ROOT.parent / "shared"))
    path = folder / f"{name}{SUFFIX}"
    path.write_text(text, encoding="utf-8")
    return path


def filled_in(acceptance: Path) -> Path:
    """The planned test, measured on a machine that has no error at all."""
    lines = acceptance.read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    for row in rows:
        row |= {name: "0" for name in row if name.startswith("error_")}
    path = acceptance.with_name("measured.csv")
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("name", NAMES)
def test_a_study_goes_through(name, seed, oed, tmp_path):
    study, readings = study_file(name, seed, tmp_path), tmp_path / "s.readings.csv"
    code, _, refusal = oed("simulate", study, "--out", readings)
    if code:
        assert code == 2
        assert NOTHING_TO_SIMULATE in refusal
        pytest.skip(refusal.strip())
    given = ("--readings", readings, "--quiet")
    # a claim may fail: it is of the study's own plan or readings
    for command in ("identify", "diagnose"):
        code, _, error = oed(command, study, *given, "--out", tmp_path / command)
        assert code in (0, 1), error
        assert (tmp_path / command / "result.json").is_file(), error
    result = tmp_path / "identify"
    code, out, error = oed("compensate", result, "--to", "csv")
    assert code == 0, error
    assert "Compensation: " in out
    code, _, error = oed("verify", result)
    if code:
        assert any(reason in error for reason in NO_PREDICTION), error
        pytest.skip(error.strip())
    code, out, error = oed(
        "verify", result, "--readings", filled_in(result / "acceptance.csv")
    )
    assert code in (0, 1), error
    assert out
