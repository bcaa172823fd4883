"""Broken inputs: exit 2 and one paragraph with file, field and remedy."""

import random
import re
import shutil
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

import compensation_sample
import msgspec
import numpy as np
import pytest
import sample
import xarray
from shipped_models import linear_delta

from oed.model import Machine
from pkm_page import PageOptions, open_page
from pkm_studies import csv_table
from pkm_studies.base import InputError
from pkm_studies.commands import main
from pkm_studies.compensation.formats import body_names
from pkm_studies.earlier_result import read_draws
from pkm_studies.quantities import column
from pkm_studies.study import PublishedFile, Study

TEN_MB = 10_000_000
LONGEST = 600


def noise(kind: str) -> bytes:
    """10 MB: bytes of any value, or text in lines, or text without an end of line."""
    rng = random.Random(7)
    if kind == "binary":
        return rng.randbytes(TEN_MB)
    line = bytes(rng.choice(b"abcXYZ0189 ,;=[]{}\"'.#-") for _ in range(9_973))
    return (line + (b"\n" if kind == "lines" else b"")) * (TEN_MB // len(line) + 1)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The paragraph on stderr of a call that must exit 2 before any work."""
    code = main([str(a) for a in arguments])
    out, err = capsys.readouterr()
    assert code == 2
    assert out in ("", "set-up\n")
    return one_paragraph(err)


def one_paragraph(err: str) -> str:
    """The text, if it is one printable paragraph of limited length."""
    assert err.startswith("oed: ")
    assert err.endswith(".\n")
    assert err.count("\n") == 1
    assert len(err) <= LONGEST
    assert "Traceback" not in err
    assert err.isprintable() or err[:-1].isprintable()
    return err


STUDIES = {
    "unknown field": (("criterion =", "criterium ="), "design.criterium", "did you mean criterion"),
    "pose out of reach": (("z_mm = 1286.0", "z_mm = 3000.0"), "setup[1].teach", "keep to poses within"),
    "half a file": (('[expect]\nrank = { of = "identifiability.rank", equals = 18 }', "[expe"), "", "line"),
}  # fmt: skip


@pytest.mark.parametrize("command", ["run", "check"])
@pytest.mark.parametrize("name", STUDIES)
def test_study(name, command, capsys, tmp_path):
    change, field, remedy = STUDIES[name]
    path = tmp_path / "s.study.toml"
    path.write_text(sample.changed(sample.STUDY, change), encoding="utf-8")
    out = ["--out", tmp_path / "out"] if command == "run" else []
    err = refusal(capsys, command, path, *out)
    assert f"{path}: {field}" in err
    assert remedy in err
    assert not (tmp_path / "out").exists()


def test_study_without_any_set_up(capsys, tmp_path):
    path = tmp_path / "s.study.toml"
    path.write_text(
        'schema = 1\nname = "s"\nsetup = []\n[machine]\nmodel = "a3_head"\n',
        encoding="utf-8",
    )
    assert "setup: missing; add a [[setup]]" in refusal(capsys, "run", path)


READINGS = {
    "nan": (("300.001", "NaN"), "row 2, column length_mm = NaN", "leave the cell empty"),
    "pose out of reach": (("1146,90", "2146,90"), "row 3, column z_mm = 2146", "1066 to 1266"),
}  # fmt: skip


@pytest.mark.parametrize("name", READINGS)
def test_readings(name, capsys, tmp_path):
    change, where, remedy = READINGS[name]
    study, path = tmp_path / "s.study.toml", tmp_path / "r.readings.csv"
    study.write_text(sample.STUDY, encoding="utf-8")
    path.write_text(sample.changed(sample.READINGS, change), encoding="utf-8")
    err = refusal(
        capsys, "identify", study, "--readings", path, "--out", tmp_path / "out"
    )
    assert f"{path}: {where}" in err
    assert remedy in err
    assert not (tmp_path / "out").exists()


# -- files that are no studies and no readings -----------------------------------------
@pytest.mark.parametrize("kind", ["binary", "lines", "text"])
@pytest.mark.parametrize("name", ["x.study.toml", "x.readings.csv"])
def test_ten_megabytes_of_noise(name, kind, capsys, tmp_path):
    path = tmp_path / name
    path.write_bytes(noise(kind))
    assert str(path) in refusal(capsys, "check", path)


@pytest.mark.parametrize("content", [b"", b"\n \n", b"\xef\xbb\xbf"])
@pytest.mark.parametrize("name", ["x.study.toml", "x.readings.csv"])
def test_empty(name, content, capsys, tmp_path):
    path = tmp_path / name
    path.write_bytes(content)
    err = refusal(capsys, "check", path)
    assert str(path) in err
    assert "empty" in err


def test_no_file_a_folder_and_nesting(capsys, tmp_path):
    assert "no such study file" in refusal(capsys, "run", tmp_path / "gone.study.toml")
    assert "no file" in refusal(capsys, "run", tmp_path)
    assert "gone.csv" in refusal(capsys, "check", tmp_path / "gone.csv")
    path = tmp_path / "deep.study.toml"
    path.write_text("x = " + "[" * 5_000, encoding="utf-8")
    assert "nested too deeply" in refusal(capsys, "run", path)


# -- the real command ------------------------------------------------------------------
@pytest.mark.parametrize("content", [
    noise("binary"),
    sample.STUDY.replace("300.0", "nan").encode(),
], ids=["noise", "nan"])  # fmt: skip
def test_in_a_process_of_its_own(content, tmp_path):
    path = tmp_path / "x.study.toml"
    path.write_bytes(content)
    command = [
        shutil.which("oed", path=str(Path(sys.executable).parent)) or "oed",
        "run",
        str(path),
        "--out",
        str(tmp_path / "out"),
    ]
    finished = subprocess.run(command, capture_output=True, text=True, check=False)
    assert (finished.returncode, finished.stdout) == (2, "")
    assert str(path) in one_paragraph(finished.stderr)


# -- what a run refuses, a check refuses -----------------------------------------------
WIDE = """\
[machine.workspace]
x_mm = [-400.0, 400.0]
y_mm = [-400.0, 400.0]
z_mm = [-50.0, 600.0]
"""
GRID = """\
setup = "probe"
x_mm = [-60.0, 0.0, 60.0]
y_mm = [-60.0, 0.0, 60.0]
z_mm = [20.0, 60.0]
"""
PLAN = f'[readings]\nsimulate = true\n[[design.reference]]\nname = "grid"\n{GRID}'
CANDIDATES = f"[[design.candidates]]\n{GRID}"
WHERE = "[prediction]\nx_mm = [-40.0, 40.0]\ny_mm = [0.0]\nz_mm = [20.0, 60.0]\n"
FAR = WIDE + PLAN + WHERE.replace("40.0", "390.0", 2)
UNUSABLE = {
    "prediction out of reach": (FAR, "prediction: 4 poses cannot be reached"),
    "forecast of no component": (
        f"{WHERE}[forecast]\nexpected = {{ q_um = 60.0 }}\n",
        "forecast.expected.q_um",
    ),
    "forecast without a workspace": (
        "[forecast]\nexpected = { x_um = 60.0 }\n",
        "prediction: the study does not say where",
    ),
    "effects without a workspace": (
        '[design]\nreadings = 9\neffects = "catalogue"\nscaling = "tolerance"\n'
        + CANDIDATES,
        "design.effects",
    ),
    "more readings than candidates": (
        f"[design]\nreadings = 999\n{CANDIDATES}",
        "cannot choose 999",
    ),
    "too few readings": (f"[design]\nreadings = 1\n{CANDIDATES}", "cannot determine"),
    "a reference of two poses": (
        "[design]\nreadings = 9\n[design.order]\nreference_every_min = 5.0\n"
        f"reference = {{ x_mm = [0.0, 1.0], y_mm = 0.0, z_mm = 20.0 }}\n{CANDIDATES}",
        "design.order.reference: the reference is one pose",
    ),
    "a virtual machine that does not close": (
        PLAN.replace("true\n", "true\ntruth = { radius_mm = 900.0 }\n", 1),
        "readings.truth: the virtual machine cannot be assembled at 18 of the poses",
    ),
    "no such coefficient": (
        f'[gap]\n[[gap.acting]]\neffect = "gravity"\ncoefficients = {{ no = 1.0 }}\n{PLAN}',
        "gap.acting[1].coefficients.no",
    ),
    "nothing is free": (f'[machine]\nfixed = ["*"]\n{PLAN}', "machine.fixed"),
}


@pytest.mark.parametrize("name", UNUSABLE)
def test_a_check_refuses_what_a_run_refuses(name, capsys, tmp_path):
    addition, words = UNUSABLE[name]
    text = sample.DELTA.split('[[setup]]\nname = "calliper"')[0]
    if addition.startswith("[machine]\n"):
        fixed, _, addition = addition.removeprefix("[machine]\n").partition("\n")
        text = text.replace("[machine]\n", f"[machine]\n{fixed}\n")
    path = tmp_path / "s.study.toml"
    path.write_text(text + addition, encoding="utf-8")
    checked = refusal(capsys, "check", path)
    assert words in checked
    code = main(["run", str(path), "--out", str(tmp_path / "out"), "--quiet"])
    assert (code, capsys.readouterr().err) == (2, checked)


NAMES = ("parameter", ["a", "b"])
DIMENSIONS = ("chain", "draw", "parameter")


def netcdf(**variables: object) -> bytes:
    data = xarray.Dataset(variables)
    return bytes(data.to_netcdf(engine="h5netcdf", group="posterior"))


def draws(theta: np.ndarray) -> bytes:
    return netcdf(theta=(DIMENSIONS, theta), parameter=NAMES)


GOOD = draws(np.ones((1, 5, 2)))
BROKEN = {
    "empty": b"",
    "text": b"no netCDF\n",
    "cut": GOOD[: len(GOOD) // 2],
    "head alone": GOOD[:8],
    "no group": bytes(xarray.Dataset().to_netcdf(engine="h5netcdf")),
    "no draws": netcdf(parameter=NAMES),
    "of a number": netcdf(theta=3.0, parameter=NAMES),
    "not finite": draws(np.full((1, 5, 2), np.nan)),
    "words": draws(np.full((1, 5, 2), "x")),
    "one draw": draws(np.ones((1, 1, 2))),
}


def test_whole_draws_are_read(tmp_path):
    path = tmp_path / "posterior.nc"
    path.write_bytes(GOOD)
    read = read_draws(path, ["b"])
    assert read is not None
    np.testing.assert_array_equal(read, np.ones((5, 1)))
    assert read_draws(path, ["c"]) is None


@pytest.mark.parametrize("content", BROKEN.values(), ids=[*BROKEN])
def test_broken_draws_are_named(tmp_path, content):
    path = tmp_path / "posterior.nc"
    path.write_bytes(content)
    with pytest.raises(InputError) as error:
        read_draws(path, ["a"])
    said = str(error.value)
    assert said.startswith(f"{path}: these are no draws of a posterior: ")
    assert "restore the file" in said


DEEP = "x = " + "[" * 5000


@pytest.mark.parametrize(("name", "command"), [
    ("c.campaign.toml", ["campaign", "c.campaign.toml"]),
    ("m.toml", ["import", "columns", "r.csv", "--map", "m.toml", "--out", "o"]),
    ("s.study.toml", ["check", "s.study.toml"]),
])  # fmt: skip
def test_nested_tables_are_named(tmp_path, monkeypatch, capsys, name, command):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(DEEP, encoding="utf-8")
    (tmp_path / "r.csv").write_text("x,y\n1,2\n", encoding="utf-8")
    assert main(command) == 2
    assert f"{name}: tables or lists are nested too deeply" in capsys.readouterr().err


def test_a_cell_that_no_reader_takes_is_named(tmp_path):
    """Python's reader of CSV takes 131072 characters."""
    path = tmp_path / "long.csv"
    path.write_text(f"x,y\n1,2\n3,{'9' * 200_000}\n", encoding="utf-8")
    for read in (csv_table.read, lambda p: PublishedFile(p).csv_rows(["x"])):
        with pytest.raises(InputError, match=r"long.csv: this is no CSV: field larger"):
            read(path)


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


PATHS = (
    "../evil", "/elsewhere/evil", "a/b", "..", "", ".hidden", "a\nb", "evil\n",
    "C:evil", "a\\b",
)  # fmt: skip
COMMAND = "M112 (stop)"
TEXT = f"1.0 ) */ ]]> ---> --> \n{COMMAND}\r{COMMAND}\u2028{COMMAND}\x0b{COMMAND}"


def stored(folder: Path, **fields: object) -> Path:
    machine = linear_delta.machine
    content = compensation_sample.result(machine, machine.nominal)
    return compensation_sample.save(folder, msgspec.structs.replace(content, **fields))


@pytest.mark.parametrize("name", PATHS)
def test_the_name_of_a_study_is_no_path(tmp_path, name):
    folder = stored(tmp_path / "theirs", study=name)
    before = sorted(tmp_path.rglob("*"))
    with pytest.raises(InputError, match=r"result.json: study = .*no name for a study"):
        open_page(folder, PageOptions())
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("command", [
    ["report"],
    ["compensate", "--to", "csv"],
    ["verify"],
    ["adjust"],
    ["certificate"],
])  # fmt: skip
def test_no_command_writes_outside_the_folder(tmp_path, capsys, command):
    folder = stored(tmp_path / "theirs", study="../evil")
    assert main([command[0], str(folder), *command[1:]]) == 2
    assert "study" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["theirs"]


def test_the_name_of_a_study_ends_with_its_line(tmp_path):
    """Python lets a line feed follow the end of a pattern."""
    text = compensation_sample.study_text("linear_delta")
    with pytest.raises(InputError, match="letters, digits"):
        Study.parse(text.replace('"sample"', '"sample\\n"'), tmp_path / "s.study.toml")


def test_no_text_of_a_result_is_a_command_of_a_controller(tmp_path):
    """Each line of the text stays inside the comment that it is written into."""
    few = ["--commands", "64"]
    formats = {"csv": few, "json": few, "c": [], "klipper": [], "rrf": [], "marlin": []}
    for word, options in (formats | {"linuxcnc": [], "gcode": []}).items():
        folder = hostile(tmp_path / word, linear_delta.machine)
        assert main(["compensate", str(folder), "--to", word, *options]) in (0, 1, 2)
        texts = [p.read_text("utf-8") for p in folder.glob("compensation*")]
        assert texts, word
        for line in "\n".join(texts).splitlines():
            assert not line.startswith("M112"), word
            assert not re.match(r"^[^(;#]*\)\s*M112", line), word


@pytest.mark.parametrize("dashes", range(8))
def test_no_text_of_a_result_ends_a_comment_in_xml(dashes):
    text = "-" * dashes + ">" + "-" * dashes
    whole = body_names.commented(ElementTree.Element("robot"), [text, text])
    assert ElementTree.fromstring(whole).tag == "robot"


def hostile(folder: Path, machine: Machine) -> Path:
    """A result with commands wherever it has text."""
    home = {column(c.name, c.unit): 0.0 for c in machine.command}
    design = compensation_sample.design([home])
    poses = [msgspec.structs.replace(p, setup=TEXT, run=TEXT) for p in design.poses]
    content = compensation_sample.result(
        machine, machine.nominal, design=msgspec.structs.replace(design, poses=poses)
    )
    hostile = msgspec.structs.replace(content, version=TEXT, title=TEXT, question=TEXT)
    return compensation_sample.save(folder, hostile)
