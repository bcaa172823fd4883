"""Python files run once their user allowed them, and no other way leads to them."""

import hashlib
import importlib.util
import json
import os
import subprocess
import sys
from importlib import _bootstrap_external
from pathlib import Path

import compensation_sample
import msgspec
import pytest
import sample
from shipped_models import linear_delta

from oed import load_study
from pkm_studies import study, user_code
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve
from pkm_studies.user_code import Consent

#: a machine whose file leaves a trace where it runs
MACHINE = """\
from pathlib import Path
from pkm_models.machines.a3_head import machine
trace = Path(__file__).with_suffix(".ran")
trace.write_text(trace.read_text() + "+" if trace.exists() else "+")
"""
STUDY = sample.changed(sample.STUDY, ('"a3_head"', '"mine.py:machine"'))
READINGS = sample.READINGS


pytestmark = pytest.mark.usefixtures("stranger")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A study of somebody else, with its machine."""
    folder = tmp_path / "theirs"
    folder.mkdir()
    (folder / "mine.py").write_text(MACHINE, "utf-8")
    (folder / "s.study.toml").write_text(STUDY, "utf-8")
    (folder / "r.csv").write_text(READINGS, "utf-8")
    return folder


def runs(folder: Path) -> int:
    """How often the machine's file ran."""
    trace = folder / "mine.ran"
    return len(trace.read_text()) if trace.exists() else 0


def test_no_command_runs_the_file_of_a_study_by_itself(folder, oed):
    path, readings, out = folder / "s.study.toml", folder / "r.csv", folder / "out"
    digest = hashlib.sha256(MACHINE.encode()).hexdigest()
    for command in (
        ("check", path),
        ("check", folder / "mine.py"),
        ("check", path, "--picture", folder / "home.png"),
        ("run", path, "--out", out),
        ("plan", path, "--out", out),
        ("simulate", path, "--out", folder / "x.csv"),
        ("identify", path, "--readings", readings, "--out", out),
        ("diagnose", path, "--readings", readings, "--out", out),
        ("next", path, "--readings", readings),
    ):
        code, _, error = oed(*command)
        assert code == 2, command
        assert digest in error
        assert "mine.py" in error
        assert "--allow-code" in error
        assert str(user_code.settings_file()) in error
        assert error.count("\n") == 1
    assert runs(folder) == 0
    assert not (out / "result.json").exists()


def test_consent_holds_while_the_file_is_unchanged(folder, oed):
    path = folder / "s.study.toml"
    assert oed("check", path, "--allow-code")[0] == 0
    assert runs(folder) == 1
    resolve(load_study(path))  # remembered, also for the module in memory
    (folder / "mine.py").write_text(MACHINE + "# changed\n", "utf-8")
    assert oed("check", path)[0] == 2
    assert runs(folder) == 1
    resolve(load_study(path, allow_code=True))
    assert oed("check", path)[0] == 0
    assert runs(folder) == 2


def test_consent_is_remembered_by_other_processes(folder, oed):
    study = str(folder / "s.study.toml")
    assert oed("check", study)[0] == 2
    assert oed("check", study, "--allow-code")[0] == 0
    command = [sys.executable, "-m", "pkm_studies.commands.cli", "check", study]
    assert subprocess.run(command, check=False).returncode == 0
    assert runs(folder) == 2


def test_a_trusted_folder_needs_no_consent(folder, oed, monkeypatch):
    path = folder / "s.study.toml"
    monkeypatch.setenv(
        "OED_TRUSTED_FOLDERS", os.pathsep.join(["/elsewhere", str(folder)])
    )
    assert oed("check", path)[0] == 0
    monkeypatch.delenv("OED_TRUSTED_FOLDERS")
    assert oed("check", path)[0] == 2
    settings = user_code.settings_file()
    settings.parent.mkdir(parents=True)
    settings.write_text(f"trusted_folders = [{str(folder.parent)!r}]\n", "utf-8")
    assert oed("check", path)[0] == 0
    for text, words in (
        ('trusted_folders = ["."]', "this folder is relative"),
        ("trusted_folders = 3", "a list of folders is wanted"),
        ("trusted_folders", "this is no TOML"),
    ):
        settings.write_text(text, "utf-8")
        code, _, error = oed("check", path)
        assert code == 2
        assert words in error
        assert str(settings) in error


@pytest.mark.parametrize(("reference", "words"), [
    ("../mine.py", "does not lie in the folder"),
    ("{parent}/mine.py", "does not lie in the folder"),
    ("C:/mine.py", "does not lie in the folder"),
    ("link.py", "does not lie in the folder"),
    ("mine:machine", "belongs to no installed machine"),
    ("os:machine", "belongs to no installed machine"),
    ("pkm_studies.commands.cli:machine", "belongs to no installed machine"),
])  # fmt: skip
def test_a_study_names_files_of_its_folder_alone(
    reference, words, folder, oed, monkeypatch
):
    """Consent covers the folder of the study, not every file that its text reaches."""
    parent = folder.parent
    (parent / "mine.py").write_text(MACHINE, "utf-8")
    (folder / "link.py").symlink_to(parent / "mine.py")
    monkeypatch.syspath_prepend(str(parent))
    path = folder / "s.study.toml"
    named = reference.replace("{parent}", parent.as_posix())
    path.write_text(STUDY.replace("mine.py:machine", named), "utf-8")
    code, _, error = oed("check", path, "--allow-code")
    assert code == 2
    assert words in error
    assert runs(parent) == runs(folder) == 0


@pytest.mark.skipif(os.name != "posix", reason="Windows has other permissions")
def test_others_cannot_allow_a_file(folder, oed):
    """Whoever can write into these files, or above them, could allow any file."""
    path = folder / "s.study.toml"
    assert oed("check", path, "--allow-code")[0] == 0
    assert oed("check", path)[0] == 0
    allowed = user_code.allowed_file()
    assert allowed.stat().st_mode & 0o777 == 0o600
    allowed.parent.chmod(0o777)
    assert oed("check", path)[0] == 2
    allowed.parent.chmod(0o700)
    allowed.chmod(0o666)
    assert oed("check", path)[0] == 2

    settings = user_code.settings_file()
    settings.parent.mkdir(parents=True)
    settings.write_text(f"trusted_folders = [{str(folder)!r}]\n", "utf-8")
    assert oed("check", path)[0] == 0
    settings.chmod(0o666)
    code, _, err = oed("check", path)
    assert code == 2
    assert str(settings) in err
    assert "other users can change this file" in err


def test_folders_that_share_a_machine_are_both_trusted(folder, oed, monkeypatch):
    (folder.parent / "mine.py").write_text(MACHINE, "utf-8")
    path = folder / "s.study.toml"
    path.write_text(STUDY.replace("mine.py", "../mine.py"), "utf-8")
    monkeypatch.setenv("OED_TRUSTED_FOLDERS", str(folder))
    assert oed("check", path)[0] == 2
    monkeypatch.setenv("OED_TRUSTED_FOLDERS", str(folder.parent))
    assert oed("check", path)[0] == 0


def test_the_text_of_the_digest_runs_and_no_cached_code(folder, oed):
    """Python itself would run compiled code that lies beside an innocent file."""
    evil = compile(MACHINE.replace('"+"', '"++"'), "mine.py", "exec")
    cache = Path(importlib.util.cache_from_source(str(folder / "mine.py")))
    cache.parent.mkdir()
    unchecked = _bootstrap_external._code_to_hash_pyc(evil, b"\0" * 8, checked=False)
    cache.write_bytes(unchecked)
    assert oed("check", folder / "s.study.toml", "--allow-code")[0] == 0
    assert runs(folder) == 1


def test_a_result_runs_no_code(tmp_path, oed, monkeypatch):
    """Also where the file was allowed, or lies in a trusted folder."""
    monkeypatch.setenv("OED_TRUSTED_FOLDERS", str(tmp_path))
    content = compensation_sample.result(
        linear_delta.machine, linear_delta.machine.nominal
    )
    text = content.study_text.replace('"linear_delta"', '"mine.py:machine"')
    results = [tmp_path / name for name in "ab"]
    for place in results:
        changed = msgspec.structs.replace(content, study_text=text)
        compensation_sample.save(place, changed)
        (place / "mine.py").write_text(MACHINE, "utf-8")
    monkeypatch.chdir(results[0])
    for command in (
        ("compensate", ".", "--to", "csv"),
        ("verify", "."),
        ("history", *results),
        ("compare", *results),
        ("report", "."),
    ):
        for options in ([], ["--allow-code"]):
            if options and command[0] in ("compare", "report"):
                continue
            assert oed(*command, *options)[0] in (0, 1, 2)
    assert oed("compensate", ".", "--to", "csv", "--allow-code")[0] == 2
    assert runs(results[0]) == runs(results[1]) == 0


def test_drafts_and_formats_need_consent(folder, oed, monkeypatch):
    monkeypatch.chdir(folder)
    new = ("new", "mine", "--machine", "mine.py:machine", "--instrument", "ball_bar")
    assert oed(*new)[0] == 2
    assert oed(*new, "--allow-code")[0] == 0
    (folder / "form.py").write_text(
        "from pkm_studies.catalogue.controller_format import ControllerFormat\n"
        "controller = ControllerFormat(name='mine', about='', source='',\n"
        "    write=lambda c: {'.txt': 'written'})\n",
        "utf-8",
    )
    content = compensation_sample.result(
        linear_delta.machine, linear_delta.machine.nominal
    )
    compensation_sample.save(folder / "d", content)
    command = ("compensate", "d", "--to", folder / "form.py")
    assert oed(*command)[0] == 2
    assert not (folder / "d" / "compensation.txt").exists()
    assert oed(*command, "--allow-code")[0] == 0
    assert (folder / "d" / "compensation.txt").read_text() == "written"


def test_an_import_takes_the_machine_along(folder, oed):
    """A study names files of its folder: the machine's is copied there."""
    (folder / "points.csv").write_text(
        "z_mm,psi_deg,theta_deg,read_x_mm,read_y_mm,read_z_mm\n"
        "1146,0,0,0,0,1146\n1146,90,10,0.1,0,1146\n1166,0,10,0,0.1,1166\n",
        "utf-8",
    )
    (folder / "map.toml").write_text('instrument = "camera_known_frame"\n', "utf-8")
    out = folder.parent / "session"
    command = ["import", "columns", folder / "points.csv", "--out", out]
    command += ["--machine", folder / "mine.py", "--map", folder / "map.toml"]
    assert oed(*command)[0] == 2
    assert not out.exists()
    assert oed(*command, "--allow-code")[0] == 0
    assert (out / "mine.py").read_text() == MACHINE
    assert oed("check", out / "points.study.toml")[0] != 2  # the same digest
    (out / "mine.py").write_text("# another", "utf-8")
    code, _, error = oed(*command, "--allow-code", "--name", "b")
    assert code == 2
    assert "importing overwrites nothing" in error


def test_campaigns_need_consent_in_each_process(folder, oed):
    (folder / "mine.py").write_text(
        MACHINE + "def figures(setting, seed):\n    return {'value': seed}\n", "utf-8"
    )
    path = folder / "own.campaign.toml"
    text = 'schema = 1\nname = "own"\ncase = "mine.py:figures"\nseeds = 4\n'
    path.write_text(text, "utf-8")
    command = ("campaign", path, "--out", folder / "out", "--workers", 2)
    assert oed(*command)[0] == 2
    assert runs(folder) == 0
    assert oed(*command, "--allow-code")[0] == 0
    rows = [json.loads(p.read_text()) for p in (folder / "out" / "cases").iterdir()]
    assert sorted(row["value"] for row in rows) == [1, 2, 3, 4]


def test_without_a_list_consent_ends_with_the_process(folder, monkeypatch, tmp_path):
    """As in a container whose home cannot be written."""
    (tmp_path / "file").write_text("", "utf-8")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    path = folder / "s.study.toml"
    resolve(study.Study.load(path, Consent.GIVEN))
    with pytest.raises(InputError, match="SHA-256"):
        resolve(study.Study.load(path))


def test_a_module_that_has_moved_has_a_remedy(folder, oed):
    (folder / "mine.py").write_text("from oed.machine import Machine\n", "utf-8")
    code, _, error = oed("check", folder / "s.study.toml", "--allow-code")
    assert code == 2
    assert "oed.machine" in error
    assert "from oed import Machine" in error
