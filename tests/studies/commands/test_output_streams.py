"""An output that is closed or full is one line on stderr, and exit code 2."""

import subprocess
import sys
from pathlib import Path

import pytest

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
