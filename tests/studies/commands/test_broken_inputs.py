"""Broken inputs: exit 2 and one paragraph with file, field and remedy."""

import random
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import sample

from pkm_studies.commands import main

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
