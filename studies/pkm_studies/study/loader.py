"""Study files: TOML into the frozen structs of `study_tables`. No kernel here: see
`resolve` for what it means.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from pkm_studies import files
from pkm_studies.errors import Place, shorten
from pkm_studies.study import decode
from pkm_studies.study.tables import ReadingsTable, StudyFile

SCHEMA = 1
LIMIT = 2_000_000  # bytes
SUFFIX = ".study.toml"


class Study(StudyFile, frozen=True, kw_only=True):
    """A study as loaded: its file and its text beside what it says."""

    path: Path
    text: str

    @property
    def place(self) -> Place:
        """The file, for errors."""
        return Place(str(self.path))

    @property
    def folder(self) -> Path:
        """Folder that paths in the study are relative to."""
        return self.path.parent


def load(path: Path | str) -> Study:
    """Read and check a study file. Raises InputError that names file, field, value and
    remedy.
    """
    path = Path(path)
    text = files.read_text(path, limit=LIMIT, what="study file")
    return parse(text, path)


def parse(text: str, path: Path) -> Study:
    """As `load`, from text; `path` is what errors name and what paths in the study are
    relative to.
    """
    place = Place(str(path))
    try:
        table = _toml(text, place)
        decode.finite(table, place)
    except RecursionError:
        raise place.error(
            "tables or lists are nested too deeply", "see `oed schema study`"
        ) from None
    _schema(table, place)
    said = decode.decode(StudyFile, table, place)
    _one_by_one(said, place)
    fields = {f: getattr(said, f) for f in said.__struct_fields__}
    return Study(**fields, path=path, text=text)


def _toml(text: str, place: Place) -> dict[str, Any]:
    try:
        return tomllib.loads(text)
    except ValueError as error:
        what = shorten(str(error), 100)
        raise place.error(
            f"this is no TOML: {what}", "mend it there, or start from `oed new`"
        ) from None


def _schema(table: dict[str, Any], place: Place) -> None:
    if "schema" not in table:
        raise place.key("schema").error(
            "missing", "write `schema = 1` at the top of the file"
        )
    if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
        raise place.key("schema").error(
            "unknown version", "this program reads schema = 1", table["schema"]
        )


def _one_by_one(said: StudyFile, place: Place) -> None:
    """What one table can tell without the kernel: names twice, claims that claim
    nothing, readings from two places.
    """
    if not said.setup:
        raise place.key("setup").error(
            "missing", "add a [[setup]] with name and instrument"
        )
    names = [s.name for s in said.setup]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise (
                place.key("setup")
                .item(i)
                .key("name")
                .error("used twice", "give each set-up its own name", name)
            )
    for name, claim in said.expect.items():
        if (claim.equals, claim.min, claim.max, claim.contains) == (None,) * 4:
            raise (
                place.key("expect")
                .key(name)
                .error("claims nothing", "add equals, min, max or contains")
            )
    if said.readings is not None:
        _readings(said.readings, place.key("readings"))


def _readings(said: ReadingsTable, place: Place) -> None:
    ways = [
        w
        for w, given in (
            ("files", said.files),
            ("source", said.source),
            ("simulate", said.simulate),
        )
        if given
    ]
    if len(ways) != 1:
        problem = (
            f"readings come from {' and '.join(ways)}"
            if ways
            else "it does not say where readings come from"
        )
        raise place.error(
            problem, "give one of: files = [...], source = ..., simulate = true"
        )
    if (said.draw or said.truth) and not said.simulate:
        raise place.error(
            "draw and truth are for virtual machines",
            "add simulate = true, or remove them",
        )
    if said.path is not None and said.source is None:
        raise place.key("path").error(
            "a path goes with a source", "name files in `files = [...]`", said.path
        )
