"""Work that takes longer than a reading: a command of `oed` in a process of its own."""

from __future__ import annotations

import dataclasses
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Final

from oed.child_process import start_python
from pkm_studies.base import InputError

if TYPE_CHECKING:
    from subprocess import Popen

#: module of the command
OED: Final = "pkm_studies.commands.cli"

#: lines of output that are kept
MOST_LINES: Final = 200
#: characters of a line
LONGEST: Final = 1000
#: stage after which a command says its results
LAST_STAGE: Final = "report"


@dataclasses.dataclass(frozen=True)
class CommandState:
    """What a job does: its name, the stage it is at, and its output at the end.

    code  exit code; None while it runs, and before the first job
    """

    name: str = ""
    stage: str = ""
    code: int | None = None
    lines: tuple[str, ...] = ()

    @property
    def runs(self) -> bool:
        """Whether a job is at work."""
        return bool(self.name) and self.code is None


class BackgroundCommand:
    """One command at a time, in the background."""

    def __init__(self) -> None:
        self.state = CommandState()
        self._process: Popen[str] | None = None
        self._lock = threading.Lock()

    def start(self, name: str, arguments: Sequence[str | Path]) -> None:
        """Start `oed` with arguments. Raises InputError while another command runs."""
        with self._lock:
            if self.state.runs:
                raise InputError(f"{self.state.name} is at work", "wait for its end")
            self._process = start_python(OED, arguments)
            self.state = CommandState(name, "starts")
        follow = threading.Thread(
            target=self._follow, args=(self._process,), daemon=True
        )
        follow.start()

    def stop(self) -> None:
        """End the process, if one runs, and wait for it."""
        process = self._process
        if process is not None and process.poll() is None:
            process.terminate()
            process.wait()

    def _follow(self, process: Popen[str]) -> None:
        """Take up stages as they are printed, then what the command says."""
        errors: list[str] = []
        listen = threading.Thread(target=_collect, args=(process.stderr, errors))
        listen.start()
        lines: list[str] = []
        with process:
            for line in process.stdout or ():
                lines.append(line.rstrip()[:LONGEST])
                self.state = dataclasses.replace(self.state, stage=lines[-1])
            listen.join()
        code = process.wait()
        said = [*_lines_after_stages(lines), *(errors if code else ())]
        self.state = dataclasses.replace(
            self.state, code=code, lines=tuple(said[-MOST_LINES:])
        )


def _collect(stream: IO[str] | None, lines: list[str]) -> None:
    lines += [line.rstrip()[:LONGEST] for line in stream or () if line.strip()]


def _lines_after_stages(lines: list[str]) -> list[str]:
    """The lines below the last stage, which is the report."""
    last = lines.index(LAST_STAGE) if LAST_STAGE in lines else -1
    return lines[last + 1 :]
