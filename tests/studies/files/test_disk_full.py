"""Disks that are full, read-only or beyond a quota: said as such, nothing half, nothing
lost that was computed."""

import errno
import json
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
import sample

from pkm_studies import files
from pkm_studies.commands import main

STUDY = (
    sample.DELTA
    + "[readings]\nfiles = ['r.csv']\n[posterior]\nsteps = 100\n"
    + "[report]\nhtml = false\npdf = false\n"
)


class Disk:
    """A disk with room for some bytes of each file below a folder, or of those of a name."""

    def __init__(
        self, folder: Path, room: int, number: int = errno.ENOSPC, name: str = ""
    ) -> None:
        self.folder, self.room, self.number, self.name = folder, room, number, name
        self.write = Path.write_bytes

    def write_bytes(self, path: Path, data: bytes) -> int:
        is_here = path.absolute().is_relative_to(self.folder) and self.name in path.name
        if is_here and len(data) > self.room:
            self.write(path, data[: self.room])
            raise OSError(self.number, os.strerror(self.number))
        return self.write(path, data)

    def install(self, patch: pytest.MonkeyPatch) -> None:
        patch.setattr(Path, "write_bytes", lambda p, data: self.write_bytes(p, data))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    folder = tmp_path / "disk"
    folder.mkdir()
    (folder / "s.study.toml").write_text(STUDY, encoding="utf-8")
    (folder / "r.csv").write_text(sample.DELTA_READINGS, encoding="utf-8")
    (folder / "p.study.toml").write_text(sample.STUDY, encoding="utf-8")
    sample.write_campaign(folder, [1])
    return folder


def content(folder: Path) -> dict[str, bytes]:
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def test_a_result_is_kept_where_its_draws_find_no_room(folder, monkeypatch, capsys):
    """First a disk for the result without its draws, then one for neither."""
    study, out = folder / "s.study.toml", folder / "out"
    assert main(["run", str(study), "--out", str(folder / "whole"), "--quiet"]) == 1
    whole = folder / "whole"
    capsys.readouterr()
    with monkeypatch.context() as patched:
        Disk(folder, 1000, name="posterior.nc").install(patched)
        assert main(["run", str(study), "--out", str(out), "--quiet"]) == 2
    said = capsys.readouterr().err
    assert "posterior.nc: no space left on device; make room" in said
    assert "result.json is written, without this file" in said
    assert "check the name" not in said
    stored, expected = (
        json.loads((at / "result.json").read_text("utf-8")) for at in (out, whole)
    )
    assert stored["estimate"] == expected["estimate"]
    assert any("posterior.nc: no space" in w for w in stored["warnings"])
    names = {p.name for p in out.iterdir() if p.is_file()}
    assert names == {p.name for p in whole.iterdir()} - {"posterior.nc"}

    elsewhere = folder.parent / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(elsewhere))
    Disk(folder, 0).install(monkeypatch)
    assert main(["run", str(study), "--out", str(folder / "b"), "--quiet"]) == 2
    said = capsys.readouterr().err
    (kept,) = elsewhere.rglob("result.json")
    assert f"the result is kept in {kept}" in said
    assert json.loads(kept.read_text("utf-8"))["estimate"] == expected["estimate"]
    assert content(folder / "b") == {}


COMMANDS = {
    "simulate": ["simulate", "p.study.toml", "--out", "simulated.csv"],
    "picture": ["check", "s.study.toml", "--picture", "closure.png"],
    "campaign": ["campaign", "own.campaign.toml", "--workers", "1", "--allow-code"],
}


@pytest.mark.parametrize("room", [0, 700])
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_leaves_nothing_half(folder, command, room, monkeypatch, capsys):
    """Of files that go together, as readings and their truth, neither or both."""
    monkeypatch.chdir(folder)
    before = content(folder)
    Disk(folder, room).install(monkeypatch)
    code = main(COMMANDS[command])
    said = capsys.readouterr().err
    assert code == 2, said
    assert "no space left on device; make room on this disk" in said
    after = content(folder)
    assert {k: v for k, v in after.items() if k in before} == before
    new = {Path(name).name for name in after if name not in before}
    assert new <= {"campaign.toml", "0001-000001.json", "0001-000002.json"}


@pytest.mark.parametrize(("number", "words"), [
    (errno.ENOSPC, "make room on this disk"),
    (errno.EDQUOT, "remove files of yours"),
    (errno.EFBIG, "ulimit -f"),
    (errno.EROFS, "that can be written to"),
    (errno.EACCES, "its permissions"),
])  # fmt: skip
def test_what_the_disk_refuses_is_said_as_such(tmp_path, monkeypatch, number, words):
    Disk(tmp_path, 0, number).install(monkeypatch)
    with pytest.raises(OSError, match=re.escape(os.strerror(number))) as caught:
        files.write_whole(tmp_path / "a.csv", "text")
    said = str(files.refusal(caught.value))
    assert said.startswith(f"{tmp_path / 'a.csv'}: {os.strerror(number).lower()}; ")
    assert words in said
    assert list(tmp_path.iterdir()) == []


def test_files_that_go_together_are_all_written_or_none(tmp_path, monkeypatch):
    one, two = tmp_path / "one", tmp_path / "two"
    two.write_text("before", encoding="utf-8")
    Disk(tmp_path, 5).install(monkeypatch)
    with pytest.raises(OSError, match="No space") as caught:
        files.write_all({one: "short", two: "longer"})
    assert caught.value.filename == str(two)
    assert content(tmp_path) == {"two": b"before"}
    assert files.write_all({one: "short", two: "after"}) == (one, two)
    assert content(tmp_path) == {"one": b"short", "two": b"after"}


def test_the_system_s_own_limit_ends_in_no_crash(tmp_path):
    """HDF5 never writes to the disk: what it cannot close would end the process."""
    code = (
        "import sys, numpy as np, resource\n"
        "from pathlib import Path\n"
        "from oed import safe_files\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        "try:\n"
        "    safe_files.write_own(Path(sys.argv[1]), bytes(2000))\n"
        "except OSError as error:\n"
        "    print(error.errno, error.filename)\n"
    )
    path = tmp_path / "posterior.nc"
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.split() == [str(errno.EFBIG), str(path)]
    assert list(tmp_path.iterdir()) == []
