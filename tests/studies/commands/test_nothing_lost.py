"""What a user filled in stays, and what is to be measured is the same in every file."""

import json
import shutil
from pathlib import Path

import plan_sample
import pytest
import sample
from few_poses import SIMULATED

from oed import safe_files
from pkm_studies.commands import main


def run(*arguments: object) -> int:
    return main([str(a) for a in (*arguments, "--quiet")])


def filled(text: str) -> str:
    """The readings file with 300 mm in every row's last cell."""
    header, *rows = sample.table_lines(text)
    assert header.endswith("length_mm")
    return "\n".join([header, *[f"{row}300.0" for row in rows]]) + "\n"


@pytest.fixture
def study(tmp_path: Path) -> Path:
    path = tmp_path / "p.study.toml"
    path.write_text(sample.STUDY.replace("readings = 21", "readings = 18"), "utf-8")
    return path


def test_filled_in_readings_stay(study, tmp_path):
    out = tmp_path / "out"
    assert run("run", study, "--out", out) == 0
    poses = out / "poses.csv"
    planned = poses.read_text(encoding="utf-8")
    readings = filled(planned)
    poses.write_text(readings, encoding="utf-8")
    study.write_text(
        study.read_text("utf-8").replace("readings = 18", "readings = 19"), "utf-8"
    )
    for _ in range(2):
        assert run("run", study, "--out", out) == 0
        assert poses.read_text(encoding="utf-8") == readings
        assert {p.name for p in out.glob("poses*")} == {"poses.csv", "poses-2.csv"}
    again = sample.table_lines((out / "poses-2.csv").read_text(encoding="utf-8"))
    assert len(again) == 20
    result = json.loads((out / "result.json").read_text(encoding="utf-8"))
    stays = "poses.csv is not as this version wrote it, and stays as it is"
    assert any(stays in warning for warning in result["warnings"])


#: a study with a posterior and every file that a run writes
WHOLE = (
    sample.DELTA
    + "[readings]\nfiles = ['r.csv']\n[posterior]\nsteps = 100\n"
    + "[report]\npdf = false\n"
)


def again(study: Path, out: Path) -> None:
    """Run the study, whose few readings are no good fit."""
    assert run("run", study, "--out", out) == 1


@pytest.fixture(scope="module")
def first_run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the study and its first result."""
    folder = tmp_path_factory.mktemp("first")
    (folder / "s.study.toml").write_text(WHOLE, encoding="utf-8")
    (folder / "r.csv").write_text(sample.DELTA_READINGS, encoding="utf-8")
    again(folder / "s.study.toml", folder / "out")
    return folder


@pytest.fixture
def whole(first_run: Path, tmp_path: Path) -> tuple[Path, Path]:
    """The study with a posterior, and the folder of its result."""
    folder = shutil.copytree(first_run, tmp_path / "copy")
    return folder / "s.study.toml", folder / "out"


@pytest.mark.parametrize("name", ["report.html", "posterior.nc"])
def test_a_file_that_the_user_edited_stays(whole, name, capsys):
    """The new one gets a number, and the terminal names it."""
    study, out = whole
    path = out / name
    edited = path.read_bytes() + b"<!-- my remark -->"
    path.write_bytes(edited)
    capsys.readouterr()
    assert main(["run", str(study), "--out", str(out)]) == 1
    printed = capsys.readouterr().out
    assert f"Warning: The file {name} is not as this version wrote it" in printed
    assert f"the new one is {path.stem}-2{path.suffix}" in printed
    assert path.read_bytes() == edited
    assert {p.name for p in out.glob(f"{path.stem}*")} == {
        name,
        f"{path.stem}-2{path.suffix}",
    }
    if name == "report.html":
        assert f"Report: {out / 'report-2.html'}" in printed
        assert main(["report", str(out)]) == 0
        assert path.read_bytes() == edited


@pytest.mark.parametrize("older", [False, True])
def test_a_result_that_the_user_edited_is_set_aside(whole, older):
    """The same for folders of versions that kept no list of their files."""
    study, out = whole
    study.write_text(
        WHOLE.replace("[posterior]", "[posterior]\nenabled = false"), "utf-8"
    )
    path = out / "result.json"
    edited = json.loads(path.read_bytes()) | {"title": "mine"}
    path.write_text(json.dumps(edited), encoding="utf-8")
    if older:
        (out / safe_files.LIST_NAME).unlink()
    again(study, out)
    assert json.loads((out / "result-earlier.json").read_bytes()) == edited
    assert json.loads(path.read_bytes())["title"] != "mine"
    again(study, out)
    assert not (out / "result-earlier-2.json").exists()


def test_what_the_program_did_not_write_stays_in_its_folders(whole):
    study, out = whole
    unfinished = out / "posterior.unfinished"
    assert not unfinished.exists()
    (unfinished / "0").mkdir(parents=True)
    notes = [unfinished / "notes.txt", unfinished / "0" / "mine.h5"]
    for path in notes:
        path.write_text("mine", encoding="utf-8")
    again(study, out)
    assert [path.read_text(encoding="utf-8") for path in notes] == ["mine"] * 2
    assert not list(unfinished.rglob("0*.h5"))


def test_another_programs_result_stays(study, tmp_path, capsys):
    taken = tmp_path / "result.json"
    taken.write_text("[1]", encoding="utf-8")
    assert run("run", study, "--out", tmp_path) == 2
    assert f"{taken}: this file is no result" in capsys.readouterr().err
    assert taken.read_text(encoding="utf-8") == "[1]"


@pytest.mark.parametrize("name", ["p.study.toml", "old.readings.csv", "x.truth.json"])
def test_simulate_overwrites_nothing(name, study, tmp_path, capsys):
    study.write_text(SIMULATED, encoding="utf-8")
    path = tmp_path / name
    if path != study:
        path.write_text("kept", encoding="utf-8")
    content = path.read_bytes()
    out = path.with_name("x.csv") if name == "x.truth.json" else path
    assert main(["simulate", str(study), "--out", str(out)]) == 2
    assert f"{path}: there is a file" in capsys.readouterr().err
    assert path.read_bytes() == content


def test_every_file_of_a_plan_has_the_same_readings(tmp_path):
    """A study with a design as well: files and headline follow the plan."""
    design = (
        '[[design.candidates]]\nsetup = "rm4"\ny_mm = [0.0, 500.0, 1500.0]\n'
        'z_mm = [0.0, 1500.0]\nruns_by = "y"\n[design]\nreadings = 3\n'
    )
    text = plan_sample.STUDY.replace("html = false", "html = true")
    study = tmp_path / "s.study.toml"
    study.write_text(text + design, encoding="utf-8")
    for command in ("plan", "run"):
        out = tmp_path / command
        assert run(command, study, "--out", out) == 0
        stages = json.loads((out / "plan_poses.json").read_text("utf-8"))["stages"]
        counted = sum(len(stage["poses"]) for stage in stages)
        rows = sample.table_lines((out / "poses.csv").read_text("utf-8"))[1:]
        runs = {tuple(row.split(",")[:2]) for row in rows}
        assert len(rows) == counted + len(runs)  # each run has a reference
        result = json.loads((out / "result.json").read_text("utf-8"))
        assert sum(stage["readings"] for stage in result["plan"]["stages"]) == counted
        assert (out / "report.html").is_file()
