"""The wheel's content, the direction of imports, and texts that no file may contain."""

import ast
import itertools
import re
import shutil
import subprocess
import sys
import tomllib
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = {name: ROOT / folder / name for name, folder in {
    "oed": ".",
    "pkm_models": "models",
    "pkm_studies": "studies",
    "pkm_campaign": "studies",
    "pkm_page": "studies",
    "pkm_printers": "studies",
    "pkm_certificate": "studies",
    "pkm_reports": "reports",
}.items()}  # fmt: skip

# A character class in each word keeps these patterns from matching themselves.
MACHINE_PATH = re.compile(
    r"(?<![\w.$}~-])(/(r[o]ot|h[o]me|w[o]rk|t[m]p|m[n]t|o[p]t|U[s]ers)/\w|[A-Z]:\\U[s]ers)"
)
REGISTRY = re.compile(
    r"py[p]i|pythonh[o]sted|conda-f[o]rge|anac[o]nda|npm[j]s|crates\.i[o]",
    re.IGNORECASE,
)


def run(*command: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False
    )


@pytest.fixture(scope="module")
def project() -> dict:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def committed() -> list[Path]:
    """Files that git holds or would add, uv.lock aside."""
    if not shutil.which("git") or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listed = run(
        "git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"
    ).stdout.split("\0")
    paths = [ROOT / name for name in listed if name and name != "uv.lock"]
    return [path for path in paths if path.is_file()]


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Names in the wheel, without its metadata."""
    folder = tmp_path_factory.mktemp("wheel")
    built = run(
        sys.executable, "-m", "hatchling", "build", "-t", "wheel", "-d", str(folder)
    )
    assert built.returncode == 0, built.stderr
    (path,) = folder.glob("*.whl")
    return [
        name for name in zipfile.ZipFile(path).namelist() if ".dist-info/" not in name
    ]


def test_wheel_holds_exactly_the_packages_and_the_studies(wheel):
    expected = {
        f"{name}/{path.relative_to(folder).as_posix()}"
        for name, folder in PACKAGES.items()
        for path in folder.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    folder = ROOT / "studies"
    kinds = ("*.study.toml", "*.campaign.toml", "*.csv")
    studies = [path for kind in kinds for path in folder.glob(kind)]
    expected |= {f"pkm_studies/shipped/{path.name}" for path in studies}
    assert set(wheel) == expected
    assert len(wheel) == len(expected)


@pytest.mark.parametrize("name", PACKAGES)
def test_wheel_package_is_typed(wheel, name):
    assert {f"{name}/__init__.py", f"{name}/py.typed"} <= set(wheel)


def test_imports_run_one_way():
    linter = shutil.which("lint-imports", path=str(Path(sys.executable).parent))
    assert linter is not None
    report = run(linter, "--no-cache")
    assert report.returncode == 0, report.stdout + report.stderr


@pytest.mark.parametrize(
    "pattern", [MACHINE_PATH, REGISTRY], ids=["machine path", "registry"]
)
def test_no_file_names(committed, pattern):
    hits = []
    for path in committed:
        raw = path.read_bytes()
        text = "" if b"\0" in raw else raw.decode("utf-8", errors="ignore")
        name = path.relative_to(ROOT)
        hits += [f"{name}: {hit.group()}" for hit in pattern.finditer(text)]
    assert not hits


@pytest.mark.parametrize(
    "text", ["see /h\x6fme/me/x", "'/t\x6dp/out'", "C:\\U\x73ers\\me"]
)
def test_machine_paths_are_recognised(text):
    assert MACHINE_PATH.search(text)


@pytest.mark.parametrize("name", ["oed", "pkm_models", "pkm_studies", "pkm_reports"])
def test_tests_lie_by_the_rooms_of_a_package(name):
    folder = ROOT / "tests" / name.removeprefix("pkm_")
    rooms = {path.stem for path in PACKAGES[name].iterdir()}
    tested = {path.parent.relative_to(folder) for path in folder.rglob("test_*.py")}
    assert tested
    assert {str(path.parts[0]) for path in tested if path.parts} <= rooms


def test_no_test_lies_beside_the_folders():
    assert not list((ROOT / "tests").glob("test_*.py"))


def test_every_module_has_a_docstring(committed):
    modules = [path for path in committed if path.suffix == ".py"]
    bare = [
        str(path.relative_to(ROOT))
        for path in modules
        if not ast.get_docstring(ast.parse(path.read_text(encoding="utf-8")))
    ]
    assert modules
    assert not bare


def test_one_version_everywhere(project):
    version = project["project"]["version"]
    assert metadata.version("pkm-oed") == version
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text(
        encoding="utf-8"
    )


def test_the_lock_is_of_these_dependencies(project):
    lock = tomllib.loads((ROOT / "uv.lock").read_text(encoding="utf-8"))
    (package,) = (p for p in lock["package"] if p["name"] == "pkm-oed")
    metadata_table = package["metadata"]
    locked = {"run": metadata_table["requires-dist"], **metadata_table["requires-dev"]}
    groups = project["dependency-groups"]
    extras = project["project"]["optional-dependencies"].values()
    run = [*project["project"]["dependencies"], *itertools.chain(*extras)]
    stated = {"run": run, **groups}
    assert locked.keys() == stated.keys()
    for group, entries in locked.items():
        pins = {entry["name"] + entry["specifier"] for entry in entries}
        without_extras = {re.sub(r"\[.*\]", "", item) for item in stated[group]}
        assert pins == without_extras, "run `make lock`"


def test_the_command_of_the_package_is_there(project):
    (script,) = metadata.entry_points(group="console_scripts", name="oed")
    assert script.value == project["project"]["scripts"]["oed"]
    assert callable(script.load())
