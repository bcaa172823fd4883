"""Options that are given more than once: readings count all, others are refused."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import sample

from pkm_studies.commands import cli


@pytest.mark.parametrize(
    "arguments",
    [
        ["run", "a3_ball_bar", "--seed", "1", "--seed", "2"],
        ["compensate", "out", "--to", "csv", "--to", "json"],
        ["campaign", "my.toml", "--out=a", "--out=b"],
    ],
)
def test_an_option_of_one_value_is_given_once(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    message = capsys.readouterr().err
    name = next(a for a in arguments if a.startswith("--")).partition("=")[0]
    assert (
        message
        == f"oed: {name}: it is given 2 times, and holds one value; give it once.\n"
    )


def test_flags_may_be_repeated(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["compensate", "out", "--to", "csv", "--force", "--force"]) == 2
    assert "times" not in capsys.readouterr().err


def test_readings_of_all_files_count(tmp_path: Path) -> None:
    study = tmp_path / "delta.study.toml"
    study.write_text(sample.DELTA, encoding="utf-8")
    later = sample.DELTA_READINGS
    for run in ("1", "d1", "d2"):
        later = later.replace(f"probe,{run},", f"probe,{run}b,")
        later = later.replace(f"calliper,{run},", f"calliper,{run}b,")
    files = [tmp_path / "day1.csv", tmp_path / "day2.csv"]
    for path, text in zip(files, (sample.DELTA_READINGS, later), strict=True):
        path.write_text(text, encoding="utf-8")
    counts = []
    for given in (files[:1], files):
        out = tmp_path / f"out{len(given)}"
        readings = [part for path in given for part in ("--readings", str(path))]
        assert cli.main(["identify", str(study), *readings, "--out", str(out)]) in (
            0,
            1,
        )
        result = json.loads((out / "result.json").read_text("utf-8"))
        counts.append(result["estimate"]["readings"])
    assert counts[1] == 2 * counts[0]
