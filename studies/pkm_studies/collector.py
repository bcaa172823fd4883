"""pytest plugin: a study file is a test file, and each of its claims a test.

    pytest studies/a3_ball_bar.study.toml::rank

A study runs once a session, into a folder of its own that is removed afterwards.
Studies that say `slow = true` carry the mark `slow`; where the data that a study reads
is absent, its claims are skipped, saying where it was looked for.
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
    from pkm_studies.study import Study

SUFFIX = ".study.toml"


class ClaimNotMet(Exception):  # noqa: N818 - what pytest shows is the claim, not the class
    """A claim of a study that its result does not meet."""

    def __init__(self, claim: Claim) -> None:
        measured = (
            f"{claim.measured:.9g}"
            if isinstance(claim.measured, float)
            else claim.measured
        )
        super().__init__(
            f"claim {claim.claim}\n  wanted   {claim.wanted}\n  measured {measured}"
        )


def pytest_configure(config: pytest.Config) -> None:
    """The mark that slow studies carry."""
    config.addinivalue_line("markers", "slow: a study that says it takes minutes")


def pytest_collect_file(
    file_path: Path, parent: pytest.Collector
) -> pytest.Collector | None:
    """Study files, by their suffix."""
    return (
        StudyCollector.from_parent(parent, path=file_path)
        if file_path.name.endswith(SUFFIX)
        else None
    )


class StudyCollector(pytest.File):
    """A study: runs at most once, at its first claim."""

    _outcome: dict[str, Claim] | Exception | None = None

    def collect(self) -> Iterator[pytest.Item]:
        """One item a claim. A study that cannot be read is an error of collection."""
        from pkm_studies.errors import InputError
        from pkm_studies.study import load

        try:
            study = load(self.path)
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
        super().__init__(**arguments)
        self.study = study

    def runtest(self) -> None:
        """Measure the claim."""
        from pkm_studies.errors import SourceAbsentError

        assert isinstance(self.parent, StudyCollector)
        try:
            claim = self.parent.claims(self.study)[self.name]
        except SourceAbsentError as absent:
            pytest.skip(str(absent))
        if not claim.met:
            raise ClaimNotMet(claim)

    def repr_failure(
        self, excinfo: pytest.ExceptionInfo[BaseException], style: Any = None
    ) -> Any:
        """The claim, or the one paragraph of a bad input; a traceback only for what
        nobody foresaw.
        """
        from pkm_studies.errors import InputError

        if isinstance(excinfo.value, ClaimNotMet | InputError):
            return str(excinfo.value)
        return super().repr_failure(excinfo, style)

    def reportinfo(self) -> tuple[Path, int, str]:
        """Where the claim stands in the file."""
        return (
            self.path,
            _line(self.study.text, self.name),
            f"{self.study.name}: {self.name}",
        )


def _run(study: Study) -> dict[str, Claim]:
    from pkm_studies import pipeline

    folder = Path(tempfile.mkdtemp(prefix="oed-"))
    try:
        wanted = any(table.of.startswith("report") for table in study.expect.values())
        return {
            claim.claim: claim
            for claim in pipeline.run(study, folder, report=wanted).claims
        }
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _line(text: str, claim: str) -> int:
    """Line, from 0, at which a claim of [expect] stands."""
    start = re.search(r"^\[expect[.\]]", text, re.MULTILINE)
    if start is None:
        return 0
    name = re.escape(claim)
    found = re.search(
        rf"^(\[expect\.{name}\]|{name}\s*[.=])", text[start.start() :], re.MULTILINE
    )
    return text[: start.start() + (found.start() if found else 0)].count("\n")
