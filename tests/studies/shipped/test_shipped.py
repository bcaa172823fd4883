"""Shipped studies: listed, run by name, copied under a new name."""

import json
import shutil
from pathlib import Path

import pytest

from pkm_studies import shipped, stages
from pkm_studies.base import InputError
from pkm_studies.study import SUFFIX, Study

pytestmark = pytest.mark.usefixtures("own_folder")
STUDIES = Path(__file__).resolve().parents[3] / "studies"
NAMES = sorted(path.name.removesuffix(SUFFIX) for path in STUDIES.glob(f"*{SUFFIX}"))


@pytest.fixture
def ran(monkeypatch: pytest.MonkeyPatch) -> list[tuple[Study, Path]]:
    """Studies and folders that the pipeline is called with; it runs nothing."""
    calls: list[tuple[Study, Path]] = []

    def record(study: Study, out: Path, **_: object) -> None:
        calls.append((study, out))
        raise InputError("stopped by the test", "go on")

    monkeypatch.setattr(stages, "run_study", record)
    return calls


def test_every_study_is_listed_with_title_and_question(oed):
    code, out, _ = oed("list", "studies")
    assert code == 0
    entries = json.loads(oed("list", "studies", "--json")[1])
    assert [entry["name"] for entry in entries] == NAMES
    for entry in entries:
        study = Study.load(STUDIES / f"{entry['name']}{SUFFIX}")
        assert (entry["title"], entry["question"]) == (study.title, study.question)
        assert study.title in out
        assert study.question in oed("list", "studies", study.name)[1]


def test_a_study_runs_by_its_name(oed, ran):
    oed("run", "planar_gap")
    study, folder = ran[0]
    assert study.path == shipped.studies()["planar_gap"].path
    assert folder == Path("out/planar_gap")


def test_a_file_of_the_same_name_goes_first(oed, ran, tmp_path):
    shutil.copy(STUDIES / f"micro_cmm{SUFFIX}", tmp_path / "planar_gap")
    oed("run", "planar_gap")
    assert ran[0][0].name == "micro_cmm"


def test_an_unknown_name_is_corrected(oed):
    code, _, err = oed("run", "planar_gab")
    assert code == 2
    assert "STUDY = planar_gab: no such shipped study" in err
    assert "did you mean planar_gap?" in err
    code, _, err = oed("run", "planar_gab.study.toml")
    assert code == 2
    assert "there is no such study file" in err


def test_a_copy_has_its_own_name(oed, tmp_path):
    code, out, _ = oed("new", "mine", "--from", "a3_ball_bar")
    assert code == 0
    assert "oed run mine.study.toml" in out
    copy = Study.load(tmp_path / "mine.study.toml")
    original = Study.load(STUDIES / f"a3_ball_bar{SUFFIX}")
    assert copy.name == "mine"
    lines = zip(copy.text.splitlines(), original.text.splitlines(), strict=True)
    assert [pair for pair in lines if pair[0] != pair[1]] == [
        ('name = "mine"', 'name = "a3_ball_bar"')
    ]


def test_a_copy_overwrites_nothing(oed, tmp_path):
    path = tmp_path / "mine.study.toml"
    path.write_text("mine", encoding="utf-8")
    code, _, err = oed("new", "mine", "--from", "a3_ball_bar")
    assert code == 2
    assert "there is a study of this name; choose another name" in err
    assert path.read_text(encoding="utf-8") == "mine"


@pytest.mark.parametrize(("options", "words"), [
    (["--from", "a3_bal_bar"], "did you mean a3_ball_bar?"),
    (["--from", "a3_ball_bar", "--machine", "a3_head"], "leave out --machine"),
    ([], "give --machine, a name or a file of your own, or --from STUDY"),
    (["--instrument", "ball_bar"], "give --machine, a name or a file of your own"),
])  # fmt: skip
def test_what_to_start_from_is_stated_once(options, words, oed, tmp_path):
    code, _, err = oed("new", "mine", *options)
    assert (code, err.count("\n")) == (2, 1)
    assert words in err
    assert not list(tmp_path.iterdir())


def test_a_machine_alone_gets_an_instrument(oed, tmp_path):
    code, out, _ = oed("new", "mine", "--machine", "a3_head")
    assert code == 0
    assert "Instrument: " in out
    assert [path.name for path in tmp_path.iterdir()] == ["mine.study.toml"]


def test_an_installed_package_has_its_studies_inside(tmp_path, monkeypatch):
    """As in the wheel, where the repository's folder is not there."""
    inside = tmp_path / "pkm_studies" / "shipped"
    inside.mkdir(parents=True)
    shutil.copy(STUDIES / f"micro_cmm{SUFFIX}", inside)
    monkeypatch.setattr(shipped.resources, "files", lambda package: tmp_path / package)
    assert list(shipped.studies()) == ["micro_cmm"]
    assert shipped.study_path(Path("micro_cmm")) == inside / f"micro_cmm{SUFFIX}"


def test_a_folder_of_results_does_not_hide_the_study(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "micro_cmm").mkdir()
    (tmp_path / "mine").mkdir()
    assert shipped.study_path(Path("micro_cmm")).is_file()
    assert shipped.study_path(Path("mine")) == Path("mine")
