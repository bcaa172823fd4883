"""All that the page of one machine can be asked for, apart from the web: plain values."""

from __future__ import annotations

import dataclasses
import datetime
import itertools
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Final

import msgspec

from oed.child_process import start_python
from oed.dataset import ReadingsColumn
from pkm_page import render, rows, show
from pkm_page.feed import Feed, Offer
from pkm_page.readings_log import StaleError
from pkm_page.session import DoubtfulError, MachineSession, ReadingEntry
from pkm_page.shelf import Shelf
from pkm_studies.base import InputError
from pkm_studies.results import BadFitError

if TYPE_CHECKING:
    from subprocess import Popen

POLL_SECONDS: Final = 0.5  #: time between two looks at the readings file, s
#: commands that evaluate the readings, by the word on the button
FITS: Final = ("identify", "diagnose")


class Change(msgspec.Struct, forbid_unknown_fields=True):
    """Another change of the readings as the page sends it."""

    version: str
    text: str = ""
    again: bool = False


class ResultChoice(msgspec.Struct, forbid_unknown_fields=True):
    """What to do with a result: a word of a list, and keys of results."""

    word: str = ""
    keys: list[str] = []

    @property
    def key(self) -> str:
        """The first key; empty without one."""
        return "".join(self.keys[:1])


class MachinePage:
    """A session with its background job, its line of readings and its results.

    study   file of the study, for commands; its text where no file has it
    folder  where readings and results lie
    """

    def __init__(self, session: MachineSession, study: Path, folder: Path) -> None:
        self.session, self.study, self.folder = session, study, folder
        self.job = BackgroundCommand()
        self.shelf = Shelf(folder)
        self.feed: Feed | None = None
        self.take_at_once = False
        self.offer: Offer | None = None
        self.doubt = ""
        self._counter = itertools.count(1)
        self._shown: tuple[object, dict[str, Any]] = (None, {})
        self._lock = threading.Lock()
        self._stopped = threading.Event()

    def stop(self) -> None:
        """End the background command and the watch."""
        self._stopped.set()
        self.job.stop()

    # -- state -------------------------------------------------------------------------
    def token(self) -> str:
        """Changes with everything that pages show."""
        state = self.session.state
        repeated = state.pose is not None and state.pose.repeated
        offer = 0 if self.offer is None else self.offer.number
        job = self.job.state
        problem = "" if self.feed is None else self.feed.problem
        parts = [
            state.content.version, repeated, state.problem, offer, self.doubt,
            job.name, job.stage, job.code, problem,
        ]  # fmt: skip
        return "|".join(map(str, parts))

    def state(self) -> dict[str, Any]:
        """Everything that pages show: parts as HTML, view, and what arrived by line."""
        with self._lock:
            state = self.session.state
            if self._shown[0] is not state:
                values = show.page_values(self.session, state)
                view = msgspec.to_builtins(show.view(self.session, state))
                self._shown = (state, {"values": values, "view": view})
            values = self._shown[1]["values"] | self._job_values()
        return {
            "token": self.token(),
            "version": state.content.version,
            "number": str(state.number),
            "parts": render.parts(values),
            "view": self._shown[1]["view"],
            "offer": self._offered(),
            "doubt": self.doubt,
        }

    def _job_values(self) -> dict[str, Any]:
        machine = self.session.measurement.machine.name
        cards = [card for card in self.shelf.cards() if card["machine"] == machine]
        return {
            "job": self.job.state,
            "cards": cards,
            "feed": "" if self.feed is None else self.feed.source,
            "feed_problem": "" if self.feed is None else self.feed.problem,
            "formats": format_names(),
        }

    def _offered(self) -> dict[str, Any] | None:
        """Texts for the entries from the line, as far as its columns fit the pose."""
        state, offer = self.session.state, self.offer
        if offer is None or state.pose is None:
            return None
        columns = rows.entry_columns(self.session.measurement, state.pose.series.setup)
        texts = []
        for c in columns:
            if c.name not in offer.values:
                return None
            factor = ReadingsColumn.of(c.name, c.unit).factor
            texts.append(f"{offer.values[c.name] / factor:.10g}")
        return {"number": offer.number, "entries": texts}

    # -- changes -----------------------------------------------------------------------
    def take(self, entry: ReadingEntry) -> None:
        """Take a reading. Raises as `MachineSession.take`."""
        self.session.take(entry)
        self.offer, self.doubt = None, ""

    def arrived(self, offer: Offer) -> None:
        """Numbers from the line: shown in the entries, or taken at once where wanted."""
        self.offer = offer
        self.doubt = ""
        offered = self._offered()
        if not self.take_at_once or offered is None:
            return
        entry = ReadingEntry(
            version=self.session.state.content.version,
            key=f"line {next(self._counter)}",
            entries=offered["entries"],
        )
        try:
            self.take(entry)
        except (DoubtfulError, StaleError, InputError, OSError) as error:
            self.doubt = str(error) or "The file changed meanwhile."

    def fit(self, word: str) -> None:
        """Evaluate the readings in the background. Raises InputError."""
        if word not in FITS:
            raise InputError("no such evaluation", "load the page again", value=word)
        if self.session.state.fitted is None:
            raise InputError("there is no reading yet", "take one first")
        day = datetime.date.today().isoformat()
        out = self.folder / f"measured-{day}"
        readings = self.session.log.path
        self.job.start(word, [word, self.study, "--readings", readings, "--out", out])

    def plan_acceptance(self, key: str) -> None:
        """Plan the acceptance test of a result in the background. Raises InputError."""
        folder = self.shelf.folder(key)
        self.job.start("acceptance test", ["verify", folder])

    def watch(self) -> None:
        """Look at the readings file twice a second, in a thread, until it stops."""

        def look() -> None:
            while not self._stopped.wait(POLL_SECONDS):
                try:
                    self.session.refresh()
                except (InputError, OSError):
                    continue

        threading.Thread(target=look, daemon=True).start()


def format_names() -> list[str]:
    """Formats of controllers that the catalogue has; no file of a user's."""
    from pkm_studies import catalogue

    return [entry.name for entry in catalogue.listing("formats")]


def compensation_files(folder: Path, word: str) -> dict[str, Any]:
    """Files of a format for the result in a folder, written there as by the command."""
    from pkm_studies.compensation import export_folder

    if word not in format_names():
        raise InputError("no such format", "choose one of the list", value=word)
    try:
        written = export_folder(folder, word)
    except BadFitError as error:
        raise InputError(str(error), "look for the cause first") from error
    texts = {path.name: path.read_text(encoding="utf-8") for path in written.paths}
    return {"files": texts, "sentences": list(written.sentences)}


def comparison(folders: list[Path]) -> str:
    """The report of two results side by side, as HTML. Raises InputError."""
    from pkm_studies.sessions import write_comparison

    if len(folders) != 2:
        raise InputError("two results are compared", "choose two")
    with tempfile.TemporaryDirectory(prefix="oed-") as scratch:
        paths = write_comparison(folders, Path(scratch))
        page = next(path for path in paths if path.suffix == ".html")
        return page.read_text(encoding="utf-8")


def stored_report(folder: Path) -> str:
    """The report of a result, as HTML: the folder's, else one that is made now."""
    from pkm_reports import write_report
    from pkm_studies.results import load_result

    path = folder / "report.html"
    if path.is_file() and not path.is_symlink():
        return path.read_text(encoding="utf-8")
    with tempfile.TemporaryDirectory(prefix="oed-") as scratch:
        (page,) = write_report(load_result(folder), Path(scratch), pdf=False)
        return page.read_text(encoding="utf-8")


# Work that takes longer than a reading: a command of `oed` in a process of its own.

OED: Final = "pkm_studies.commands.cli"  #: module of the command

MAX_LINES: Final = 200  #: lines of output that are kept
MAX_LINE_CHARACTERS: Final = 1000  #: characters of a line
LAST_STAGE: Final = "report"  #: stage after which a command says its results


@dataclasses.dataclass(frozen=True)
class CommandState:
    """What a job does: its name, the stage it is at, and its output at the end."""

    name: str = ""
    stage: str = ""
    code: int | None = None  #: exit code; None while it runs, and before the first job
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
                lines.append(line.rstrip()[:MAX_LINE_CHARACTERS])
                self.state = dataclasses.replace(self.state, stage=lines[-1])
            listen.join()
        code = process.wait()
        last = lines.index(LAST_STAGE) if LAST_STAGE in lines else -1
        said = [*lines[last + 1 :], *(errors if code else ())]
        self.state = dataclasses.replace(
            self.state, code=code, lines=tuple(said[-MAX_LINES:])
        )


def _collect(stream: IO[str] | None, lines: list[str]) -> None:
    lines += [
        line.rstrip()[:MAX_LINE_CHARACTERS] for line in stream or () if line.strip()
    ]
