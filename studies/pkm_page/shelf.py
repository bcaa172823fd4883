"""The results below a folder, each under a key that is no path."""

import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from oed import trust
from oed.result import StudyResult
from pkm_reports import text
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.results import load_result
from pkm_studies.study import SUFFIX

MAX_FOLDER_DEPTH: Final = 3  #: folders deep, and results, that are looked for
MAX_RESULTS: Final = 200
RESULT: Final = "result.json"
KEY_DIGITS: Final = 12  #: hexadecimal digits of a key


Card = dict[str, Any]  #: by the names that the template reads


class Shelf:
    """Folders with results below one folder; links to places outside are left out.

    found  results at the last look, those that are not shown included
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.found = 0
        self._cards: dict[tuple[str, int], Card] = {}

    def folders(self) -> dict[str, Path]:
        """Folders with a result by key, the newest first."""
        ordered = sorted(
            self._search(self.root, MAX_FOLDER_DEPTH),
            key=lambda folder: (folder / RESULT).stat().st_mtime,
            reverse=True,
        )
        self.found = len(ordered)
        return {self._key(folder): folder for folder in ordered[:MAX_RESULTS]}

    def folder(self, key: str) -> Path:
        """The folder of a key. Raises InputError for one that no folder has."""
        folders = self.folders()
        if key not in folders:
            raise InputError("there is no such result", "load the page again")
        return folders[key]

    def cards(self) -> list[Card]:
        """A card for each result that can be read."""
        return [
            card
            for key, folder in self.folders().items()
            if (card := self._card(key, folder)) is not None
        ]

    def _search(self, folder: Path, depth: int) -> Iterator[Path]:
        if (folder / RESULT).is_file():
            yield folder
        if not depth or not folder.is_dir():
            return
        for entry in sorted(folder.iterdir()):
            hidden = entry.name.startswith(".")
            if entry.is_dir() and not entry.is_symlink() and not hidden:
                yield from self._search(entry, depth - 1)

    def _key(self, folder: Path) -> str:
        relative = folder.relative_to(self.root).as_posix()
        return files.digest(relative.encode())[:KEY_DIGITS]

    def _card(self, key: str, folder: Path) -> Card | None:
        stamp = (folder / RESULT).stat().st_mtime_ns
        if (key, stamp) not in self._cards:
            try:
                result = load_result(folder)
            except InputError:
                return None
            self._cards[key, stamp] = self._result_card(key, folder, result)
        return self._cards[key, stamp]

    def _result_card(self, key: str, folder: Path, result: StudyResult) -> Card:
        """A result in short.

        key         of its folder, for addresses
        place       its folder, relative to the shelf's
        accuracy    before and after by component
        doubts      what speaks against it
        is_usable   whether a controller's file and an acceptance test follow from it
        is_planned  whether an acceptance test is planned
        verdict     of that test; None before
        """
        written = (folder / RESULT).stat().st_mtime
        day = datetime.datetime.fromtimestamp(written).isoformat(" ", "minutes")
        test = result.verification
        return {
            "key": key,
            "place": folder.relative_to(self.root).as_posix(),
            "title": text.cleaned(result.title),
            "machine": text.cleaned(result.machine.name),
            "written": day,
            "readings": _readings(result),
            "accuracy": _accuracy(result),
            "doubts": tuple(
                text.cleaned(sentence) for sentence in trust.objections(result)
            ),
            "is_usable": result.estimate is not None or result.prediction is not None,
            "is_planned": result.acceptance is not None,
            "verdict": None if test is None else test.judgement,
        }


def _readings(result: StudyResult) -> str:
    if result.estimate is not None:
        return text.count(len(result.estimate.residuals), "value") + " fitted"
    if result.design is not None:
        return text.count(len(result.design.poses), "reading") + " planned"
    return "no readings"


def _accuracy(result: StudyResult) -> tuple[tuple[str, str, str], ...]:
    """Rms of each component before and after, in the unit of its column."""
    prediction = result.prediction
    corrected = result.corrected
    if corrected is not None and corrected.prediction is not None:
        prediction = corrected.prediction
    if prediction is None:
        return ()
    return tuple(
        (
            text.cleaned(name),
            text.quantity(c.before.rms, c.before.unit),
            text.quantity(c.after.rms, c.after.unit),
        )
        for name, c in prediction.components.items()
    )


def study_files(folder: Path) -> dict[str, Path]:
    """The study files in a folder by key; links are left out."""
    if not folder.is_dir():
        return {}
    paths = sorted(folder.glob(f"*{SUFFIX}"))[:MAX_RESULTS]
    plain = [path for path in paths if path.is_file() and not path.is_symlink()]
    return {files.digest(path.name.encode())[:KEY_DIGITS]: path for path in plain}
