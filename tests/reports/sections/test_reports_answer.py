"""The first page answers the user's questions; several results stand side by side."""

import re
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import msgspec
import pytest
import report_fixture
import report_fixture_plan
from msgspec.structs import replace
from report_fixture import result_of, text_of
from report_fixture_fit import spread

from oed.result import EffectEstimate, SpreadRecord, StudyResult
from pkm_reports import text, write_comparison
from pkm_reports.blocks import Facts, Items, Notice, Paragraph, Table
from pkm_reports.comparison import content
from pkm_reports.sections import answer, answer_parts
from pkm_reports.sections import comparison as side_by_side
from pkm_studies.commands import main
from pkm_studies.sessions import history


def _words(result: StudyResult) -> dict[str, str]:
    """All words of each part by its anchor."""
    words = {}
    for part in answer_parts(result):
        lines: list[str] = []
        for block in part.blocks:
            match block:
                case Facts():
                    lines += [f"{term} {fact}" for term, fact in block.rows]
                case Table():
                    lines += [block.caption, *(" ".join(r) for r in block.rows)]
                case Items():
                    lines += block.items
                case Paragraph() | Notice():
                    lines.append(block.text)
        words[part.anchor] = " ".join(lines).replace(text.NO_BREAK, " ")
    return words


def test_a_plan_says_what_how_long_and_how_accurate():
    words = _words(result_of(report_fixture.sample()))
    assert list(words) == ["short", "how-accurate", "measure", "unknown", "warnings"]
    assert "30, chosen from 1512 candidates" in words["measure"]
    assert "Double ball bar" in words["measure"]
    minutes = report_fixture.sample()["design"]["order"]["minutes"]
    assert f"Time {text.number(minutes, 2)} min" in words["measure"]
    assert (
        f"Take 30 readings with the double ball bar: {text.number(minutes, 2)} min"
        in (words["short"])
    )


def test_readings_that_no_design_chose_are_counted_alone():
    raw = report_fixture.sample()
    raw["prediction"]["mode"] = "corrected"
    raw["drawing"]["tool_points"] = [[0.0, 0.0, 0.1]] * 98
    words = _words(result_of(raw))["measure"]
    assert "Readings 98" in words
    assert "chosen from" not in words
    assert "in their order" not in words


def test_a_bare_result_promises_nothing():
    words = _words(result_of(report_fixture.bare()))
    assert list(words) == ["measure", "warnings"]
    assert "no warnings" in words["warnings"]
    assert "Readings" not in words["measure"]


# -- accuracy --------------------------------------------------------------------------
@pytest.mark.parametrize(("limit", "reached"), [(1e9, True), (1e-9, False)])
def test_the_wanted_accuracy_stands_beside_the_predicted(limit, reached):
    raw = report_fixture.sample()
    raw["design"]["how_many"]["wanted"] = {"z_um": limit}
    (table, *_) = answer.accuracy_blocks(result_of(raw))
    assert isinstance(table, Table)
    assert [c.title for c in table.columns][-2:] == ["Within", "Verdict"]
    assert table.rows[0][0] == "z [µm]"
    assert table.rows[0][-1] == ("? cannot tell" if reached else "✗ fail")
    assert table.marks[0] == ("chosen" if reached else "bad")
    others = {row[-1] for row in table.rows[1:]}
    assert others == {text.MISSING}


def test_an_error_that_no_drive_corrects_is_judged_by_its_unknown_part():
    raw = report_fixture.sample()
    x = raw["prediction"]["components"]["x"]
    assert not x["compensatable"]
    x["after"] |= {"rms": 1493.0}
    x["known"] |= {"rms": 60.0, "rms_quantiles": [60.0] * len(SpreadRecord.LEVELS)}
    raw["design"]["how_many"]["wanted"] = {"x_um": 100.0}
    result = result_of(raw)
    words = _words(result)["how-accurate"]
    assert "x keeps 1493 µm, but all of this except 60 µm is known" in words
    assert re.search(r"x \[µm\] [\d.]+ 60 .* 100 over 99 % \? cannot tell", words)


def test_without_a_wanted_accuracy_nothing_is_judged():
    raw = report_fixture.sample()
    raw["design"]["how_many"]["wanted"] = {}
    words = _words(result_of(raw))["how-accurate"]
    assert "states no wanted accuracy" in words
    assert "yes" not in words


def test_a_plan_of_stages_stands_beside_its_goal():
    raw = report_fixture.bare() | {"plan": report_fixture_plan.plan(wanted=True)}
    words = _words(result_of(raw))
    assert "Stages" in words["measure"]
    assert "z [µm] 32.6 26.3 8300" in words["how-accurate"]


# -- unknown ---------------------------------------------------------------------------
def test_what_is_lost_stands_with_what_brings_it_back():
    result = result_of(report_fixture.sample())
    words = _words(result)["unknown"]
    assert "determine 21 of 24 unknowns: 3 combinations of them stay" in words
    assert "What helps: a second tool length (two of the three); an" in words


def test_where_nothing_is_lost_the_page_says_so():
    raw = report_fixture.sample()
    raw["identifiability"] |= {"rank": 24, "lost": [], "words": []}
    (paragraph,) = answer.unknown_blocks(result_of(raw))
    assert "all of the 24" in paragraph.text.replace(text.NO_BREAK, " ")


# -- warnings --------------------------------------------------------------------------
def test_the_most_harmful_warning_stands_first():
    goodness = {
        "chi2": 900.0, "dof": 10.0, "p_low": 1.0, "p_high": 0.0, "bad_fit": True,
        "findings": ["the readings do not fit the model"],
    }  # fmt: skip
    raw = report_fixture.sample() | {"goodness": goodness}
    raw["estimate"]["warnings"] = ["a parameter lies far out"]
    ranked = list(answer.ranked_warnings(result_of(raw)))
    assert ranked[0] == "the readings do not fit the model"
    assert ranked[1].startswith("The study misses a claim")
    assert ranked[2] == "a parameter lies far out"
    assert ranked[3:] == raw["warnings"]


# -- causes ----------------------------------------------------------------------------
def test_causes_are_ranked_by_size_with_their_unit_and_probability():
    gap = {
        "verdict": "effect", "answers": [], "set95": [], "where": [], "closure": [],
        "not_testable": [], "confusable": [], "selected": ["leg_thermal", "backlash"],
        "marginal": {"leg_thermal": 0.98, "backlash": 0.99, "friction": 0.2},
        "sizes": [
            {"effect": "leg_thermal", "rms": {"length": 2.0}, "detectability": 9.0},
            {"effect": "backlash", "rms": {"length": 5.0}, "detectability": 20.0},
        ],
        "units": {"length": "um"}, "rms_before": {"length": 6.0},
        "rms_after": {"length": 0.5}, "next": ["preload the screws"],
    }  # fmt: skip
    certain = {"leg_thermal": 0.98, "backlash": 1.0 - 1e-9}
    raw = report_fixture.bare() | {"gap": gap}
    result = result_of(raw)
    (table,) = [b for b in answer.cause_blocks(result) if isinstance(b, Table)]
    assert [row[0] for row in table.rows] == ["backlash", "leg thermal", "friction"]
    assert table.rows[0][2].replace(text.NO_BREAK, " ") == "5 µm"
    assert table.rows[0][1].replace(text.NO_BREAK, " ") == "99 %"
    result = result_of(report_fixture.bare() | {"gap": gap | {"marginal": certain}})
    (table,) = [b for b in answer.cause_blocks(result) if isinstance(b, Table)]
    assert table.rows[0][1].replace(text.NO_BREAK, " ") == "> 99 %"
    words = _words(result)["causes"]
    assert "length 6 µm before, 0.500 µm after" in words
    assert "Preload the screws." in words
    nothing = {
        "verdict": "none", "selected": [], "sizes": [], "rms_after": {"length": 6.0},
    }  # fmt: skip
    words = _words(result_of(report_fixture.bare() | {"gap": gap | nothing}))["causes"]
    assert "What calibration leaves, rms: length 6 µm." in words
    assert "before" not in words


def test_a_ratio_of_percents_is_in_percent():
    """Five digits of ppm hide that a leg's conversion is wrong by a twentieth."""
    sizes = {
        "encoder_scale: leg 1": EffectEstimate(
            -49319, 2795, "ppm", "encoder_scale", 50
        ),
        "encoder_scale: leg 2": EffectEstimate(9000, 100, "ppm", "encoder_scale", 50),
    }
    section = SimpleNamespace(effects=sizes)
    words = answer.own_size("encoder_scale", section).replace(text.NO_BREAK, " ")
    assert words == "leg 1 −4.93 ± 0.28 % and leg 2 9000 ± 100 ppm"


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


def test_errors_of_other_references_are_not_compared(results):
    prediction = replace(results["two"].prediction, reference="absolute")
    results["two"] = replace(results["two"], prediction=prediction)
    words = _plain(side_by_side.sentences(results))
    assert "Errors have different references: one" in words
    assert "times as good" not in words


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
