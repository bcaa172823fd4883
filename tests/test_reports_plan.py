"""The chapter of the step plan and its measurement sheet: all is told, parts may lack,
figures against the numbers.
"""

from __future__ import annotations

import html
import io
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
import report_fixture_plan
from matplotlib.backends.backend_agg import FigureCanvasAgg

from oed.result import PlanSection
from pkm_reports import document, sections, style, write_sheet
from pkm_reports import html as html_writer
from pkm_reports import pdf as pdf_writer
from pkm_reports import sheet as sheets
from pkm_reports.figures import front, stages, timeline
from pkm_reports.sections import campaign

NASTY = '<b>&"#$ \\ * _ `x` @y #panic("x") $x^2$ \u202e \x00 {{ 1 }} </script>'
NEEDED = {"stages", "cost", "alternatives"}
NEEDED_OF_STAGE = {
    "measurement",
    "setups",
    "readings",
    "identifies",
    "cost",
    "kappa",
    "predicted",
    "begin_min",
}


def _small(plan: dict[str, Any]) -> dict[str, Any]:
    """A result that holds nothing but the machine and the plan, as it comes back from
    result.json.
    """
    decoded: dict[str, Any] = json.loads(
        msgspec.json.encode(report_fixture.bare() | {"plan": plan})
    )
    return decoded


def _shown(result: dict[str, Any]) -> str:
    """Text of the page, its no-break spaces as spaces."""
    page = html_writer.render(document.build(result)).decode()
    return html.unescape(re.sub(r"<[^>]*>", " ", page)).replace(
        "\N{NO-BREAK SPACE}", " "
    )


@pytest.mark.parametrize("wanted", [True, False])
def test_the_fixture_conforms_to_the_schema(wanted: bool) -> None:
    plan = msgspec.convert(report_fixture_plan.plan(wanted=wanted), PlanSection)
    assert len(plan.stages) == 3


def test_the_chapter_stands_first_and_only_where_stages_are_planned() -> None:
    with_plan = [
        s.anchor for s in sections.chapters(_small(report_fixture_plan.plan()))
    ]
    without = [s.anchor for s in sections.chapters(report_fixture.sample())]
    assert with_plan == ["campaign", *without]
    assert not campaign.planned(report_fixture.bare())
    assert not campaign.planned(
        {"plan": {"stages": [], "cost": 0.0, "alternatives": []}}
    )


def test_stages_and_verdict_are_told() -> None:
    plan = report_fixture_plan.plan()
    shown = " ".join(_shown(_small(plan)).split())
    for text in (
        "Known before: 12 readings of a first day, 33 min.",
        (
            "Out of reach within 120 min: z 26.3 µm and theta 2.36 arcsec. The most"
            " accurate plan found leaves z 31.7 µm"
        ),
        "What would have to change: Half the noise of bar 300 reaches z to 11.2 µm.",
        (
            "below 1.19: the most accurate plan found misses the best possible one by"
            " at most 4.3 % (proven with 17 supp"
        ),
        "When to stop: a fourth stage (bar 150, cup low) would gain 2.1 %",
        "24.5–61 bar 300, cup low short tool",
        "0.72 of 18",
        "a chance of 83 %",
        "da1y, 0.71 db2x - 0.71 db3x and db1y",
        (
            "200 virtual machines went through all stages: they realised 0.930 to 1.12"
            " of the predicted errors"
        ),
        (
            "held 95 % of the true parameters; they lost 0.85 candidates on average,"
            " 0.77 were expected"
        ),
        (
            "bar 300, cup low (24) → bar 250, cup high (24) 84 26.0 a rough stage is"
            " missing: 68 % of the readings"
        ),
        "RM 5 24 61 16 of 18",
        "From 19 min to 108 min the value falls from 74.4 to 1.24",
    ):
        assert text in shown, text
    assert "{'names'" not in shown


def test_a_plan_without_a_goal_tells_what_it_leaves() -> None:
    shown = _shown(_small(report_fixture_plan.plan(wanted=False)))
    assert (
        "The most accurate plan found has 3 stages in 108 min of the 120 min there are"
        in shown
    )
    assert "the plan misses the best possible one by at most 4.3 %" in shown
    assert "Out of reach" not in shown


def test_a_reached_goal_is_said_so() -> None:
    shown = _shown(_small(report_fixture_plan.plan() | {"reached": True}))
    assert (
        "What is wanted (z 26.3 µm and theta 2.36 arcsec) is reached. The least costly"
        " plan found has" in shown
    )
    assert "Out of reach" not in shown


@pytest.mark.parametrize(
    ("loss", "told"), [(0.0430, "4.3"), (0.04301, "4.4"), (0.0, "0.0"), (0.0009, "0.1")]
)
def test_a_loss_is_never_rounded_down(loss: float, told: str) -> None:
    plan = report_fixture_plan.plan(wanted=False) | {"loss": loss}
    texts = [b.text for b in campaign.blocks(_small(plan)) if b.kind == "paragraph"]
    assert any(f"at most {told}\N{NO-BREAK SPACE}%" in text for text in texts)


def test_a_large_loss_is_a_factor() -> None:
    plan = report_fixture_plan.plan(wanted=False) | {"loss": 10.44}
    texts = [b.text for b in campaign.blocks(_small(plan)) if b.kind == "paragraph"]
    assert any("at most a factor of 11.5" in text for text in texts)


@pytest.mark.parametrize("kind", ["absent", "null"])
@pytest.mark.parametrize("name", [*sorted(PlanSection.__struct_fields__), "all"])
def test_each_part_of_the_plan_may_be_missing(kind: str, name: str) -> None:
    if name in NEEDED:
        return
    plan = report_fixture_plan.plan()
    names = (
        [n for n in PlanSection.__struct_fields__ if n not in NEEDED]
        if name == "all"
        else [name]
    )
    for n in names:
        plan.pop(n, None) if kind == "absent" else plan.update({n: None})
    _sound(_small(plan), draw=name == "all")


@pytest.mark.parametrize("kind", ["absent", "null"])
def test_each_part_of_a_stage_may_be_missing(kind: str) -> None:
    fields = [
        n for n in report_fixture_plan.plan()["stages"][0] if n not in NEEDED_OF_STAGE
    ]
    for names in [*[[n] for n in fields], fields]:
        plan = report_fixture_plan.plan()
        for stage in plan["stages"]:
            for n in names:
                stage.pop(n) if kind == "absent" else stage.update({n: None})
        _sound(_small(plan), draw=len(names) > 1)


def _sound(result: dict[str, Any], *, draw: bool) -> None:
    """Texts hold no number that is none; where asked for, all figures are drawn and
    set.
    """
    told = repr([b for b in campaign.blocks(result) if b.kind != "picture"])
    captions = [b.caption for b in campaign.blocks(result) if b.kind == "picture"]
    assert not {"nan", "None"} & set(re.findall(r"\w+", told + repr(captions)))
    if draw:
        assert pdf_writer.render(document.build(result)).startswith(b"%PDF")


def test_names_are_never_markup(tmp_path: Path) -> None:
    result = _small(report_fixture_plan.plan())
    plan = result["plan"]
    plan |= {"needs": [NASTY], "stop": NASTY, "after": NASTY}
    plan["stages"][0] |= {
        "measurement": NASTY,
        "setups": [NASTY],
        "operator": NASTY,
        "held": [NASTY],
    }
    plan["alternatives"][0] |= {"names": [NASTY], "why": NASTY}
    plan["compared"][0] |= {"name": NASTY, "words": NASTY}
    made = document.build(result)
    page = html_writer.render(made).decode()
    assert "<b>&" not in page
    assert "</script>" not in page
    assert pdf_writer.render(made).startswith(b"%PDF")
    rows = [
        {
            "setup": NASTY,
            "run": NASTY,
            "order": 0,
            "command": {NASTY: 1.0},
            "reading": {NASTY: 1.0},
        }
    ]
    assert (
        write_sheet(result | {"title": NASTY}, rows, tmp_path)
        .read_bytes()
        .startswith(b"%PDF")
    )


# -- figures ---------------------------------------------------------------------------


def test_lines_and_diamonds_are_the_numbers() -> None:
    plan = report_fixture_plan.plan()
    with style.applied():
        panels = stages.draw(plan).axes
    drawn = {
        str(line.get_label()): np.array(line.get_xydata())
        for axes in panels
        for line in axes.lines
    }
    z = [8300.0, *[stage["accuracy"]["z_um"] for stage in plan["stages"]]]
    np.testing.assert_allclose(drawn["z"], np.transpose([[0, 1, 2, 3], z]))
    diamonds = [line for line in panels[0].lines if line.get_label() == stages.REALISED]
    assert len(diamonds) == 3
    ratio = [stage["realised"]["z"] for stage in plan["stages"]]
    np.testing.assert_allclose(
        np.array(diamonds[2].get_ydata())[1:], np.array(z[1:]) * ratio
    )
    dotted = [
        np.array(line.get_ydata())
        for line in panels[0].lines
        if line.get_linestyle() == ":"
    ]
    (level,) = {float(heights[0]) for heights in dotted if len(heights)}
    assert level == pytest.approx(plan["goal"]["z_um"])


def test_bars_lie_where_the_stages_are() -> None:
    plan = report_fixture_plan.plan()
    with style.applied():
        axes = timeline.draw(plan).axes[0]
        plan["stages"][1]["mounting_min"] = 15.0
        parted = timeline.draw(plan).axes[0]
    spans = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in axes.patches]
    np.testing.assert_allclose(spans, [(0.0, 24.5), (24.5, 61.0), (61.0, 108.0)])
    spans = [(bar.get_x(), bar.get_x() + bar.get_width()) for bar in parted.patches]
    np.testing.assert_allclose(
        spans, [(0.0, 24.5), (24.5, 39.5), (39.5, 61.0), (61.0, 108.0)]
    )


@pytest.mark.parametrize("wanted", [True, False])
def test_the_shade_ends_at_the_bound_and_no_plan_lies_in_it(wanted: bool) -> None:
    plan = report_fixture_plan.plan(wanted=wanted)
    with style.applied():
        axes = front.draw(plan).axes[0]
    (shade,) = axes.collections
    corners = shade.get_paths()[0].vertices
    assert corners[:, 1].max() == pytest.approx(plan["bound"])
    assert corners[:, 0].max() == pytest.approx(120.0)
    found = np.vstack(
        [
            np.array(line.get_xydata())
            for line in axes.lines
            if line.get_marker() in ("o", "*", "x")
        ]
    )
    assert len(found) == len(plan["front"]) + len(plan["alternatives"]) + 1
    assert (found[:, 1] >= plan["bound"]).all()
    low, high = axes.get_ylim()
    assert low < plan["bound"]
    assert high > found[:, 1].max()


@pytest.mark.parametrize("draw", [stages.draw, timeline.draw, front.draw])
def test_figures_keep_all_words_inside(draw: Any) -> None:
    plan = report_fixture_plan.plan()
    for stage in plan["stages"]:
        stage["measurement"] = (
            f"{stage['measurement']}, a long name that has no end in sight"
        )
    with style.applied():
        figure = draw(plan)
        figure.draw_without_rendering()
        renderer: Any = FigureCanvasAgg(figure).get_renderer()
    boxes = [axes.get_tightbbox(renderer) for axes in figure.axes] + [
        figure.legends[0].get_window_extent(renderer)
    ]
    for box in boxes:
        assert min(box.x0, box.y0) > -2.0
        assert box.x1 < figure.bbox.width + 2.0
        assert box.y1 < figure.bbox.height + 2.0


@pytest.mark.parametrize("draw", [stages.draw, timeline.draw, front.draw])
def test_a_figure_without_data_says_so(draw: Any) -> None:
    with style.applied():
        assert re.search(
            r"No .* (is|are) stored",
            draw({"stages": [], "cost": None}).texts[0].get_text(),
        )


# -- measurement sheet -----------------------------------------------------------------


def _rows(count: int, setup: str) -> list[dict[str, Any]]:
    return [
        {
            "setup": setup,
            "run": "1",
            "order": k,
            "command": {"z_mm": 0.5 * k, "psi_deg": 3.0 * k},
            "reading": {},
        }
        for k in range(count)
    ]


def _printed(told: dict[str, Any]) -> dict[str, list[list[str]]]:
    """Rows of each set-up in reading order, blocks one after another."""
    return {
        t["setup"]: [row for block in t["blocks"] for row in block]
        for s in told["stages"]
        for t in s["tables"]
    }


def test_the_sheet_holds_every_pose_once_in_order() -> None:
    result = report_fixture_plan.sample()
    poses = result["design"]["poses"]
    printed = _printed(sheets.sheet(result, poses))
    for setup in ("short tool", "long tool"):
        mine = [p["command"] for p in poses if p["setup"] == setup]
        rows = printed[setup]
        assert [row[0] for row in rows] == [str(k) for k in range(1, len(mine) + 1)]
        numbers = np.array([[float(cell) for cell in row[1:4]] for row in rows])
        np.testing.assert_allclose(
            numbers, [list(c.values()) for c in mine], atol=5.1e-4
        )
        assert {row[-1] for row in rows} == {""}
    assert printed["tracker"] == []


@pytest.mark.parametrize("counts", [(1, 0), (70, 50), (100, 40), (300, 5)])
def test_a_long_sheet_is_cut_and_says_so(
    counts: tuple[int, int], tmp_path: Path
) -> None:
    poses = _rows(counts[0], "short tool") + _rows(counts[1], "long tool")
    result = report_fixture_plan.sample()
    told = sheets.sheet(result, poses)
    printed = sum(map(len, _printed(told).values()))
    assert printed == min(sum(counts), sheets.MOST)
    left = [
        t["more"]
        for s in told["stages"]
        for t in s["tables"]
        if "see poses.csv" in t["more"]
    ]
    said = sum(
        int(found.group())
        for found in (re.match(r"\d+", text) for text in left)
        if found
    )
    assert said == sum(counts) - printed
    pages = write_sheet(result, poses, tmp_path / "new").read_bytes()
    assert _pages(pages) == 1


def _pages(data: bytes) -> int:
    """Pages of a PDF, by the page tree's count."""
    return max(int(n) for n in re.findall(rb"/Count (\d+)", io.BytesIO(data).read()))


def test_the_sheet_is_the_same_each_time_and_needs_poses(tmp_path: Path) -> None:
    result = report_fixture_plan.sample()
    one = write_sheet(result, None, tmp_path / "a").read_bytes()
    assert (
        one
        == write_sheet(result, result["design"]["poses"], tmp_path / "b").read_bytes()
    )
    with pytest.raises(ValueError, match="needs poses"):
        write_sheet(report_fixture.bare(), None, tmp_path)
