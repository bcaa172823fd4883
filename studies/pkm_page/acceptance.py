"""The acceptance test of a result on the page: the file to fill in, and its judgement."""

from __future__ import annotations

import datetime
import tempfile
from pathlib import Path
from typing import Final

import msgspec

from pkm_studies import files
from pkm_studies.acceptance import (
    ACCEPTANCE_FILE,
    judge_folder,
    verdict_sentences,
)
from pkm_studies.base import InputError
from pkm_studies.results import BadFitError

#: bytes of a file to fill in
MOST_BYTES: Final = 1_000_000


class FilledIn(msgspec.Struct, forbid_unknown_fields=True):
    """A filled-in file as the page sends it, and the key of its result."""

    key: str
    text: str


def to_fill_in(folder: Path) -> str:
    """The file that the plan of the test wrote. Raises InputError where none is."""
    path = folder / ACCEPTANCE_FILE
    if not path.is_file() or path.is_symlink():
        raise InputError("no acceptance test is planned", "plan it first")
    return files.read_text(path, limit=MOST_BYTES, what="acceptance file")


def judge(folder: Path, text: str) -> list[str]:
    """The verdict on a filled-in file, which is then stored beside the result.

    Raises InputError for what cannot be judged; nothing is stored then.
    """
    with tempfile.TemporaryDirectory(prefix="oed-") as place:
        path = files.write_whole(Path(place) / ACCEPTANCE_FILE, text)
        try:
            verdict = judge_folder(folder, path)
        except BadFitError as error:
            raise InputError(str(error), "look for the cause first") from error
        except InputError as error:
            raise InputError(
                error.problem, error.remedy, field=error.field, value=error.value
            ) from error
    now = datetime.datetime.now().isoformat(timespec="microseconds").replace(":", "")
    stored = files.write_whole(folder / f"acceptance-measured-{now}.csv", text)
    return [*verdict_sentences(verdict), f"Stored as {stored.name}."]
