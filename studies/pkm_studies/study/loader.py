"""Loads a study file: TOML into frozen structs, checked without the kernel."""

from __future__ import annotations

import copy
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from oed.text import suggest
from pkm_studies import files
from pkm_studies.base import Location
from pkm_studies.study import decode
from pkm_studies.tables import ReadingsTable, StudyFile
from pkm_studies.user_code import Consent, Origin

SCHEMA = 1
MAX_BYTES = 2_000_000  #: bytes of the largest study file
SUFFIX = ".study.toml"


class Study(StudyFile, frozen=True, kw_only=True):
    """A study as loaded: its tables, its file, its text, and consent to its code.

    >>> import oed
    >>> study = oed.load_study("planar_step_calibration")
    >>> study.machine.model
    'planar_2dof'
    """

    path: Path
    text: str
    consent: Consent = Consent.RECORDED

    @property
    def location(self) -> Location:
        """The file, for errors."""
        return Location(str(self.path))

    @property
    def folder(self) -> Path:
        """Folder that paths in the study are relative to."""
        return self.path.parent

    @property
    def origin(self) -> Origin:
        """Where the models that it names are looked for, and whether they may run."""
        return Origin(self.folder, self.consent)

    def vary_setting(self, setting: Mapping[str, Any], location: Location) -> Study:
        """The study with other values of some fields. Raises InputError.

        A field is addressed by its table and name; an entry of a list by its own name, as in
        `setup.cup.length_mm`.
        """
        tables = copy.deepcopy(tomllib.loads(self.text))
        for field, value in setting.items():
            _assign(tables, field, value, location.key(field))
        text = msgspec.toml.encode(tables).decode()
        return Study.parse(text, self.path, self.consent)

    @classmethod
    def load(cls, path: Path | str, consent: Consent = Consent.RECORDED) -> Study:
        """Read and check a study file.

        consent  to run Python files that it names, once they are needed

        Raises InputError that names file, field, value and remedy.
        """
        path = Path(path)
        text = files.read_text(path, limit=MAX_BYTES, what="study file")
        return Study.parse(text, path, consent)

    @classmethod
    def parse(cls, text: str, path: Path, consent: Consent = Consent.RECORDED) -> Study:
        """As `load`, from text; errors name `path`, and the study's paths start there."""
        location = Location(str(path))
        table = decode.tables_of(
            text, location, "mend it there, or start from `oed new`"
        )
        version = location.key("schema")
        if "schema" not in table:
            raise version.error("missing", "write `schema = 1` at the top of the file")
        if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
            remedy = "this program reads schema = 1"
            raise version.error("unknown version", remedy, table["schema"])
        tables = decode.decode_table(StudyFile, table, location)
        _check_tables(tables, location)
        fields = {name: getattr(tables, name) for name in tables.__struct_fields__}
        return cls(**fields, path=path, text=text, consent=consent)

    @classmethod
    def from_tables(
        cls,
        tables: Mapping[str, Any],
        folder: Path,
        consent: Consent = Consent.RECORDED,
    ) -> Study:
        """A study from nested tables as in a study file. Raises InputError.

        `schema` may be left out. Paths in the study are relative to `folder`.
        """
        name = str(tables.get("name", "study"))
        path = folder / f"{name}{SUFFIX}"
        complete = {"schema": SCHEMA, **tables}
        try:
            text = msgspec.toml.encode(complete).decode()
        except TypeError as error:
            raise Location(str(path)).error(
                f"a value has no TOML form: {error}",
                "use numbers, texts, lists and tables",
            ) from error
        return Study.parse(text, path, consent)


def _check_tables(study: StudyFile, location: Location) -> None:
    """Raises InputError for names used twice, empty claims, readings from two places."""
    if not study.setup:
        raise location.key("setup").error(
            "missing", "add a [[setup]] with name and instrument"
        )
    names = [s.name for s in study.setup]
    for i, name in enumerate(names):
        if name in names[:i]:
            field = location.path("setup", i, "name")
            raise field.error("used twice", "give each set-up its own name", name)
    for name, claim in study.expect.items():
        if (claim.equals, claim.min, claim.max, claim.contains) == (None,) * 4:
            field = location.path("expect", name)
            raise field.error("claims nothing", "add equals, min, max or contains")
    if study.readings is not None:
        _check_readings(study.readings, location.key("readings"))


def _check_readings(table: ReadingsTable, location: Location) -> None:
    stated = {"files": table.files, "source": table.source, "simulate": table.simulate}
    sources = [name for name, value in stated.items() if value]
    if len(sources) != 1:
        problem = "it does not say where readings come from"
        if sources:
            problem = f"readings come from {' and '.join(sources)}"
        remedy = "give one of: files = [...], source = ..., simulate = true"
        raise location.error(problem, remedy)
    if (table.draw or table.truth) and not table.simulate:
        raise location.error(
            "draw and truth are for virtual machines",
            "add simulate = true, or remove them",
        )
    if table.path is not None and table.source is None:
        raise location.key("path").error(
            "a path goes with a source", "name files in `files = [...]`", table.path
        )


# Studies that differ from a base in some fields, as campaigns and test sweeps vary it.
def combinations(vary: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """Every value of each field with every value of the others, in their order."""
    values = itertools.product(*vary.values())
    return [dict(zip(vary, combination, strict=True)) for combination in values]


def _assign(tables: Any, field: str, value: Any, location: Location) -> None:
    """Set a field of nested tables, addressed by keys and names of list entries."""
    *way, last = field.split(".")
    entry = tables
    for key in way:
        entry = _entry(entry, key, location)
    if not isinstance(entry, dict):
        raise location.error("this is no field of a table", "name a field of the study")
    entry[last] = value


def _entry(node: Any, key: str, location: Location) -> Any:
    """What a table or a list of named tables holds under a key."""
    if isinstance(node, list):
        named = {str(entry.get("name")): entry for entry in node}
        if key not in named:
            raise location.error(f"no entry {key!r}", suggest(key, named))
        return named[key]
    if isinstance(node, dict):
        return node.setdefault(key, {})
    raise location.error(f"{key!r} lies in no table", "name a field of the study")
