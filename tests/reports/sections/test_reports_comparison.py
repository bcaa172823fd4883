"""Several results side by side: differences, accuracy, parameters, diagnoses."""

from pathlib import Path
from typing import Any

import msgspec
import pytest
import report_fixture
from msgspec.structs import replace
from report_fixture import result_of, text_of
from report_fixture_fit import spread

from oed.result import StudyResult
from pkm_reports import text, write_comparison
from pkm_reports.comparison import content
from pkm_reports.sections import comparison as side_by_side
from pkm_studies.commands import main
from pkm_studies.sessions import history


def two_of_one_head(mode: str) -> dict[str, StudyResult]:
    """Two plans for one head: the second takes twice as long and halves z."""
    raw = report_fixture.sample()
    raw["prediction"]["mode"] = mode
    raw["prediction"]["components"]["z"]["after"] = spread(30.0, "um")
    first = result_of(raw)
    raw["prediction"]["components"]["z"]["after"] = spread(15.0, "um")
    raw["design"]["order"]["minutes"] *= 2.0
    raw["identifiability"]["rank"] = 22
    return {"one": first, "two": result_of(raw)}


@pytest.fixture
def results() -> dict[str, StudyResult]:
    """Both with readings, and their effects corrected."""
    return two_of_one_head("corrected")


def _plain(lines: list[Any]) -> str:
    words = [item for block in lines for item in getattr(block, "items", [])]
    return " ".join(words).replace(text.NO_BREAK, " ")


def test_differences_come_first_and_name_the_better():
    results = two_of_one_head("plan")
    words = _plain(side_by_side.sentences(results))
    assert "one takes the least time" in words
    assert (
        "The error of z is smallest in two: 15 µm rms, 2 times as good as in one"
        in words
    )
    assert "21 in one and 22 in two" in words
    assert "theta" not in words  # which both reach alike
    assert content(results, ()).answer[0].anchor == "differences"


def test_equal_results_have_no_differences(results):
    (paragraph,) = side_by_side.sentences({"a": results["one"], "b": results["one"]})
    assert "agree" in paragraph.text


def test_accuracies_stand_beside_what_is_wanted(results):
    design = results["one"].design
    assert design.how_many is not None
    goal = replace(design.how_many, wanted={"z_um": 25.0})
    results["one"] = replace(results["one"], design=replace(design, how_many=goal))
    table = side_by_side.accuracy_blocks(results)[0]
    row = next(r for r in table.rows if r[0].startswith("z"))
    assert row[1:] == ["30", "15", "25", "two"]


def test_parameters_are_compared_for_one_machine_alone(results):
    (table,) = side_by_side.parameter_blocks(results)
    assert len(table.rows) == len(results["one"].estimate.parameters)
    machine = replace(results["two"].machine, name="another")
    results["two"] = replace(results["two"], machine=machine)
    assert side_by_side.parameter_blocks(results) == []
    assert "machines differ" in _plain(side_by_side.sentences(results))


def test_both_files_are_written_the_same_each_time(results, tmp_path):
    page, book = write_comparison(results, tmp_path / "a", ["dq1 grew."])
    again = write_comparison(results, tmp_path / "b", ["dq1 grew."])
    assert [page.name, book.name] == ["comparison.html", "comparison.pdf"]
    assert page.read_bytes() == again[0].read_bytes()
    assert book.read_bytes() == again[1].read_bytes()
    assert "dq1 grew." in text_of(page.read_text(encoding="utf-8"))
    with pytest.raises(ValueError, match="two results"):
        write_comparison({"one": results["one"]}, tmp_path)


def test_a_machine_with_other_components_or_none_is_no_trouble(results, tmp_path):
    results |= {
        "three": result_of(report_fixture.delta()),
        "four": result_of(report_fixture.bare()),
    }
    page, _ = write_comparison(results, tmp_path)
    assert "four" in text_of(page.read_text(encoding="utf-8"))


# -- command ---------------------------------------------------------------------------
def _stored(folder: Path, result: StudyResult) -> Path:
    folder.mkdir(parents=True)
    (folder / "result.json").write_bytes(msgspec.json.encode(result))
    return folder


def test_the_command_puts_folders_side_by_side(results, tmp_path, capsys):
    folders = [_stored(tmp_path / name / "out", r) for name, r in results.items()]
    out = tmp_path / "side"
    assert main(["report", *map(str, folders), "--out", str(out)]) == 0
    assert str(out / "comparison.html") in capsys.readouterr().out
    shown = text_of((out / "comparison.html").read_text(encoding="utf-8"))
    assert "one/out and two/out side by side" in shown
    assert not list(folders[0].glob("report.*"))


def test_folders_get_names_that_tell_them_apart():
    folders = [Path("a/x/out"), Path("b/x/out"), Path("c")]
    assert history.short_names(folders[:2]) == ["a/x/out", "b/x/out"]
    assert history.short_names([folders[0], folders[2]]) == ["out", "c"]
    assert len(set(history.short_names([folders[0]] * 2))) == 2
