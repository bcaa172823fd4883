"""pytest plugin: a study file is a test file, and each of its claims a test.

    pytest studies/a3_ball_bar.study.toml::rank

Tests of a user's own sweep over varied studies with the mark `study_sweep` and the
fixture `varied_study`: see `pkm_studies.collector.sweep`.

A study runs once a session, into a folder of its own that is removed afterwards.
Studies with `slow = true` carry the mark `slow`. Where the data that a study reads is
absent, its claims are skipped with the place where it was looked for.
"""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from oed.result import Claim
    from pkm_studies.collector.sweep import VariedStudy
    from pkm_studies.study import Study

SUFFIX = ".study.toml"
FIXTURE = "varied_study"  #: fixture of the studies of a sweep


class ClaimNotMet(Exception):  # noqa: N818 - pytest shows the claim, not the class
    """A claim of a study that its result does not meet."""

    def __init__(self, claim: Claim, where: str) -> None:
        """State what was measured and what is claimed."""

        super().__init__(claim.failure(where))


def pytest_configure(config: pytest.Config) -> None:
    """Declare the marks of slow studies and of sweeps."""
    config.addinivalue_line("markers", "slow: a study that says it takes minutes")
    config.addinivalue_line(
        "markers",
        "study_sweep(base, vary): run the test for every combination of a study's fields,"
        " with the fixture varied_study",
    )


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    """One test for each study of a sweep."""
    if FIXTURE in metafunc.fixturenames:
        from pkm_studies.collector import sweep

        sweep.parametrize(metafunc, FIXTURE)


@pytest.fixture
def varied_study(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory
) -> VariedStudy:
    """A study of the sweep, which runs at most once a session: at its first figure."""
    from pkm_studies.collector import sweep

    folder = sweep.shared_folder(tmp_path_factory)
    return sweep.VariedStudy(request.param, folder)


def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> pytest.Collector | None:
    """Collect study files, by their suffix."""
    if not file_path.name.endswith(SUFFIX):
        return None
    return StudyCollector.from_parent(parent, path=file_path)


class StudyCollector(pytest.File):
    """A study: it runs at most once, at its first claim."""

    _outcome: dict[str, Claim] | Exception | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """One item a claim. A study that cannot be read is an error of collection."""
        from pkm_studies.base import InputError
        from pkm_studies.study import Study

        try:
            study = Study.load(self.path)
        except InputError as error:
            raise self.CollectError(str(error)) from None
        for name in study.expect:
            item = ClaimItem.from_parent(self, name=name, study=study)
            if study.slow:
                item.add_marker("slow")
            yield item

    def claims(self, study: Study) -> dict[str, Claim]:
        """The study's claims as measured. Raises what the run raised."""
        if self._outcome is None:
            try:
                self._outcome = _run(study)
            except Exception as error:
                self._outcome = error
        if isinstance(self._outcome, Exception):
            raise self._outcome
        return self._outcome


class ClaimItem(pytest.Item):
    """One claim."""

    def __init__(self, *, study: Study, **arguments: Any) -> None:
        """Take the study besides pytest's own arguments."""
        super().__init__(**arguments)
        self.study = study

    def runtest(self) -> None:
        """Measure the claim."""
        from pkm_studies.base import SourceAbsentError

        assert isinstance(self.parent, StudyCollector)
        try:
            claim = self.parent.claims(self.study)[self.name]
        except SourceAbsentError as absent:
            pytest.skip(str(absent))
        if not claim.met:
            line = _line(self.study.text, self.name) + 1
            raise ClaimNotMet(claim, f"{self.path.name}:{line} [expect]")

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None
    ) -> Any:
        """The claim, or the paragraph of a bad input; else a traceback."""
        from pkm_studies.base import InputError

        if isinstance(excinfo.value, ClaimNotMet | InputError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """File, line and title of the claim."""
        line = _line(self.study.text, self.name)
        return self.path, line, f"{self.study.name}: {self.name}"


def _run(study: Study) -> dict[str, Claim]:
    """The study's claims; reports are written only where a claim is about them."""
    from pkm_studies import stages

    report = any(table.of.startswith("report") for table in study.expect.values())
    with tempfile.TemporaryDirectory(prefix="oed-", ignore_cleanup_errors=True) as name:
        result = stages.run_study(study, Path(name), report=report)
    return {claim.claim: claim for claim in result.claims}


def _line(text: str, claim: str) -> int:
    """Line, from 0, of a claim of [expect]."""
    table = re.search(r"^\[expect[.\]]", text, re.MULTILINE)
    if table is None:
        return 0
    name = re.escape(claim)
    pattern = rf"^(\[expect\.{name}\]|{name}\s*[.=])"
    match = re.search(pattern, text[table.start() :], re.MULTILINE)
    offset = match.start() if match else 0
    return text[: table.start() + offset].count("\n")
