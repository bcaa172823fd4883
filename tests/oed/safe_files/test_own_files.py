"""Files are replaced while they are as written; what a user changed stays."""

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from oed import safe_files
from oed.safe_files import is_own, latest, write_own


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()} - {safe_files.LIST_NAME}


def test_an_unchanged_file_is_replaced(tmp_path):
    path = tmp_path / "a.txt"
    for content in (b"1", b"2", b"1"):
        assert write_own(path, content) == path
        assert path.read_bytes() == content
        assert is_own(path)
    assert names(tmp_path) == {"a.txt"}


def test_a_changed_file_stays_and_the_new_one_gets_a_number(tmp_path):
    path = tmp_path / "a.txt"
    write_own(path, b"1")
    path.write_bytes(b"mine")
    for content in (b"2", b"3"):
        assert write_own(path, content) == tmp_path / "a-2.txt"
    assert latest(path) == tmp_path / "a-2.txt"
    (tmp_path / "a-2.txt").write_bytes(b"mine as well")
    assert write_own(path, b"4") == tmp_path / "a-3.txt"
    kept = [p.read_bytes() for p in sorted(tmp_path.glob("a*"))]
    assert kept == [b"mine as well", b"4", b"mine"]
    path.unlink()
    assert write_own(path, b"5") == path == latest(path)


def test_a_file_that_nobody_listed_stays(tmp_path):
    """Also where the list is gone or broken; a digest known otherwise is one's own."""
    path = tmp_path / "a.txt"
    path.write_bytes(b"old")
    assert write_own(path, b"new").name == "a-2.txt"
    digest = hashlib.sha256(b"old").hexdigest()
    assert write_own(path, b"newer", [digest]) == path
    for broken in (b"", b"[]", b"{", b'{"a.txt": 3}', b'{"a.txt": [[]]}', b"\xff"):
        (tmp_path / safe_files.LIST_NAME).write_bytes(broken)
        assert not is_own(path)
        assert write_own(path, b"newest") != path
    assert path.read_bytes() == b"newer"


def test_the_same_content_is_no_other_file(tmp_path):
    path = tmp_path / "a.txt"
    path.write_bytes(b"same")
    assert write_own(path, b"same") == path


def test_a_failure_leaves_everything_as_it_was(tmp_path, monkeypatch):
    def full(part: Path) -> None:
        raise OSError(28, "No space left on device", str(part))

    path = tmp_path / "a.txt"
    write_own(path, b"1")

    monkeypatch.setattr(safe_files, "flush", full)
    with pytest.raises(OSError, match="No space") as error:
        write_own(path, b"2")
    assert error.value.filename == str(path)
    assert path.read_bytes() == b"1"
    assert names(tmp_path) == {"a.txt"}


def test_files_set_aside_get_names_that_are_free(tmp_path):
    path = tmp_path / "result.json"
    for text in "ab":
        path.write_text(text)
        safe_files.set_aside(path, "earlier")
    assert (tmp_path / "result-earlier.json").read_text() == "a"
    assert (tmp_path / "result-earlier-2.json").read_text() == "b"


KILLED = """
import os, signal, sys
from pathlib import Path
from oed.safe_files import whole_file
with whole_file(Path(sys.argv[1])) as part:
    part.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_goes_at_the_next_write(tmp_path):
    """Files of other names, of other computers and of running processes stay."""
    path = tmp_path / "report.html"
    done = subprocess.run([sys.executable, "-c", KILLED, str(path)], check=False)
    assert done.returncode == -signal.SIGKILL
    (left,) = tmp_path.iterdir()
    assert left.name.startswith(".report.html.")
    stay = [
        f".a.{safe_files.HOST_MARK}-{os.getppid()}.part",
        f".a.00000000-{2**22 + 1}.part",
        ".mine.part",
        ".a.123.part",
        f"a.{safe_files.HOST_MARK}-1.part",
    ]
    for name in stay:
        (tmp_path / name).write_text("", "utf-8")
    old = tmp_path / f".old.00000000-{2**22 + 1}.part"
    old.write_text("", "utf-8")
    os.utime(old, (time.time() - 8 * 86400.0,) * 2)
    safe_files._remove_stale.cache_clear()
    write_own(path, b"whole")
    assert names(tmp_path) == {"report.html", *stay}


def test_errors_never_name_the_temporary_file(tmp_path):
    """As where the name is just short enough for the file itself."""
    long = tmp_path / ("n" * 250)
    with pytest.raises(OSError, match="too long") as error:
        write_own(long, b"")
    assert error.value.filename == str(long)
    assert ".part" not in str(error.value)
    folder = tmp_path / "gone"
    with pytest.raises(OSError, match="No such file") as error:
        write_own(folder / "a", b"")
    assert ".part" not in str(error.value)

    with (
        pytest.raises(OSError, match="cannot be written") as error,
        safe_files.temporary_file(tmp_path / "a") as part,
    ):
        raise OSError(0, f"unable to open {part}")
    assert ".part" not in str(error.value)
