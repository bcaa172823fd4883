"""Options that are given more than once: readings count all, others are refused."""

import importlib
import inspect
import json
import pkgutil

import pytest
import sample

from pkm_studies.commands import main


@pytest.mark.parametrize("call", [
    "verify out --readings a.csv --readings=b.csv",
    "diagnose a3_ball_bar --out c --after a --after b",
])  # fmt: skip
def test_a_second_file_of_an_option_that_takes_one_is_refused(call, capsys):
    """Else the first would be left out without a word."""
    assert main(call.split()) == 2
    option = "--readings" if "--readings" in call else "--after"
    wanted = f"oed: {option}: it is given 2 times, and takes one file; give it once.\n"
    assert capsys.readouterr().err == wanted


def test_of_other_values_the_last_counts(capsys):
    """As where a call changes a script's default."""
    call = [
        "compensate", "gone", "--to", "csv", "--to", "no_format", "--force", "--force",
    ]  # fmt: skip
    assert main(call) == 2
    assert "no_format" in capsys.readouterr().err


def test_readings_of_all_files_count(tmp_path):
    study = tmp_path / "delta.study.toml"
    text = sample.DELTA
    study.write_text(text, encoding="utf-8")
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
        assert main(["identify", str(study), *readings, "--out", str(out)]) in (0, 1)
        result = json.loads((out / "result.json").read_text("utf-8"))
        counts.append(result["estimate"]["readings"])
    assert counts[1] == 2 * counts[0]


def test_no_command_runs_code_unasked():
    """Every command with `--allow-code` has it off, wherever the command comes from."""
    room = importlib.import_module("pkm_studies.commands")
    names = pkgutil.iter_modules(room.__path__, "pkm_studies.commands.")
    modules = [importlib.import_module(module.name) for module in names]
    leaves = ("pkm_campaign", "pkm_certificate", "pkm_page")
    modules += [importlib.import_module(f"{leaf}.command") for leaf in leaves]
    defaults = [
        inspect.signature(function).parameters["allow_code"].default
        for module in modules
        for _, function in inspect.getmembers(module, inspect.isfunction)
        if "allow_code" in inspect.signature(function).parameters
    ]
    assert len(defaults) >= 17
    assert set(defaults) <= {False, inspect.Parameter.empty}
