"""Sweeps over varied studies in a user's own tests: the fixture `varied_study`.

    @pytest.mark.study_sweep("a3_ball_bar", vary={"noise.length_um": [0.5, 1.0]})
    def test_the_plan_is_good_enough(varied_study):
        varied_study.check("prediction.components.z.after.rms", max=120.0)

Each combination of values is a test. Tests of one combination share its result, within
a process and between the processes of pytest-xdist.
"""

import functools
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, NoReturn

import msgspec
import pytest

from oed.result import StudyResult
from pkm_studies import shipped, stages
from pkm_studies.base import InputError, Location, SourceAbsentError
from pkm_studies.results import check_claim, load_result, value_at
from pkm_studies.study import Study, combinations
from pkm_studies.tables import ClaimTable

MARK = "study_sweep"
#: environment variable that the processes of pytest-xdist have
WORKER = "PYTEST_XDIST_WORKER"
MAX_VALUE_CHARACTERS = 30  #: characters of a value in the name of a test


class Combination(NamedTuple):
    """A study of a sweep, and the values by field in which it differs from its base."""

    study: Study
    setting: Mapping[str, Any]


class VariedStudy:
    """A study of a sweep with its result, as a test gets it.

    study    the study with its values
    setting  the values by field
    """

    def __init__(self, combination: Combination, folder: Path) -> None:
        self.study, self.setting = combination
        self._folder = folder

    @functools.cached_property
    def result(self) -> StudyResult:
        """All that `oed run` computes, at the first use; without its data the test is skipped."""
        content = f"{self.study.path.resolve()}\n{self.study.text}".encode()
        folder = self._folder / hashlib.sha256(content).hexdigest()[:24]
        try:
            if not folder.is_dir():
                _run(self.study, folder)
        except SourceAbsentError as absent:
            pytest.skip(str(absent))
        except InputError as error:
            _fail(str(error))
        return load_result(folder)

    def figure(self, path: str) -> Any:
        """What stands in result.json at a dotted path, as in [expect]."""
        try:
            return value_at(self._plain, path)
        except LookupError as error:
            _fail(str(error))

    def check(
        self,
        of: str,
        *,
        min: float | None = None,
        max: float | None = None,
        equals: bool | float | str | None = None,
        contains: str | None = None,
    ) -> None:
        """Fail the test unless the figure at a path is as claimed, as in [expect]."""
        table = ClaimTable(of=of, min=min, max=max, equals=equals, contains=contains)
        claim = check_claim(of.rpartition(".")[2], table, self._plain)
        if not claim.met:
            _fail(claim.failure(self._where))

    def check_claims(self, *names: str) -> None:
        """Fail the test unless the study's own claims hold: all, or those named."""
        by_name = {claim.claim: claim for claim in self.result.claims}
        unknown = [name for name in names if name not in by_name]
        if unknown:
            claims = ", ".join(by_name) or "no claims"
            _fail(f"{self._where}: no claim {unknown[0]}; it has {claims}")
        chosen = [by_name[name] for name in names or by_name]
        failures = [c.failure(self._where) for c in chosen if not c.met]
        if failures:
            _fail("\n".join(failures))

    @property
    def _where(self) -> str:
        """The study's file, and its values."""
        phrase = ", ".join(f"{k} = {_short(v)}" for k, v in self.setting.items())
        name = self.study.path.name
        return f"{name} with {phrase}" if phrase else name

    @functools.cached_property
    def _plain(self) -> Mapping[str, Any]:
        plain: Mapping[str, Any] = msgspec.to_builtins(self.result)
        return plain


# -- tests of a sweep ------------------------------------------------------------------
def parametrize(metafunc: pytest.Metafunc, fixture: str) -> None:
    """A test of each combination of a test's marks. Raises UsageError."""
    marks = list(metafunc.definition.iter_markers(MARK))
    if not marks:
        raise pytest.UsageError(
            f"{metafunc.definition.nodeid}: {fixture} needs the mark {MARK}, such as"
            f' @pytest.mark.{MARK}("a3_ball_bar", vary={{"design.readings": [24, 30]}})'
        )
    folder = metafunc.definition.path.parent
    parameters: list[Any] = []
    for mark in marks:
        bases, values = _arguments(*mark.args, **mark.kwargs)
        for base in bases:
            parameters += _parameters(base, values, folder, several=len(bases) > 1)
    metafunc.parametrize(fixture, parameters, indirect=True)


def _arguments(
    base: str | Path | Sequence[str | Path],
    vary: Mapping[str, Sequence[Any]] | None = None,
) -> tuple[Sequence[str | Path], Mapping[str, Sequence[Any]]]:
    """Arguments of the mark: studies, and values by field."""
    bases = [base] if isinstance(base, str | Path) else list(base)
    return bases, vary or {}


def _parameters(
    base: str | Path,
    values: Mapping[str, Sequence[Any]],
    folder: Path,
    *,
    several: bool,
) -> Iterable[Any]:
    """The combinations of one base. Raises UsageError."""
    try:
        file = folder / base
        study = Study.load(file if file.is_file() else shipped.study_path(Path(base)))
        for setting in combinations(values):
            varied = study.vary_setting(setting, Location(f"@{MARK}", "vary"))
            names = [f"{k}={_short(v)}" for k, v in setting.items()]
            if several or not names:
                names = [study.name, *names]
            marks = [pytest.mark.slow] if study.slow else []
            combination = Combination(varied, setting)
            yield pytest.param(combination, id="-".join(names), marks=marks)
    except InputError as error:
        raise pytest.UsageError(str(error)) from None


def _short(value: Any) -> str:
    """A value in the name of a test; of a table its model, instrument or name."""
    if isinstance(value, Mapping):
        for key in ("model", "instrument", "name"):
            if key in value:
                return str(value[key])
    if isinstance(value, list) and value and isinstance(value[0], Mapping):
        return "+".join(_short(entry) for entry in value)
    return str(value)[:MAX_VALUE_CHARACTERS]


def shared_folder(factory: pytest.TempPathFactory) -> Path:
    """Folder of the session's results, which all processes of pytest-xdist see."""
    base = factory.getbasetemp()
    if WORKER in os.environ:
        base = base.parent
    folder = base / "studies"
    folder.mkdir(exist_ok=True)
    return folder


def _run(study: Study, folder: Path) -> None:
    """Run a study into a folder that appears whole, unless another process was faster."""
    working = Path(tempfile.mkdtemp(dir=folder.parent, prefix="running-"))
    report = any(table.of.startswith("report") for table in study.expect.values())
    try:
        stages.run_study(study, working, report=report)
        working.rename(folder)
    except OSError:
        if not folder.is_dir():
            raise
    finally:
        shutil.rmtree(working, ignore_errors=True)


def _fail(message: str) -> NoReturn:
    pytest.fail(message, pytrace=False)
