"""What the tests share."""

import functools
import gc
import importlib
import os
import shutil
from collections.abc import Callable, Generator, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
#: real measurements and inputs of users, beside the project
SHARED = ROOT.parent / "shared"
#: tests of the search for mistakes, and the running test if its readings are not searched
CHECKS = ROOT / "tests" / "oed" / "checks"
UNSEARCHED: list[str] = []
#: tests that write tables for controllers and do not ask how finely these are judged
WRITE_TABLES = (
    *(ROOT / "tests/studies/compensation").glob("test_*.py"),
    ROOT / "tests/journeys/test_rounds.py",
    ROOT / "tests/studies/resolve/test_controller.py",
    ROOT / "tests/studies/stages/test_corrected_command.py",
)
#: words with which a remedy begins, and no problem
IMPERATIVES = {
    *("add", "choose", "correct", "give", "identify", "install", "keep", "leave"),
    *("load", "make", "measure", "mend", "remove", "save", "take", "widen", "write"),
}
#: what stands for the figures of reports, by the folder of tests
SKETCHES: dict[Path, Any] = {}

# Looking for garbage after every 700 new objects takes a third of the time of collecting
# tests, and 7 % of that of running them.
gc.set_threshold(100_000, 20, 50)

#: shipped studies that run by night, and what runs the same by day
NIGHTLY_STUDIES = {
    "a3_adjust": "tests/studies/sessions/test_sessions_command.py",
    "a3_forecast": "studies/planar_forecast.study.toml",
    "a3_home_orientation": "tests/models/machines/test_a3_bars.py",
    "a3_test_circles": "tests/studies/stages/test_run_curves.py",
    "delta_v400": "tests/models/machines/test_delta_real.py",
    "delta_v400_reverse": "tests/models/machines/test_delta_real.py",
    "micro_cmm_self": "studies/micro_cmm.study.toml",
    "planar_plan": "tests/studies/stages/test_study_plan.py",
    "prs_adjust": "tests/studies/sessions/test_sessions_command.py",
    "prs_laser_ball_bar": "studies/prs_paper_model.study.toml",
}


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the shipped studies that run by night."""
    for item in items:
        if item.path.name.removesuffix(".study.toml") in NIGHTLY_STUDIES:
            item.add_marker(pytest.mark.slow)


def pytest_collection_finish() -> None:
    """Nothing that is loaded now becomes garbage."""
    gc.freeze()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_terminal_summary(
    terminalreporter: pytest.TerminalReporter,
) -> Generator[None]:
    """Tests that need real data say so in one line at the end, where it is absent."""
    yield
    skipped = terminalreporter.stats.get("skipped", [])
    number = sum(SHARED.name in str(report.longrepr) for report in skipped)
    if number and not SHARED.is_dir():
        terminalreporter.write_line(f"{number} tests skipped: ../shared is absent")


@pytest.fixture(scope="session", autouse=True)
def trusted(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Studies that tests write may name Python files; the user's own settings stay."""
    base = tmp_path_factory.getbasetemp().resolve()
    folders = [base, ROOT / "docs"]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("OED_TRUSTED_FOLDERS", os.pathsep.join(map(str, folders)))
        patch.setenv("XDG_CONFIG_HOME", str(base / "config"))
        patch.setenv("XDG_STATE_HOME", str(base / "state"))
        yield


@pytest.fixture(scope="module", autouse=True)
def sketched_pictures(request: pytest.FixtureRequest) -> Iterator[None]:
    """Figures of reports are not written, and each is drawn once a folder: see `sketches`.

    Files with the mark `pictures` have them written, and so have studies that run as
    tests.
    """
    if request.node.get_closest_marker("pictures"):
        yield
        return
    document = importlib.import_module("pkm_reports.page.document")
    sketches = importlib.import_module("sketches")
    with pytest.MonkeyPatch.context() as patch:
        drawn = SKETCHES.setdefault(request.path.parent, sketches.Sketches())
        patch.setattr(document, "drawn_image", drawn)
        yield


@pytest.fixture(scope="module", autouse=True)
def coarse_tables(request: pytest.FixtureRequest) -> Iterator[None]:
    """Tables for controllers are judged at fewer places than a user's.

    How they are judged is tested in tests/oed/compensate.
    """
    with pytest.MonkeyPatch.context() as patch:
        if request.path in WRITE_TABLES:
            patch.setattr("oed.compensate.command_grid.N_POSITIONS", 128)
            patch.setattr("oed.compensate.export_errors.N_POSITIONS", 250)
        yield


@pytest.fixture(scope="session", autouse=True)
def searched_mistakes() -> Iterator[None]:
    """Readings that do not fit are searched for mistakes by tests of that search alone.

    They lie in tests/oed/checks, or have the mark `mistakes`: a search fits the readings
    some thirty times.
    """
    check = importlib.import_module("oed.checks.check")
    search = check.explain

    def explain(*given: object, **options: object) -> list[object]:
        return [] if UNSEARCHED else search(*given, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(check, "explain", explain)
        yield


@pytest.fixture(scope="session", autouse=True)
def problems_before_remedies() -> Iterator[None]:
    """An error that is raised in any test states what is wrong, then what to do."""
    errors = {"pkm_studies.base": "InputError", "oed.dataset": "ReadingsError"}
    with pytest.MonkeyPatch.context() as patch:
        for module, name in errors.items():
            error = getattr(importlib.import_module(module), name)
            patch.setattr(error, "__init__", problem_first(error.__init__))
        yield


def problem_first(initialise: Callable[..., None]) -> Callable[..., None]:
    @functools.wraps(initialise)
    def checked(self: Exception, problem: str, remedy: str, **options: Any) -> None:
        assert problem.partition(" ")[0] not in IMPERATIVES, problem
        initialise(self, problem, remedy, **options)

    return checked


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, bool, bool]:
    """State whether a test's readings are searched for mistakes."""
    mark = item.get_closest_marker("mistakes")
    searched = (
        mark.kwargs.get("searched", True) if mark else CHECKS in item.path.parents
    )
    if not searched:
        UNSEARCHED.append(item.nodeid)
    try:
        return (yield)
    finally:
        UNSEARCHED.clear()


@pytest.fixture
def rng() -> np.random.Generator:
    """The same random numbers for every test."""
    return np.random.default_rng(20160801)


@pytest.fixture
def oed(capsys: pytest.CaptureFixture[str]) -> Callable[..., tuple[int, str, str]]:
    """The command: exit code, stdout, stderr."""
    cli = importlib.import_module("pkm_studies.commands.cli")

    def call(*arguments: object) -> tuple[int, str, str]:
        code = cli.main([str(a) for a in arguments])
        out, err = capsys.readouterr()
        return code, out, err

    return call


@pytest.fixture
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The test runs in a folder of its own."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def stranger(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A user who allowed nothing yet, and trusts no folder."""
    monkeypatch.delenv("OED_TRUSTED_FOLDERS")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """A Chromium of the system, without a window."""
    playwright = pytest.importorskip("playwright.sync_api")
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip("no Chromium on this machine: install the package chromium")
    switches = ["--no-sandbox", "--disable-gpu", "--disable-background-networking"]
    with playwright.sync_playwright() as driver:
        started = driver.chromium.launch(executable_path=path, args=switches)
        yield started
        started.close()


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Real measurements, kept beside the project and not in it."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip(
            "the folder shared/data with real measurements is not beside the project"
        )
    return folder
