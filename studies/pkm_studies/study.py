"""What a study file says: TOML into frozen structs. No kernel here: see `resolve` for what it means.

Tables that take fields by the name of a parameter, a setting or a coordinate, with the unit at the end
(`length_mm`), collect them in the field named by `rest`.
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import msgspec

from pkm_studies import decode, files
from pkm_studies.errors import Place, shorten

SCHEMA = 1
LIMIT = 2_000_000  # bytes
SUFFIX = ".study.toml"

Name = Annotated[str, msgspec.Meta(pattern="^[A-Za-z0-9][A-Za-z0-9_-]*$")]
Count = Annotated[int, msgspec.Meta(ge=1, le=1_000_000)]
Whole = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Triple = tuple[float, float, float]


class Part(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Base: frozen, unknown fields refused. `rest` names the field that collects fields of free name."""

    rest: ClassVar[str | None] = None


class Span(Part, frozen=True, kw_only=True):
    """Evenly spaced values, in the unit of the field: `{ from = 0, to = 360, count = 12, endpoint = false }`."""

    from_: float = msgspec.field(name="from")
    to: float
    count: Count
    endpoint: bool = True


class Range(Part, frozen=True, kw_only=True):
    """Lowest and highest value, in the unit of the field."""

    from_: float = msgspec.field(name="from")
    to: float


#: values of one command coordinate: a number, a list, evenly spaced, or held by the instrument
Axis = float | list[float] | Span | Literal["hold"]


class MachineTable(Part, frozen=True, kw_only=True):
    """[machine]: which model, with which numbers. `fixed` replaces the model's list of parameters held."""

    model: str
    nominal: dict[str, float] = {}
    fixed: list[str] | None = None


class SetupTable(Part, frozen=True, kw_only=True):
    """[[setup]]: an instrument as mounted. `tolerance` are the standard deviations of its unknowns.

    Each planned reading is taken `repeats` times, in one direction or both; `average` keeps their mean.
    """

    rest = "settings"
    name: Name
    instrument: str
    tool_mm: Triple = (0.0, 0.0, 0.0)
    repeats: Count = 1
    both_directions: bool = False
    average: bool = True
    teach: dict[str, float] | None = None
    tolerance: dict[str, float] = {}
    settings: dict[str, float] = {}


class Noise(Part, frozen=True, kw_only=True):
    """[noise]: standard deviation of each channel, for all set-ups or in a table named as the set-up."""

    rest = "sigma"
    estimate: bool = False
    sigma: dict[str, float | dict[str, float]] = {}


class ToleranceTable(Part, frozen=True, kw_only=True):
    """[[prior.tolerance]]: a standard deviation for the parameters whose names match; later tables win."""

    rest = "sigma"
    parameters: list[str]
    sigma: dict[str, float] = {}


class Prior(Part, frozen=True, kw_only=True):
    """[prior]."""

    tolerance: list[ToleranceTable] = []


class GridTable(Part, frozen=True, kw_only=True):
    """[[design.candidates]]: poses of one set-up, all values of each coordinate combined."""

    rest = "coordinates"
    setup: str
    runs_by: str | None = None
    pairs_mm: list[tuple[Triple, Triple]] | None = None
    coordinates: dict[str, Axis] = {}


class ReferenceTable(GridTable, frozen=True, kw_only=True):
    """[[design.reference]]: as candidates, but a given plan; tables of one name make one plan."""

    rest = "coordinates"
    name: str


class Design(Part, frozen=True, kw_only=True):
    """[design]: how many readings to choose from the candidates, by which criterion."""

    criterion: Literal["D", "A", "E", "I"] = "D"
    readings: Count = 30
    scaling: Literal["length", "tolerance"] = "length"
    starts: Count = 20
    prior: bool = False
    candidates: list[GridTable] = []
    reference: list[ReferenceTable] = []


class Plan(Part, frozen=True, kw_only=True):
    """[plan]."""

    budget_min: Annotated[float, msgspec.Meta(gt=0)] | None = None


class KappaTable(Part, frozen=True, kw_only=True):
    """[[kappa]]: condition number over m circles of n points. The range, `z_mm = { from, to }`, spaces the circles."""

    rest = "coordinates"
    title: str = ""
    setup: str
    circles: Annotated[list[Count], msgspec.Meta(min_length=1)]
    points: Annotated[list[Count], msgspec.Meta(min_length=1)]
    coordinate: str | None = None
    coordinates: dict[str, Range] = {}


class Readings(Part, frozen=True, kw_only=True):
    """[readings]: from files, from a named source of data, or from a virtual machine."""

    files: list[str] = []
    source: str | None = None
    path: str | None = None
    simulate: bool = False
    draw: bool = False
    truth: dict[str, float | dict[str, float]] = {}
    fit: list[str] | None = None
    predict: list[str] = []


class Identify(Part, frozen=True, kw_only=True):
    """[identify]: parameters freed in turn, by name or pattern."""

    stages: Annotated[list[list[str]], msgspec.Meta(min_length=1)] = msgspec.field(default_factory=lambda: [["*"]])
    max_iterations: Count = 50


class Posterior(Part, frozen=True, kw_only=True):
    """[posterior]: how long to sample. `steps` is the most; sampling stops at `ess` a parameter."""

    enabled: bool = True
    walkers: Annotated[int, msgspec.Meta(ge=4, le=100_000)] | None = None
    steps: Count = 20_000
    ess: Count = 1000
    thin: Count | None = None


class Prediction(Part, frozen=True, kw_only=True):
    """[prediction]: residual accuracy over a grid of the workspace, against a reference."""

    rest = "coordinates"
    reference: Literal["home", "absolute", "best_fit"] = "home"
    virtual_machines: Whole = 0
    coordinates: dict[str, Axis] = {}


class Gap(Part, frozen=True, kw_only=True):
    """[gap]."""

    effects: list[str] = []


class Report(Part, frozen=True, kw_only=True):
    """[report]."""

    html: bool = True
    pdf: bool = True
    corner: Count = 6


class ClaimTable(Part, frozen=True, kw_only=True):
    """[expect]: what a result must be. `of` is a dotted path into result.json."""

    of: str
    equals: bool | float | str | None = None
    min: float | None = None
    max: float | None = None
    contains: str | None = None


class StudyFile(Part, frozen=True, kw_only=True):
    """A study file, schema 1."""

    schema: Literal[1]
    name: Name
    title: str = ""
    question: str = ""
    seed: Whole = 0
    slow: bool = False
    machine: MachineTable
    setup: Annotated[list[SetupTable], msgspec.Meta(min_length=1)]
    noise: Noise = Noise()
    prior: Prior = Prior()
    design: Design | None = None
    plan: Plan | None = None
    kappa: list[KappaTable] = []
    readings: Readings | None = None
    identify: Identify = Identify()
    posterior: Posterior = Posterior()
    prediction: Prediction | None = None
    gap: Gap | None = None
    report: Report = Report()
    expect: dict[Name, ClaimTable] = {}


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
    """Read and check a study file. Raises InputError that names file, field, value and remedy."""
    path = Path(path)
    text = files.read_text(path, limit=LIMIT, what="study file")
    return parse(text, path)


def parse(text: str, path: Path) -> Study:
    """As `load`, from text; `path` is what errors name and what paths in the study are relative to."""
    place = Place(str(path))
    try:
        table = _toml(text, place)
        decode.finite(table, place)
    except RecursionError:
        raise place.error("tables or lists are nested too deeply", "see `oed schema study`") from None
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
        raise place.error(f"this is no TOML: {what}", "mend it there, or start from `oed new`") from None


def _schema(table: dict[str, Any], place: Place) -> None:
    if "schema" not in table:
        raise place.key("schema").error("missing", "write `schema = 1` at the top of the file")
    if table["schema"] != SCHEMA or isinstance(table["schema"], bool):
        raise place.key("schema").error("unknown version", "this program reads schema = 1", table["schema"])


def _one_by_one(said: StudyFile, place: Place) -> None:
    """What one table can tell without the kernel: names twice, claims that claim nothing, readings from two places."""
    if not said.setup:
        raise place.key("setup").error("missing", "add a [[setup]] with name and instrument")
    names = [s.name for s in said.setup]
    for i, name in enumerate(names):
        if name in names[:i]:
            raise place.key("setup").item(i).key("name").error("used twice", "give each set-up its own name", name)
    for name, claim in said.expect.items():
        if (claim.equals, claim.min, claim.max, claim.contains) == (None,) * 4:
            raise place.key("expect").key(name).error("claims nothing", "add equals, min, max or contains")
    if said.readings is not None:
        _readings(said.readings, place.key("readings"))


def _readings(said: Readings, place: Place) -> None:
    ways = [w for w, given in (("files", said.files), ("source", said.source), ("simulate", said.simulate)) if given]
    if len(ways) != 1:
        problem = f"readings come from {' and '.join(ways)}" if ways else "it does not say where readings come from"
        raise place.error(problem, "give one of: files = [...], source = ..., simulate = true")
    if (said.draw or said.truth) and not said.simulate:
        raise place.error("draw and truth are for virtual machines", "add simulate = true, or remove them")
    if said.path is not None and said.source is None:
        raise place.key("path").error("a path goes with a source", "name files in `files = [...]`", said.path)
