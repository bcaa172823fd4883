"""The folder of a result: result.json, whose its files are, and their reports."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Final

import msgspec
from msgspec.structs import replace

from oed import safe_files
from oed.result import StudyResult
from oed.verdict import accuracy_verdicts
from pkm_studies import files
from pkm_studies.base import InputError
from pkm_studies.results import load_result, read_result

RESULT = "result.json"
VISIT = "second_visit.csv"  #: readings of a second visit, to fill in
#: files that are written after the result
PAGES = ("report.html", "report.pdf", "measurement_sheet.pdf")


def prepare(folder: Path) -> None:
    """Make the folder of a result. Raises InputError; also for a foreign result.json."""
    files.make_folder(folder)
    written_before(folder)


def write(
    folder: Path,
    result: StudyResult,
    texts: Mapping[str, str],
    further: Mapping[str, Callable[[Path], Path]],
) -> StudyResult:
    """Write a run's files by name, then result.json, which names them.

    further  writes a file to a path, and returns the path that it took

    A file that the user changed, as by filling readings into poses.csv, stays, and the new
    one gets another name. Returns the result with the digests of the files. Raises
    InputError where one of the files cannot be written, once the others are.
    """
    earlier_files = written_before(folder)
    written: dict[str, str] = {}
    names: dict[str, str] = {}
    refused: list[OSError] = []
    for name, text in texts.items():
        with _collected(refused):
            path = safe_files.write_own(folder / name, text.encode(), earlier_files)
            written[path.name] = files.digest(text.encode())
            names[name] = path.name
    for name, save in further.items():
        with _collected(refused):
            names[name] = save(folder / name).name
    warnings = [*result.warnings, *renamed_sentences(names), *set_aside_foreign(folder)]
    warnings += [f"this file was not written: {files.refusal(e)}" for e in refused]
    result = replace(result, written=written, warnings=warnings)
    write_result(folder, result)
    if refused:
        raise files.refusal(refused[0], f"; {RESULT} is written, without this file")
    return result


@contextlib.contextmanager
def _collected(refused: list[OSError]) -> Iterator[None]:
    """Collect what the disk refuses: the files after it are still to be written."""
    try:
        yield
    except OSError as error:
        refused.append(error)


def add_files(
    folder: Path, result: StudyResult, texts: Mapping[str, str]
) -> tuple[StudyResult, list[Path]]:
    """Write further files by name beside a result of the folder, which names them.

    Returns the result with their digests, and their paths.
    """
    earlier_files, written = written_before(folder), dict(result.written)
    paths = []
    for name, text in texts.items():
        path = safe_files.write_own(folder / name, text.encode(), earlier_files)
        written[path.name] = files.digest(text.encode())
        paths.append(path)
    result = replace(result, written=written)
    rewrite(folder, result)
    return result, paths


def rewrite(folder: Path, result: StudyResult) -> None:
    """Write result.json again with present verdicts, and the reports that there are."""
    result = replace(result, verdicts=accuracy_verdicts(result))
    set_aside_foreign(folder)
    write_result(folder, result)
    html, pdf = ((folder / f"report.{kind}").is_file() for kind in ("html", "pdf"))
    if html or pdf:
        write_report(folder, html=html, pdf=pdf)


#: words of every sentence on a file that a user changed, and that stays
CHANGED: Final = "is not as this version wrote it"


def changed_files(folder: Path) -> list[str]:
    """Sentences on reports and sheets that the user changed, and that stay."""
    names = {name: safe_files.latest(folder / name).name for name in PAGES}
    return list(renamed_sentences(names))


def renamed_sentences(names: Mapping[str, str]) -> Iterator[str]:
    """Sentences on files that were written under another name."""
    for name, written in names.items():
        if written != name:
            yield (
                f"the file {name} {CHANGED}, and stays as it is;"
                f" the new one is {written}"
            )


def set_aside_foreign(folder: Path) -> list[str]:
    """Rename a result.json that is not as it was written; a sentence about it."""
    path = folder / RESULT
    if not path.exists() or safe_files.is_own(path):
        return []
    return [
        f"the file {RESULT} was not as this version wrote it, and is now"
        f" {safe_files.set_aside(path, 'earlier').name}"
    ]


def write_result(folder: Path, result: StudyResult) -> None:
    """Write result.json, or a temporary one. Raises InputError that says where it is."""
    encoded = msgspec.json.format(msgspec.json.encode(result), indent=1)
    try:
        safe_files.write_own(folder / RESULT, encoded)
    except OSError as error:
        further = "; the result is lost: no temporary folder takes it either"
        with contextlib.suppress(OSError, InputError):
            rescue = Path(tempfile.mkdtemp(prefix="oed-"), RESULT)
            files.write_whole(rescue, encoded)
            further = f"; the result is kept in {rescue}"
        raise files.refusal(error, further) from error


def written_before(folder: Path) -> list[str]:
    """Digests of the files that an earlier run wrote into the folder."""
    path = folder / RESULT
    if not path.exists():
        return []
    try:
        return list(read_result(path).written.values())
    except InputError as error:
        problem = "this file is no result, and it is not overwritten"
        raise InputError(problem, "name another folder", file=str(path)) from error


def write_report(
    folder: Path, *, html: bool = True, pdf: bool = True, full: bool = False
) -> tuple[Path, ...]:
    """HTML and PDF reports of the result in a folder, the PDF short or in full; paths."""
    from pkm_reports import write_report

    result = load_result(folder)
    return write_report(result, folder, html=html, pdf=pdf, full=full)
