"""The chapter of a plan in stages and its measurement sheet, also where parts lack."""

import re
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
import report_fixture_plan
from matplotlib.backends.backend_agg import FigureCanvasAgg
from msgspec.structs import replace
from report_fixture import check_box, result_of, shown_text

from oed.result import PlannedReading, PlanSection, Sd, StudyResult
from pkm_reports import sections, style, write_sheet
from pkm_reports.blocks import Paragraph, Picture
from pkm_reports.page import Document, sheet
from pkm_reports.sections import stages

pytestmark = pytest.mark.pictures

NASTY = '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$ \u202e \x00 {{ 1 }} </script>'
NEEDED = {"stages", "cost", "alternatives"}
OPTIONAL = sorted(set(PlanSection.__struct_fields__) - NEEDED)
#: keys of a plan and of a stage that may be null
NULLABLE = ["budget_min", "value", "bound", "loss", "lines"]
NULLABLE_OF_STAGE = [
    "chosen", "end_min", "lost", "cut_off_um", "rank", "realised_lost", "coverage",
]  # fmt: skip
NEEDED_OF_STAGE = {
    "measurement", "setups", "readings", "identifies", "cost", "kappa", "predicted",
    "begin_min",
}  # fmt: skip
OPTIONAL_OF_STAGE = sorted(
    set(report_fixture_plan.plan()["stages"][0]) - NEEDED_OF_STAGE
)


def _small(plan: dict[str, Any]) -> StudyResult:
    """A result that holds nothing but the machine and the plan."""
    return result_of(report_fixture.bare() | {"plan": plan})


def _plan(**changes: Any) -> PlanSection:
    """The sample's plan, with some fields changed."""
    plan = msgspec.convert(report_fixture_plan.plan(), PlanSection)
    return replace(plan, **changes)


# -- chapter ---------------------------------------------------------------------------
def test_the_chapter_is_there_only_where_stages_are_planned():
    planned = sections.chapters(_small(report_fixture_plan.plan()))
    others = sections.chapters(result_of(report_fixture.sample()))
    assert [section.anchor for section in planned] == ["plan", "stages"]
    assert "stages" not in [section.anchor for section in others]
    assert not stages.has_schedule(None)
    assert not stages.has_schedule(PlanSection([], 0.0, []))


def test_stages_and_verdict_are_reported():
    shown = " ".join(shown_text(_small(report_fixture_plan.plan())).split())
    for words in (
        "Known before: 12 readings of a first day, 33 min.",
        (
            "The goal is out of reach within 120 min: z 26.3 µm and theta 2.36 arcsec."
            " The most accurate plan found reaches z 31.7 µm"
        ),
        "What would have to change: Half the noise of bar 300 reaches z to 11.2 µm.",
        (
            "below 1.19: the most accurate plan found is at most 4.3 % worse than the"
            " best possible one (proven with 17 supp"
        ),
        "When to stop: a fourth stage (bar 150, cup low) would gain 2.1 %",
        "24.5–61 bar 300, cup low short tool",
        "0.72 of 18",
        "a chance of 83 %",
        "da1y, 0.71 db2x - 0.71 db3x and db1y",
        (
            "200 virtual machines went through all stages: their errors are 0.930 to"
            " 1.12 of the predicted ones."
        ),
        (
            "contain 95 % of the true parameters. They lost 0.85 candidates on average;"
            " 0.77 were expected."
        ),
        (
            "bar 300, cup low (24) → bar 250, cup high (24) 84 26.0 A rough stage is"
            " missing: 68 % of the readings"
        ),
        "RM 5 24 61 16 of 18",
        "From 19 min to 108 min the value falls from 74.4 to 1.24",
    ):
        assert words in shown, words
    assert "AlternativePlan" not in shown


def test_a_plan_without_a_goal_says_what_it_reaches():
    shown = shown_text(_small(report_fixture_plan.plan(wanted=False)))
    verdict = (
        "The most accurate plan found has 3 stages and takes 108 min of a budget of"
        " 120 min"
    )
    assert verdict in shown
    assert "this plan is at most 4.3 % worse than the best possible one" in shown
    assert "out of reach" not in shown


def test_a_reached_goal_is_reported():
    shown = shown_text(_small(report_fixture_plan.plan() | {"reached": True}))
    verdict = (
        "The goal (z 26.3 µm and theta 2.36 arcsec) is reached. The least costly plan"
        " found has"
    )
    assert verdict in shown
    assert "out of reach" not in shown


@pytest.mark.parametrize(("loss", "written"), [
    (0.0430, "4.3\N{NO-BREAK SPACE}%"),
    (0.04301, "4.4\N{NO-BREAK SPACE}%"),
    (0.0, "0.0\N{NO-BREAK SPACE}%"),
    (0.0009, "0.1\N{NO-BREAK SPACE}%"),
    (10.44, "a factor of 11.5"),
])  # fmt: skip
def test_a_loss_is_never_rounded_down(loss, written):
    plan = report_fixture_plan.plan(wanted=False) | {"loss": loss}
    blocks = stages.blocks(_small(plan))
    texts = [block.text for block in blocks if isinstance(block, Paragraph)]
    assert any(f"at most {written}" in words for words in texts)


@pytest.mark.parametrize("names", [*[[name] for name in OPTIONAL], OPTIONAL])
def test_each_part_of_the_plan_may_be_absent(names):
    plan = report_fixture_plan.plan()
    for name in names:
        plan.pop(name, None)
    _check(_small(plan), draw=len(names) > 1)


@pytest.mark.parametrize("names", [*[[name] for name in NULLABLE], NULLABLE])
def test_parts_of_the_plan_may_be_null(names):
    plan = report_fixture_plan.plan() | dict.fromkeys(names)
    _check(_small(plan), draw=len(names) > 1)


def test_each_part_of_a_stage_may_be_absent():
    for names in [*[[name] for name in OPTIONAL_OF_STAGE], OPTIONAL_OF_STAGE]:
        plan = report_fixture_plan.plan()
        for stage in plan["stages"]:
            for name in names:
                stage.pop(name)
        _check(_small(plan), draw=len(names) > 1)


def test_parts_of_a_stage_may_be_null():
    for names in [*[[name] for name in NULLABLE_OF_STAGE], NULLABLE_OF_STAGE]:
        plan = report_fixture_plan.plan()
        for stage in plan["stages"]:
            stage |= dict.fromkeys(names)
        _check(_small(plan), draw=len(names) > 1)


def _check(result: StudyResult, *, draw: bool) -> None:
    """Texts hold no number that is none; `draw`: all figures can be drawn and set."""
    blocks = stages.blocks(result)
    texts = [
        block.caption if isinstance(block, Picture) else repr(block) for block in blocks
    ]
    assert not {"nan", "None"} & set(re.findall(r"\w+", " ".join(texts)))
    if draw:
        assert Document.from_result(result).pdf().startswith(b"%PDF")


def test_names_are_never_markup(tmp_path):
    plan = report_fixture_plan.plan()
    plan |= {"needs": [NASTY], "stop": NASTY, "after": NASTY}
    plan["stages"][0] |= {
        "measurement": NASTY,
        "setups": [NASTY],
        "operator": NASTY,
        "held": [NASTY],
    }
    plan["alternatives"][0] |= {"names": [NASTY], "why": NASTY}
    plan["compared"][0] |= {"name": NASTY, "words": NASTY}
    result = replace(_small(plan), title=NASTY)
    report = Document.from_result(result)
    page = report.html().decode()
    assert "<b>&" not in page
    assert page.count("</script>") == 1
    assert report.pdf().startswith(b"%PDF")
    poses = [PlannedReading(NASTY, NASTY, 0, {NASTY: 1.0}, {NASTY: 1.0})]
    printed = write_sheet(result, poses, tmp_path)
    assert printed.read_bytes().startswith(b"%PDF")


# -- figures ---------------------------------------------------------------------------
def test_lines_and_diamonds_are_the_numbers():
    plan = _plan()
    with style.applied():
        panels = stages.draw_accuracies(plan).axes
    lines = [line for axes in panels for line in axes.lines]
    drawn = {str(line.get_label()): np.array(line.get_xydata()) for line in lines}
    accuracy = np.array([stage.accuracy["z_um"] for stage in plan.stages])
    z = [8300.0, *accuracy]
    np.testing.assert_allclose(drawn["z"], np.transpose([[0, 1, 2, 3], z]))
    lengths = panels[0].lines
    diamonds = [line for line in lengths if line.get_label() == stages.REALISED]
    assert len(diamonds) == 3
    ratio = np.array([stage.realised["z"] for stage in plan.stages])
    of_z = np.array(diamonds[2].get_ydata())[1:]
    np.testing.assert_allclose(of_z, accuracy * ratio)
    dotted = [line for line in lengths if line.get_linestyle() == ":"]
    levels = {float(y) for line in dotted for y in np.array(line.get_ydata())}
    assert list(levels) == pytest.approx([plan.goal["z_um"]])


def test_bars_lie_where_the_stages_are():
    with style.applied():
        axes = stages.draw_timeline(_plan()).axes[0]
    begins = [bar.get_x() for bar in axes.patches]
    ends = [bar.get_x() + bar.get_width() for bar in axes.patches]
    np.testing.assert_allclose(begins, [0.0, 24.5, 61.0])
    np.testing.assert_allclose(ends, [24.5, 61.0, 108.0])


@pytest.mark.parametrize("wanted", [True, False])
def test_the_shade_ends_at_the_bound_and_no_plan_lies_in_it(wanted):
    plan = msgspec.convert(report_fixture_plan.plan(wanted=wanted), PlanSection)
    with style.applied():
        axes = stages.draw_front(plan).axes[0]
    (shade,) = axes.collections
    corners = shade.get_paths()[0].vertices
    assert corners[:, 1].max() == pytest.approx(plan.bound)
    assert corners[:, 0].max() == pytest.approx(120.0)
    lines = [line for line in axes.lines if line.get_marker() in ("o", "*", "x")]
    plans = np.vstack([np.array(line.get_xydata()) for line in lines])
    assert len(plans) == len(plan.front) + len(plan.alternatives) + 1
    assert (plans[:, 1] >= plan.bound).all()
    low, high = axes.get_ylim()
    assert low < plan.bound
    assert high > plans[:, 1].max()


def _captions(**changes: Any) -> str:
    """Captions of all figures of the sample's plan, with some fields changed."""
    blocks = stages.blocks(_small(report_fixture_plan.plan() | changes))
    captions = (b.caption for b in blocks if isinstance(b, Picture))
    return " ".join(captions).replace("\N{NO-BREAK SPACE}", " ")


def test_a_front_of_one_plan_spans_no_time():
    first, *_, last = front = report_fixture_plan.plan()["front"]
    assert "the value falls" not in _captions(front=[first])
    assert "From 19 min to 108 min" in _captions(front=[first, last])
    assert "From 19 min to 108 min" in _captions(front=front)


@pytest.mark.parametrize(("count", "said"), [(6, False), (7, True)])
def test_sequences_beyond_the_figure_are_in_the_table(count, said):
    compared = report_fixture_plan.plan()["compared"][:1] * count
    captions = _captions(compared=compared)
    assert ("1 more sequences are in the table only." in captions) == said
    assert ("more sequences" in captions) == said


FIGURES = [stages.draw_accuracies, stages.draw_timeline, stages.draw_front]


@pytest.mark.parametrize("draw", FIGURES)
def test_figures_keep_all_words_inside(draw):
    plan = _plan()
    stages = [
        replace(
            stage,
            measurement=f"{stage.measurement}, a long name that has no end in sight",
        )
        for stage in plan.stages
    ]
    with style.applied():
        figure = draw(replace(plan, stages=stages))
        figure.draw_without_rendering()
        renderer: Any = FigureCanvasAgg(figure).get_renderer()
        for axes in figure.axes:
            check_box(axes.get_tightbbox(renderer), figure)
        check_box(figure.legends[0].get_window_extent(renderer), figure)


@pytest.mark.parametrize("draw", FIGURES)
def test_a_figure_without_data_says_so(draw):
    with style.applied():
        figure = draw(PlanSection([], 0.0, []))
    assert re.search(r"No .* (is|are) stored", figure.texts[0].get_text())


# -- measurement sheet -----------------------------------------------------------------
def _rows(count: int, setup: str) -> list[PlannedReading]:
    return [
        PlannedReading(setup, "1", k, {"z_mm": 0.5 * k, "psi_deg": 3.0 * k}, {})
        for k in range(count)
    ]


def _tables(printed: dict[str, Any]) -> list[dict[str, Any]]:
    return [table for stage in printed["stages"] for table in stage["tables"]]


def _printed_rows(table: dict[str, Any]) -> list[list[str]]:
    """Rows of a set-up in reading order, one part after another."""
    return [list(row) for block in table["blocks"] for row in block]


def test_the_sheet_holds_every_pose_once_in_order():
    result = result_of(report_fixture_plan.sample())
    poses = result.design.poses
    tables = {table["setup"]: table for table in _tables(sheet.build(result, poses))}
    for setup in ("short tool", "long tool"):
        commands = [pose.command for pose in poses if pose.setup == setup]
        rows = _printed_rows(tables[setup])
        assert [row[0] for row in rows] == [str(k + 1) for k in range(len(commands))]
        numbers = np.array([[float(cell) for cell in row[1:4]] for row in rows])
        expected = [list(command.values()) for command in commands]
        np.testing.assert_allclose(numbers, expected, atol=5.1e-4)
        assert {row[-1] for row in rows} == {""}
    assert _printed_rows(tables["tracker"]) == []


def test_the_sheet_has_the_joints_beside_the_command():
    result = result_of(report_fixture_plan.sample())
    poses = [replace(p, joints={"q1_mm": 500.0 + p.order}) for p in _rows(8, "bar")]
    (table,) = [t for t in _tables(sheet.build(result, poses)) if t["setup"] == "bar"]
    column = table["titles"].index("q1 [mm]")
    assert table["titles"][column - 1] == "psi [°]"
    assert [float(row[column]) for row in _printed_rows(table)] == [
        500.0 + k for k in range(8)
    ]


@pytest.mark.parametrize("counts", [(1, 0), (70, 50), (100, 40), (300, 5)])
def test_a_long_sheet_is_cut_and_says_so(counts, tmp_path):
    poses = _rows(counts[0], "short tool") + _rows(counts[1], "long tool")
    result = result_of(report_fixture_plan.sample())
    tables = _tables(sheet.build(result, poses))
    printed = sum(len(_printed_rows(table)) for table in tables)
    assert printed == min(sum(counts), sheet.MAX_ROWS)
    notes = [re.match(r"\d+.*see poses.csv", table["more"]) for table in tables]
    omitted = sum(int(note.group().split()[0]) for note in notes if note)
    assert omitted == sum(counts) - printed
    assert _pages(write_sheet(result, poses, tmp_path / "new").read_bytes()) == 1


def _pages(data: bytes) -> int:
    """Pages of a PDF, by the page tree's count."""
    return max(int(n) for n in re.findall(rb"/Count (\d+)", data))


def test_the_sheet_is_the_same_each_time_and_needs_poses(tmp_path):
    result = result_of(report_fixture_plan.sample())
    first = write_sheet(result, None, tmp_path / "a").read_bytes()
    again = write_sheet(result, result.design.poses, tmp_path / "b").read_bytes()
    assert first == again
    with pytest.raises(ValueError, match="needs poses"):
        write_sheet(result_of(report_fixture.bare()), None, tmp_path)


def test_a_stage_names_what_it_improves_most_and_nothing_that_gets_worse():
    before = {"arm1": Sd(1.0, "mm"), "arm2": Sd(1.0, "mm"), "arm3": Sd(0.1, "mm")}
    after = {"arm1": Sd(0.1, "mm"), "arm2": Sd(0.02, "mm"), "arm3": Sd(1.0, "mm")}
    told = stages._most_improved(before, after)
    assert told.index("arm2") < told.index("arm1")
    assert "(50×)" in told
    assert "arm3" not in told
    assert stages._most_improved(after, {"arm1": Sd(0.1, "mm")}) == "none"
