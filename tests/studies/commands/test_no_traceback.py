"""Odd studies, readings, options and streams that once ended in a traceback."""

import importlib
import inspect
import json
import pkgutil
import subprocess
import sys
from pathlib import Path

import pytest
import sample

from pkm_studies.commands import main

LINES = """\
schema = 1
name = "lines"

[machine]
model = "planar_2dof"

[[setup]]
name = "rm4"
instrument = "rm4"

[[setup]]
name = "rm5"
instrument = "rm5"

[identify]
effects = "none"

[posterior]
enabled = false

[report]
html = false
pdf = false

[design]
readings = 2

[[design.candidates]]
setup = "rm4"
y_mm = [0.0, 500.0]
z_mm = [0.0, 500.0, 1000.0]
runs_by = "y"
"""
#: readings of the set-up that the design does not use
OTHER = """\
setup,run,order,y_mm,z_mm,dy_mm,dz_mm
rm5,1,1,0,0,0,0
rm5,1,2,500,0,500.01,0.01
"""


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "s.study.toml"
    path.write_text(LINES, encoding="utf-8")
    return path


def test_readings_of_a_set_up_that_the_design_does_not_use(study, tmp_path):
    readings, out = tmp_path / "r.csv", tmp_path / "out"
    readings.write_text(OTHER, encoding="utf-8")
    call = ["identify", study, "--readings", readings, "--out", out, "--quiet"]
    assert main([str(a) for a in call]) == 0
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    assert result["estimate"]["readings"] == 2
    assert any("no readings of rm5" in warning for warning in result["warnings"])


@pytest.mark.parametrize(("change", "words"), [
    (("[0.0, 500.0, 1000.0]", "[0.0]"), "design.candidates[1]: every run is one"),
    (("[design]", '[readings]\nsimulate = true\nfit = ["rm2"]\n[design]'),
     'readings.fit[1] = "rm2": no such set-up'),
    (("[design]", "[prediction]\nvirtual_machines = 1000000000\n[design]"),
     "prediction.virtual_machines = 1000000000"),
])  # fmt: skip
def test_studies(change, words, study, capsys):
    study.write_text(sample.changed(LINES, change), encoding="utf-8")
    assert main(["check", str(study)]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(("change", "words"), [
    (("low,1", "low,-1"), "column order = -1"),
    (("30,6,1", "30,-6,1"), "column time_s = -6"),
    (("direction", "repeat"), "column repeat = -1"),
])  # fmt: skip
def test_readings(change, words, tmp_path, capsys):
    path = tmp_path / "r.csv"
    path.write_text(sample.changed(sample.READINGS, change), encoding="utf-8")
    assert main(["check", str(path)]) == 2
    assert words in capsys.readouterr().err


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


OED = f"{sys.executable} -m pkm_studies.commands.cli"
FULL = Path("/dev/full")


def shell(line: str, folder: Path) -> tuple[int, str, str]:
    done = subprocess.run(
        ["bash", "-c", line], cwd=folder, capture_output=True, text=True, check=False
    )
    return done.returncode, done.stdout, done.stderr


CLOSED, NO_ROOM = (">&-", "it is closed"), (">/dev/full", "no space left on device")


@pytest.mark.parametrize(("command", "output", "words"), [
    ("list machines", *CLOSED),
    ("schema study", *NO_ROOM),
    ("--help", *CLOSED),
    ("--help", *NO_ROOM),
])  # fmt: skip
def test_an_output_that_cannot_be_written(command, output, words, tmp_path):
    if "full" in output and not FULL.exists():
        pytest.skip("this system has no /dev/full")
    code, _, error = shell(f"{OED} {command} {output}", tmp_path)
    assert code == 2
    assert error.startswith(f"oed: standard output: {words}; ")
    assert error.count("\n") == 1


def test_other_streams_may_be_closed(tmp_path):
    """Their numbers go to no file that is opened later."""
    code, out, _ = shell(f"{OED} list criteria <&- 2>&-", tmp_path)
    assert code == 0
    assert out.startswith("A ")
    code, out, _ = shell(f"{OED} list nonsense 2>&-", tmp_path)
    assert (code, out) == (2, "")
    code, _, _ = shell(f"{OED} list criteria >&- 2>&-", tmp_path)
    assert code == 2
