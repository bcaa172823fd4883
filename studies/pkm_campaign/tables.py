"""Campaign files: TOML into frozen structs, and the studies or functions that they run."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar

import msgspec

from oed.mechanism import AssemblyError
from oed.text import shorten
from pkm_campaign.case import (
    COLUMNS,
    CaseFunction,
    Figures,
    UserFunction,
    VirtualMachine,
)
from pkm_studies import files, shipped
from pkm_studies.base import InputError, Location, Name
from pkm_studies.resolve import resolve
from pkm_studies.study import Study, combinations, decode_table, tables_of
from pkm_studies.user_code import Consent, Origin

SCHEMA = 1
SUFFIX = ".campaign.toml"
#: bytes of the largest campaign file
MAX_BYTES = 200_000
#: cases of the largest campaign
MAX_CASES = 1_000_000


class CampaignFile(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True
):
    """A campaign: every combination of the varied fields, and every seed.

    schema      version of the format, 1
    name        of the campaign and its folder
    title       for the report
    study       a study file, relative to this one, or the name of a shipped study; its
                virtual machines are the cases
    case        in place of a study: a function (setting, seed) -> figures of a case, as
                "path/to/file.py:function", relative to this file
    summary     a function (cases of a combination, setting) -> its figures; means of a
                case function's figures by default
    seeds       cases of each combination
    first_seed  the first case's seed; the others follow
    diagnose    whether each machine's readings are diagnosed as well
    vary        values by the field of the study, as in "noise.length_um" = [0.3, 1.0];
                an entry of a list is addressed by its name, as in "setup.cup.tool_mm";
                for a case function, by any name
    """

    free_keys: ClassVar[None] = None
    schema: int
    name: Name
    study: str = ""
    case: str = ""
    summary: str = ""
    seeds: Annotated[int, msgspec.Meta(ge=1, le=MAX_CASES)]
    title: str = ""
    first_seed: Annotated[int, msgspec.Meta(ge=0)] = 1
    diagnose: bool = False
    vary: dict[str, list[Any]] = {}


class Campaign(CampaignFile, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A campaign as loaded, with the study that it varies, if its cases are machines."""

    path: Path
    text: str
    varied: Study | None
    consent: Consent = Consent.RECORDED

    @property
    def location(self) -> Location:
        """The file, for errors."""
        return Location(str(self.path))

    def settings(self) -> list[dict[str, Any]]:
        """Every combination of the varied values, in the order of the file."""
        return combinations(self.vary)

    def all_seeds(self) -> range:
        """The seeds of each combination."""
        return range(self.first_seed, self.first_seed + self.seeds)

    def words(self, setting: Mapping[str, Any]) -> str:
        """A combination in words, by last parts of addresses; without fields of one value."""
        varied = [field for field, values in self.vary.items() if len(values) > 1]
        short = [field.rpartition(".")[2] for field in varied]
        names = short if len(set(short)) == len(short) else varied
        pairs = zip(names, varied, strict=True)
        parts = [f"{name} = {setting[field]}" for name, field in pairs]
        return ", ".join(parts) or "as it is"

    def first(self, seeds: int) -> Campaign:
        """The campaign with the first so many cases of each. Raises InputError for more."""
        if seeds > self.seeds:
            raise self.location.key("seeds").error(
                f"{self.seeds} cases of each combination, and --seeds {seeds}",
                f"raise `seeds` to {seeds}, or leave the option away for all",
            )
        return msgspec.structs.replace(self, seeds=seeds)

    def figures(self, setting: Mapping[str, Any]) -> Figures:
        """What computes the figures of a combination's cases."""
        if self.varied is None:
            return CaseFunction(self.user_function(self.case))
        study = self.study_with(setting)
        path = str(self.varied.path)
        return VirtualMachine(study.text, path, self.diagnose, self.consent)

    def user_function(self, reference: str) -> UserFunction:
        """A function that the file names."""
        origin = Origin(self.path.parent.resolve(), self.consent)
        return UserFunction(reference, origin, str(self.path))

    def study_with(self, setting: Mapping[str, Any]) -> Study:
        """The study with other values of fields. Raises InputError, LookupError."""
        if self.varied is None:
            raise LookupError("a campaign of a function varies no study")
        return self.varied.vary_setting(setting, self.location.key("vary"))


def load_campaign(path: Path, consent: Consent = Consent.RECORDED) -> Campaign:
    """Read and check a campaign file, its study and every combination of its fields.

    consent  to run Python files that it names, or its study

    A name without a suffix may be that of a shipped campaign.

    Raises InputError that names file, field, value and remedy.
    """
    file = shipped.folder() / f"{path.name}{SUFFIX}"
    is_name = path.name == str(path) and not path.suffix
    path = file if is_name and not path.exists() and file.is_file() else path
    location = Location(str(path))
    text = files.read_text(path, limit=MAX_BYTES, what="campaign file")
    table = tables_of(text, location)
    tables = decode_table(CampaignFile, table, location)
    if tables.schema != SCHEMA:
        remedy = "this program reads schema = 1"
        raise location.key("schema").error("unknown version", remedy, tables.schema)
    study = None
    if _is_of_study(tables, location):
        study = _study(tables, path, location, consent)
    fields = {name: getattr(tables, name) for name in tables.__struct_fields__}
    campaign = Campaign(**fields, path=path, text=text, varied=study, consent=consent)
    _check_settings(campaign)
    return campaign


def _is_of_study(tables: CampaignFile, location: Location) -> bool:
    """Whether the cases are machines of a study. Raises InputError where both, or none."""
    if bool(tables.study) == bool(tables.case):
        problem = "give study, or case for a function of your own; one of them"
        raise location.key("study").error(
            "no study and no case" if not tables.study else "study and case", problem
        )
    if tables.study and tables.summary:
        remedy = "leave it out, or give a function as case"
        raise location.key("summary").error("a study has its own summary", remedy)
    if tables.case and tables.diagnose:
        remedy = "leave it out: the case function does what it likes"
        raise location.key("diagnose").error(
            "only machines of a study are diagnosed", remedy
        )
    return bool(tables.study)


def _study(
    tables: CampaignFile, path: Path, location: Location, consent: Consent
) -> Study:
    """The varied study, beside the campaign or shipped. Raises InputError."""
    neighbour = path.parent / tables.study
    is_neighbour = neighbour.is_file()
    file = neighbour if is_neighbour else shipped.study_path(Path(tables.study))
    study = Study.load(file, consent)
    if study.prediction is None:
        raise location.key("study").error(
            "the study does not say where accuracy counts",
            "add [prediction] with a workspace to it",
            tables.study,
        )
    return study


def _check_settings(campaign: Campaign) -> None:
    """Raises InputError for no values, too many cases, and fields that do not fit."""
    location = campaign.location
    for field, values in campaign.vary.items():
        if not values:
            field_location = location.path("vary", field)
            raise field_location.error("no values", "list the values to try")
    settings = campaign.settings()
    if len(settings) * campaign.seeds > MAX_CASES:
        problem = f"{len(settings)} combinations with {campaign.seeds} machines each"
        raise location.key("seeds").error(problem, f"stay below {MAX_CASES} cases")
    if campaign.varied is None:
        _check_functions(campaign)
        return
    for setting in settings:
        try:
            resolve(campaign.study_with(setting), readings=())
        except (InputError, AssemblyError) as error:
            phrase = ", ".join(
                f"{k} = {shorten(repr(v), 40)}" for k, v in setting.items()
            )
            problem = f"with {phrase}: {error}"
            raise location.key("vary").error(problem, "change this value") from error


def _check_functions(campaign: Campaign) -> None:
    """Raises InputError for functions that are not there, and names of other columns."""
    for name in campaign.vary:
        if name in COLUMNS:
            field_location = campaign.location.path("vary", name)
            raise field_location.error(
                "this names another column", "choose another name"
            )
    campaign.user_function(campaign.case).load("case")
    if campaign.summary:
        campaign.user_function(campaign.summary).load("summary")
