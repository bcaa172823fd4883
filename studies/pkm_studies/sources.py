"""Loads the readings of a study: its files, or a published collection of data."""

import contextlib
from collections.abc import Iterator, Sequence
from pathlib import Path

from oed import dataset
from oed.dataset import Dataset, ReadingsError
from oed.measurement import Measurement
from oed.text import suggest
from pkm_studies.base import InputError, SourceAbsentError
from pkm_studies.plugins import project_plugins
from pkm_studies.study import Row, Study
from pkm_studies.tables import ReadingsTable


def readings(table: ReadingsTable, study: Study, measurement: Measurement) -> Dataset:
    """The readings that [readings] names. Raises InputError, SourceAbsentError."""
    if table.source is None:
        data = read_files([study.folder / name for name in table.files], measurement)
    else:
        data = _source_rows(table.source, table, study, measurement)
    for field, names in (("fit", table.fit or []), ("predict", table.predict)):
        location = study.location.path("readings", field)
        for i, name in enumerate(names):
            if name not in data.setups:
                remedy = suggest(name, data.setups, "set-ups with readings")
                problem = "no reading was taken in this set-up"
                raise location.item(i).error(problem, remedy, name)
    return data


def read_files(paths: Sequence[Path], measurement: Measurement) -> Dataset:
    """Readings files taken together. Raises InputError."""
    return read_sessions([paths], measurement)[0]


def read_sessions(
    sessions: Sequence[Sequence[Path]], measurement: Measurement
) -> tuple[Dataset, tuple[int, ...]]:
    """Readings of several sessions, and the restarted clocks. Raises InputError."""
    with _named_errors(sessions[0][0]):
        return dataset.load_sessions(sessions, measurement)


def check_text(path: Path) -> int:
    """The number of rows of a readings file, without a machine. Raises InputError."""
    with _named_errors(path):
        return dataset.count_rows(path)


@contextlib.contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    """InputError for readings that are none, and for a file that the system withholds."""
    try:
        yield
    except ReadingsError as error:
        where = [f"row {error.row}"] if error.row else []
        where += [f"column {error.column}"] if error.column else []
        raise InputError(
            error.problem,
            error.remedy,
            file=error.file,
            field=", ".join(where),
            value=error.value,
        ) from error
    except OSError as error:
        raise InputError(
            (error.strerror or "it cannot be read").lower(),
            "check the name, the folder you are in and its permissions",
            file=str(error.filename or path),
        ) from error


def _source_rows(
    source: str, table: ReadingsTable, study: Study, measurement: Measurement
) -> Dataset:
    """Readings of a collection in the set-ups that the study knows."""
    location = study.location.key("readings")
    collections = project_plugins("sources")
    if source not in collections:
        remedy = suggest(source, collections)
        raise location.key("source").error("no such source", remedy, source)
    if table.path is None:
        raise location.key("path").error(
            "missing", f"say where {source} is, relative to the study"
        )
    folder = (study.folder / table.path).resolve()
    if not folder.is_dir():
        raise SourceAbsentError(
            f"{source} is not there (looked in {folder})",
            "put the data there, or change the path",
            file=location.file,
            field="readings.path",
        )
    rows: list[Row] = list(collections[source].load()(folder))
    of_setups = [row for row in rows if row["setup"] in measurement.setups]
    if not of_setups:
        names = dict.fromkeys(row["setup"] for row in rows)
        raise study.location.key("setup").error(
            "no set-up has readings in the source", suggest("", names, "it has")
        )
    with _named_errors(folder):
        return dataset.from_rows(of_setups, str(folder), measurement)
