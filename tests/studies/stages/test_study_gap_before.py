"""What planned readings could find: the section, its files, its chapter, refusals."""

import io
import json
import re
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
import sample
from matplotlib.backends.backend_agg import FigureCanvasAgg
from msgspec.structs import replace
from sample import changed, table_lines
from shipped_models import encoder_scale, gravity

from kernel.laws import STATED_LAW
from oed import dataset
from oed.gap import detect
from oed.gap.before import choose
from oed.result import DetectabilityTable
from pkm_reports import sections, style
from pkm_reports.sections import gap_before
from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.resolve import resolve

HERE = Path("before.study.toml")
HEAD = sample.STUDY.partition("[design]")[0]
STUDY = (
    HEAD.replace('"small"', '"before"\nseed = 5')
    + """
[[design.reference]]
name = "published"
setup = "cup"
z_mm = [1146.0, 1266.0]
psi_deg = { from = 0.0, to = 360.0, count = 12, endpoint = false }
theta = "hold"
runs_by = "z"

[[design.reference]]
name = "circles"
setup = "cup"
z_mm = [1066.0, 1166.0, 1226.0, 1266.0]
psi_deg = { from = 0.0, to = 360.0, count = 12, endpoint = false }
theta = "hold"
runs_by = "z"

[gap]
effects = ["gravity", "encoder_scale", "backlash"]

[gap.design]
find = ["gravity", "encoder_scale"]
candidates = ["circles"]
conditions = [{ payload_N = 0, direction = 1 }, { payload_N = 200, direction = -1 }]
runs = 4

[report]
html = false
pdf = false
"""
)


@pytest.fixture(scope="module")
def ran(tmp_path_factory: pytest.TempPathFactory) -> tuple[dict[str, Any], Path]:
    """The study's result as stored, and its folder."""
    out = tmp_path_factory.mktemp("before")
    stages.run_study(study.Study.parse(STUDY, HERE), out, report=False)
    return json.loads((out / "result.json").read_text()), out


def test_chosen_runs_separate_what_the_published_ones_cannot(ran):
    chosen = ran[0]["gap_before"]["chosen"]
    assert chosen["candidates"] == 8
    assert len(chosen["runs"]) == 4
    assert {r["condition"]["payload"] for r in chosen["runs"]} == {0.0, 200.0}
    by_pair = {(t["effect"], t["words"]): t for t in chosen["told"]}
    assert by_pair["gravity", "drives"]["before"] < 3.0
    assert by_pair["gravity", "drives"]["apart"] > 29.0
    assert chosen["proven"]
    assert chosen["apart"] == min(t["apart"] for t in chosen["told"])
    assert chosen["apart"] <= chosen["bound"] * (1 + 1e-9)
    assert "4 of 8 candidate runs" in ran[0]["headline"][0]


def test_the_table_is_the_kernels(ran):
    table = ran[0]["gap_before"]["table"]
    resolved = resolve(study.Study.parse(STUDY, HERE))
    published = resolved.reference_plans[0].series[0]
    candidates = [
        choose.Run(
            name=str(r),
            setup="cup",
            command=published.reading_commands()[published.run == r],
            condition={},
        )
        for r in dict.fromkeys(published.run)
    ]
    problem, _ = choose.problem_of_runs(resolved.measurement, candidates)
    effects = [gravity.effect, encoder_scale.effect]
    detection = detect(problem, STATED_LAW, effects, np.random.default_rng(0))
    np.testing.assert_allclose(
        table["apart"], detection.separation, rtol=1e-6, atol=1e-8
    )
    rows = {e["name"]: e for e in table["effects"]}
    of_gravity = detection.effects[0]
    assert of_gravity.name == "gravity"
    assert rows["gravity"]["detectability"] == pytest.approx(of_gravity.detectability)
    assert rows["gravity"]["signature"] == pytest.approx(of_gravity.signature)
    squares = [
        np.sum(problem.signature(gravity.effect, constants).columns ** 2)
        for constants in gravity.effect.constant_grid()
    ]
    rms_um = 1e6 * np.sqrt(np.mean(squares) / len(problem))
    assert rows["gravity"]["signature"]["length"] == pytest.approx(rms_um)
    assert "direction" in rows["backlash"]["not_testable"]


def test_poses_of_the_chosen_runs_can_be_filled_in_and_read(ran, tmp_path):
    text = (ran[1] / "gap_poses.csv").read_text()
    lines = table_lines(text)
    header = lines[0].split(",")
    assert {"payload_N", "direction", "time_s", "length_mm"} <= set(header)
    filled = [line + "300.0" for line in lines[1:]]
    path = tmp_path / "filled.readings.csv"
    path.write_text("\n".join([",".join(header), *filled]) + "\n")
    measurement = resolve(study.Study.parse(STUDY, HERE)).measurement
    data = dataset.load([path], measurement)
    assert len(data) == 48
    assert set(data.covariates["payload"]) == {0.0, 200.0}
    # direction -1 is the same circle in reverse
    backward = data.covariates["direction"].to_numpy() == -1.0
    psi = data.series[0].reading_commands()[backward][:12, 1]
    assert (np.diff(psi) < 0).sum() >= 10


def test_a_retained_plan_is_part_of_the_choice():
    changes = (
        ('candidates = ["circles"]', 'candidates = ["circles"]\nkeep = "published"'),
        ("runs = 4", "runs = 2"),
    )
    request = resolve(study.Study.parse(changed(STUDY, *changes), HERE)).gap_design
    assert len(request.retained) == 2
    assert len(request.runs) == 10
    assert request.rules.setups.mounted == (0,)


def test_runs_at_stated_times_do_not_overlap(tmp_path):
    times = (
        "conditions = [{ payload_N = 0, start_min = 0 }, { payload_N = 200, start_min ="
        " 0.5 }, { start_min = 9 }]"
    )
    text = re.sub(r"conditions = .*", times, STUDY).replace("runs = 4", "runs = 2")
    result = stages.run_study(study.Study.parse(text, HERE), tmp_path, report=False)
    begin = sorted(r.condition["time"] for r in result.gap_before.chosen.runs)
    assert begin[1] - begin[0] >= 72.0  # a circle of 12 readings takes 6 s each


@pytest.mark.parametrize(("old", "new", "words"), [
    ('find = ["gravity", "encoder_scale"]', 'find = ["gravity"]', "nothing to tell apart"),
    ('find = ["gravity", "encoder_scale"]', 'find = ["gravity", "rust"]', 'gap.design.find[2] = "rust"'),
    ('find = ["gravity", "encoder_scale"]', 'find = ["gravity", "guideway"]', "cannot occur on a3_head"),
    ('candidates = ["circles"]', 'candidates = ["circle"]', "did you mean circles?"),
    ("runs = 4", "runs = 40", "there are only 8 candidate runs"),
    ("runs = 4", "share = 0.2", "how many runs"),
    ("payload_N = 200, direction = -1", "payload_N = 200, start_min = 3", "some runs have a time"),
])  # fmt: skip
def test_what_cannot_be_done_is_refused_before_anything_runs(old, new, words):
    with pytest.raises(InputError, match=re.escape(words)):
        resolve(study.Study.parse(changed(STUDY, (old, new)), HERE))


def test_effects_that_no_candidate_can_test_are_refused(tmp_path):
    text = STUDY.replace(
        'find = ["gravity", "encoder_scale"]', 'find = ["gravity", "servo_lag"]'
    )
    path = tmp_path / "before.study.toml"
    path.write_text(text)
    with pytest.raises(
        InputError, match="servo_lag cannot be tested by these candidates"
    ):
        stages.run_study(study.Study.load(path), tmp_path / "out", report=False)


def test_the_chapter_states_runs_pairs_and_sizes(ran):
    raw = report_fixture.bare() | {"gap_before": ran[0]["gap_before"]}
    result = report_fixture.result_of(raw)
    assert "gap-before" in [c.anchor for c in sections.chapters(result)]
    shown = report_fixture.shown_text(result)
    assert "What these readings could detect" in shown
    for run in ran[0]["gap_before"]["chosen"]["runs"]:
        assert run["run"] in shown
    assert "4 runs chosen out of 8" in shown
    assert "All plans were tried: none is better." in shown
    assert "Backlash: the readings do not have direction: both." in shown


def test_the_matrix_shows_every_pair_and_stays_within_its_frame(ran):
    stored = ran[0]["gap_before"]["chosen"]["table"]
    table = msgspec.convert(stored, DetectabilityTable)
    with style.applied():
        figure = gap_before.draw_confusable(table)
        FigureCanvasAgg(figure).print_png(io.BytesIO())
        texts = [t.get_text() for t in figure.axes[0].texts]
        assert texts == [
            gap_before.short_label(v) for row in table.separation for v in row
        ]
        box = figure.bbox
        for label in (
            *figure.axes[0].get_xticklabels(),
            *figure.axes[0].get_yticklabels(),
        ):
            extent = label.get_window_extent()
            assert extent.x0 >= box.x0 - 1
            assert extent.x1 <= box.x1 + 1
            assert extent.y1 <= box.y1 + 1
        single = replace(table, names=["gravity"], separation=[[3.0]])
        assert gap_before.draw_confusable(single).axes == []
