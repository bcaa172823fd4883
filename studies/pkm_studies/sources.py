"""Where readings come from: files of the study, or a named collection of data converted
as it is read.

`delta_v400`: four sessions of a linear delta printer (FLSun V400, firmware Klipper,
CC0). Its tables give carriage travel in steps down from the endstop; `heights.csv` has
one probe contact a row, `distances.csv` one calliper distance between two positions a
row. Session S04 becomes the set-ups `S04_probe` (one run) and `S04_calliper` (one run
of two rows for each distance, the first its reference).

`hangprinter_hp4`: 44 poses of a cable robot (Hangprinter HP4, MIT), `motor_deg.csv` the
motors' angles from the origin, one pose a row; `known_xyz_mm.csv` says where a camera
saw the mover in the first nine. These become `known_camera` (where it was) and
`known_lines` (that the four lines agree: a gap of 0), the other 35 `other_lines`.
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

from oed import dataset, readings_table
from oed.dataset import Dataset, ReadingsError
from oed.measurement import Measurement
from pkm_studies import files
from pkm_studies.errors import InputError, Place, SourceAbsentError, shorten, suggest
from pkm_studies.study import Study

LIMIT = 20_000_000
Row = dict[str, str]


def readings(study: Study, measurement: Measurement) -> Dataset:
    """The readings that [readings] names. Raises InputError, SourceAbsentError where a
    source is not there.
    """
    said = study.readings
    assert said is not None
    place = study.place.key("readings")
    if said.source is None:
        found = from_files([study.folder / name for name in said.files], measurement)
    else:
        found = _source(study, measurement)
    for field, names in (("fit", said.fit or []), ("predict", said.predict)):
        for i, name in enumerate(names):
            if name not in found.setups:
                remedy = suggest(name, found.setups, "set-ups with readings")
                raise (
                    place.key(field)
                    .item(i)
                    .error("no reading was taken in this set-up", remedy, name)
                )
    return found


def from_files(paths: Sequence[Path], measurement: Measurement) -> Dataset:
    """Readings files taken together. Raises InputError."""
    try:
        return dataset.load(paths, measurement)
    except ReadingsError as error:
        raise _as_input(error) from error
    except OSError as error:
        raise unreadable(error, paths[0]) from error


def check_text(path: Path) -> int:
    """Check a readings file without a machine: columns, numbers, order. Returns its
    rows. Raises InputError.
    """
    try:
        return len(readings_table.read(path).frame)
    except ReadingsError as error:
        raise _as_input(error) from error
    except OSError as error:
        raise unreadable(error, path) from error


def unreadable(error: OSError, path: Path) -> InputError:
    """A file that the system does not give."""
    problem = (error.strerror or "it cannot be read").lower()
    return InputError(
        problem,
        "check the name, the folder you are in and its permissions",
        file=str(error.filename or path),
    )


def _as_input(error: ReadingsError) -> InputError:
    where = ", ".join(
        ([f"row {error.row}"] if error.row else [])
        + ([f"column {error.column}"] if error.column else [])
    )
    return InputError(
        error.problem, error.remedy, file=error.file, field=where, value=error.value
    )


def _source(study: Study, measurement: Measurement) -> Dataset:
    said = study.readings
    assert said is not None
    assert said.source is not None
    place = study.place.key("readings")
    if said.source not in SOURCES:
        raise place.key("source").error(
            "no such source", suggest(said.source, SOURCES), said.source
        )
    if said.path is None:
        raise place.key("path").error(
            "missing", f"say where {said.source} is, relative to the study"
        )
    folder = (study.folder / said.path).resolve()
    if not folder.is_dir():
        problem = f"{said.source} is not there (looked in {folder})"
        remedy = "put the data there, or change the path"
        raise SourceAbsentError(problem, remedy, file=place.file, field="readings.path")
    rows = list(SOURCES[said.source](folder))
    known = [r for r in rows if r["setup"] in measurement.setups]
    if not known:
        names = list(dict.fromkeys(r["setup"] for r in rows))
        raise study.place.key("setup").error(
            "no set-up has readings in the source", suggest("", names, "it has")
        )
    return _build(known, str(folder), measurement)


def _build(rows: Sequence[Row], name: str, measurement: Measurement) -> Dataset:
    """Readings from rows of text by column name; numbered as if they were a readings
    file.
    """
    header = list(dict.fromkeys(key for row in rows for key in row))
    cells = [
        (i, [row.get(key, "") for key in header]) for i, row in enumerate(rows, start=2)
    ]
    try:
        return dataset.from_tables(
            [readings_table.from_rows([(1, header), *cells], name)], measurement
        )
    except ReadingsError as error:
        raise _as_input(error) from error


def _delta_v400(folder: Path) -> Iterator[Row]:
    step = {
        s["session"]: s["step_distance_mm"] for s in _json(folder / "sessions.json")
    }
    for r in _csv(
        folder / "heights.csv",
        ("session", "i", "height_mm", "steps_a", "steps_b", "steps_c"),
    ):
        joints = _joints(r, "steps_", step, folder / "heights.csv")
        label = {"setup": f"{r['session']}_probe", "run": "1", "order": r["i"]}
        yield label | joints | {"height_mm": r["height_mm"]}
    named = (
        "session",
        "i",
        "distance_mm",
        "p1_a",
        "p1_b",
        "p1_c",
        "p2_a",
        "p2_b",
        "p2_c",
    )
    for r in _csv(folder / "distances.csv", named):
        label = {"setup": f"{r['session']}_calliper", "run": f"distance {r['i']}"}
        first, second = (
            _joints(r, f"p{k}_", step, folder / "distances.csv") for k in (1, 2)
        )
        yield label | {"order": "1"} | first
        yield label | {"order": "2"} | second | {"length_mm": r["distance_mm"]}


def _joints(row: Row, prefix: str, step: dict[str, list[float]], path: Path) -> Row:
    """q1_mm.. from steps of the towers a, b, c; repr keeps every digit."""
    place = Place(str(path), f"session {row['session']}, i {row['i']}")
    try:
        sizes = step[row["session"]]
        return {
            f"q{k + 1}_mm": repr(float(row[prefix + t]) * sizes[k])
            for k, t in enumerate("abc")
        }
    except (KeyError, ValueError, IndexError, TypeError) as error:
        problem = f"no step size or no number: {shorten(str(error), 80)}"
        raise place.error(problem, "take the file as published") from None


def _hangprinter_hp4(folder: Path) -> Iterator[Row]:
    motors = _csv(folder / "motor_deg.csv", ("A", "B", "C", "D"))
    known = _csv(folder / "known_xyz_mm.csv", ("x", "y", "z"))
    joints = [
        {f"q{k + 1}_deg": r[line] for k, line in enumerate("ABCD")} for r in motors
    ]
    for i, at in enumerate(known):
        label = {"setup": "known_camera", "run": "1", "order": str(i + 1)}
        yield label | joints[i] | {f"read_{k}_mm": at[k] for k in "xyz"}
    for i, pose in enumerate(joints):
        name, first = (
            ("known_lines", 0) if i < len(known) else ("other_lines", len(known))
        )
        yield (
            {"setup": name, "run": "1", "order": str(i - first + 1)}
            | pose
            | {"gap_mm": "0"}
        )


def _csv(path: Path, columns: Sequence[str]) -> list[Row]:
    reader = csv.DictReader(io.StringIO(_read(path)))
    absent = [c for c in columns if c not in (reader.fieldnames or ())]
    if absent:
        raise Place(str(path)).error(
            f"the column {absent[0]} is missing", "take the file as published"
        )
    return [{k: v or "" for k, v in row.items() if k} for row in reader]


def _json(path: Path) -> Any:
    try:
        return json.loads(_read(path))
    except ValueError as error:
        raise Place(str(path)).error(
            f"no JSON: {shorten(str(error), 80)}", "take the file as published"
        ) from None


def _read(path: Path) -> str:
    if not path.is_file():
        raise SourceAbsentError(
            "the data is not there",
            "put the data there, or change readings.path",
            file=str(path),
        )
    return files.read_text(path, limit=LIMIT, what="data file")


SOURCES: dict[str, Callable[[Path], Iterator[Row]]] = {
    "delta_v400": _delta_v400,
    "hangprinter_hp4": _hangprinter_hp4,
}
