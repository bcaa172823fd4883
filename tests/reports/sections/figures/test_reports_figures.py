"""Figures and the chapters about the design: complete, also where parts or data are missing."""

import itertools
import re
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
from matplotlib.figure import Figure
from report_fixture import check_inside, result_of, shown_text

from oed.base import Array
from oed.design import CRITERIA, Criterion
from oed.result import (
    CriterionComparison,
    Drawing,
    PlannedReading,
    RobustSummary,
    StudyResult,
)
from pkm_reports import style
from pkm_reports.page import Document
from pkm_reports.sections import (
    acceptance,
    accuracy,
    criteria,
    design,
    identifiability,
    identification,
    machine_figures,
    plan,
)
from pkm_reports.sections import design as design_chapter
from pkm_reports.sections import posterior as corner

pytestmark = pytest.mark.pictures


def _empty_figures() -> list[Callable[[], Figure]]:
    """Each figure, drawn of a section that holds no data for it."""
    full = result_of(report_fixture.sample())
    design, estimate = full.design, full.estimate
    posterior, prediction = full.posterior, full.prediction
    section = full.identifiability
    assert estimate is not None
    assert posterior is not None
    assert section is not None
    assert design.robust is not None
    assert design.how_many is not None
    replace = msgspec.structs.replace
    no_value = replace(full.kappa_maps[0], kappa=[[None] * 16] * 3)
    no_direction = replace(section, singular_values=[], rank=0, n=0)
    no_residual = replace(estimate, residuals=[], residuals_before=[])
    no_draw = replace(posterior, directions=[], corner=[])
    no_component = replace(prediction, components={})
    no_budget = replace(prediction.components["x"], budget={})
    no_place = replace(prediction, components={}, map=[])
    no_reading = replace(full.held_out[0], residuals=[])
    no_criterion = replace(design, compared=[])
    no_prediction = replace(design.plans[0], predicted={})
    no_command = replace(design.poses[0], command={})
    no_scenario = replace(design.robust, values=[None], nominal_values=[])
    no_size = replace(design.how_many, sizes=[10, 20], accuracy={"z_um": [None, None]})
    return [
        lambda: machine_figures.draw_machine(Drawing([], [], [], [])),
        lambda: identifiability.draw_kappa([no_value]),
        lambda: identifiability.draw_singular_values(no_direction),
        lambda: identification.draw_parameters({}),
        lambda: identification.draw_residuals(no_residual),
        lambda: corner.draw_corner(no_draw),
        lambda: accuracy.draw_components(no_component),
        lambda: accuracy.draw_budget({"x": no_budget}),
        lambda: accuracy.draw_workspace(no_place),
        lambda: acceptance.draw_residuals([no_reading]),
        lambda: criteria.draw_efficiencies(no_criterion),
        lambda: design_chapter.draw_predicted([no_prediction]),
        lambda: plan.draw_path([no_command]),
        lambda: design_chapter.draw_robust(no_scenario),
        lambda: design_chapter.draw_how_many(no_size),
    ]


@pytest.mark.parametrize("number", [1, 2, 3, 5])
def test_each_map_and_each_set_of_held_out_readings_has_a_panel(number):
    full = result_of(report_fixture.sample())
    maps, held_out = full.kappa_maps[:1] * number, full.held_out[:1] * number
    with style.applied():
        kappa = identifiability.draw_kappa(maps)
        residuals = acceptance.draw_residuals(held_out)
    for figure in (kappa, residuals):
        assert sum(axes.get_visible() for axes in figure.axes) == number


def test_a_condition_number_is_of_determined_directions():
    section = result_of(report_fixture.sample()).identifiability
    some = msgspec.structs.replace(section, singular_values=[8.0, 2.0, 0.0], rank=2)
    assert identifiability.condition(some) == 4.0


@pytest.mark.parametrize("draw", _empty_figures())
def test_a_figure_without_data_says_so(draw):
    with style.applied():
        figure = draw()
        assert not figure.axes
        assert re.search(r"No .* (is|are) stored", figure.texts[0].get_text())
        assert style.render(figure).kind == "svg"


def test_figures_keep_all_words_inside():
    full = result_of(report_fixture.sample())
    design, prediction = full.design, full.prediction
    assert design is not None
    assert prediction is not None
    with style.applied():
        for figure in (
            machine_figures.draw_machine(full.drawing),
            identifiability.draw_singular_values(full.identifiability),
            identification.draw_parameters(full.estimate.parameters),
            accuracy.draw_components(prediction),
            accuracy.draw_budget(prediction.components),
            accuracy.draw_workspace(prediction),
            criteria.draw_efficiencies(design),
            design_chapter.draw_predicted(design.plans),
            plan.draw_path(design.poses),
            design_chapter.draw_robust(design.robust),
            design_chapter.draw_how_many(design.how_many),
        ):
            check_inside(figure)


@pytest.mark.parametrize("names", [("z_mm", "a_deg"), ("z_mm",)])
def test_a_plan_of_other_machines_is_drawn(names):
    raw = report_fixture.delta()
    raw["prediction"] |= {
        "components": {"z": raw["prediction"]["components"]["z"]},
        "map": [
            {
                "command": {name: float(k) for name in names},
                "before": {"z": 1.0},
                "after": {"z": 0.1 * k},
            }
            for k in range(5)
        ],
    }
    prediction = result_of(raw).prediction
    assert prediction is not None
    with style.applied():
        assert accuracy.draw_workspace(prediction).axes


def test_a_figure_of_many_marks_becomes_pixels():
    raw = report_fixture.bare()
    values = [float(k % 17) for k in range(6000)]
    raw["estimate"] = report_fixture.sample()["estimate"] | {
        "residuals": values,
        "residuals_before": values,
        "channels": ["length"] * 6000,
    }
    report = Document.from_result(result_of(raw))
    assert b"data:image/png" in report.html()
    assert report.images["residuals"].kind == "png"
    assert report.pdf().startswith(b"%PDF")


def test_a_figure_placed_by_hand_becomes_pixels_without_a_warning(monkeypatch):
    monkeypatch.setattr(style, "MAX_SVG", 0)
    place = (0.1, 0.1, 0.4, 0.4)
    with style.applied():
        figure = style.placed_figure(2.0)
        axes = figure.add_axes(place)
        image = style.render(figure)
    assert image.kind == "png"
    assert axes.get_position().bounds == pytest.approx(place)


def test_the_bars_of_a_component_stand_about_its_place():
    prediction = result_of(report_fixture.sample()).prediction
    assert prediction is not None
    for axes in accuracy.draw_components(prediction).axes:
        count = len({bar.get_facecolor() for bar in axes.patches})
        centres = [bar.get_x() + bar.get_width() / 2.0 for bar in axes.patches]
        middles = np.reshape(centres, (count, -1)).mean(axis=0)
        assert middles == pytest.approx(np.arange(len(middles)))


#: keys that results of the first version lack
NEWER = [
    "words", "directions", "columns", "gap", "proven", "compound", "setups", "kept",
    "cost_min", "refused", "compared", "polished", "order", "robust", "how_many",
]  # fmt: skip
OPTIONAL = [*NEWER, "bound", "efficiency", "plans", "poses"]
#: keys that may be null
NULLABLE = [
    "bound", "efficiency", "gap", "cost_min", "polished", "order", "robust", "how_many",
]  # fmt: skip


def _with_design(design: dict[str, Any]) -> StudyResult:
    """A result that holds nothing but the machine and a design."""
    return result_of(report_fixture.bare() | {"design": design})


def _design() -> dict[str, Any]:
    design: dict[str, Any] = report_fixture.sample()["design"]
    return design


def _design_without(names: list[str]) -> dict[str, Any]:
    design = _design()
    for name in names:
        del design[name]
    return design


def _each_and_all(names: list[str]) -> list[list[str]]:
    """Each of the names alone, then all of them."""
    return [*[[name] for name in names], names]


def test_the_certificate_and_its_numbers_are_reported():
    shown = shown_text(result_of(report_fixture.sample()))
    for words in (
        _design()["words"],
        "−58.20: no choice is larger",
        "at least 97.3 % of the best possible",
        "18 of 21",
        "30, of which 4 belong to the earlier plan",
        "33 min for mounting and reading",
        "67 % D and 33 % I",
        "short tool: 15 readings, no. 1 to 15",
        "travel for 95.6 s, 24 % less than the 126 s",
        (
            "3 thermal reference readings are put between. Mounting, travel and"
            " readings take 36.4 min"
        ),
        "brings criterion D from −58.91 to −58.68: polishing gained 0.01278",
        "at x 103.27 mm, at z 1281.5 mm",
        "the mean of the worst 20 % of 20 scenarios",
        (
            "Wanted: z 50 µm, theta 1.2 arcsec. 34 readings reach it; no plan of fewer"
            " than 33 can."
        ),
    ):
        assert words in shown, words
    assert "more are in the table only" not in shown  # two plans, of 8 in the figure


@pytest.mark.parametrize("names", _each_and_all(OPTIONAL))
def test_each_part_of_the_design_may_be_absent(names):
    _check_texts(_with_design(_design_without(names)))


@pytest.mark.parametrize("names", _each_and_all(NULLABLE))
def test_parts_of_the_design_may_be_null(names):
    _check_texts(_with_design(_design() | dict.fromkeys(names)))


def _check_texts(result: StudyResult) -> None:
    """Texts and captions hold no number that is none; figures are not drawn."""
    blocks = repr([*plan.blocks(result), *design.blocks(result)])
    assert not {"nan", "None"} & set(re.findall(r"\w+", blocks))


def test_a_design_without_optional_parts_has_its_page():
    result = _with_design(_design_without(OPTIONAL))
    assert "How good" in shown_text(result)


def test_numbers_that_were_not_finite_leave_gaps():
    design = _design()
    design["compared"][1]["values"] = {"D": None, "E": 3.0e-6, "kappa": None}
    del design["plans"][1]["predicted"]["z_um"]
    design["robust"]["values"][0] = None
    design["how_many"]["accuracy"]["z_um"][0] = None
    design["how_many"] |= {"fewest": None, "wanted": {}, "words": ""}
    report = Document.from_result(_with_design(design))
    assert report.pdf().startswith(b"%PDF")


def test_an_old_result_still_has_its_certificate():
    old = _design_without(NEWER)
    sentence = (
        "Certified to 97.3 % of the best possible 30 readings out of 1512 candidates."
    )
    assert sentence in shown_text(_with_design(old))


# -- efficiencies ----------------------------------------------------------------------
def _criteria(main: str, rng: np.random.Generator) -> dict[str, Criterion]:
    """All criteria over four directions, the main one first."""
    ingredients = {
        "interest": np.eye(4)[:, :2],
        "combination": rng.normal(size=(1, 4)),
        "accuracy": rng.normal(size=(5, 2, 4)),
    }
    names = [main, *[name for name in CRITERIA.plan_names if name != main]]
    needs = {name: ingredients.get(CRITERIA[name].needs) for name in names}
    return {name: CRITERIA.build(name, 4, needs[name]) for name in names}


def _comparison(
    k: int, phi: Array, scored: dict[str, Criterion]
) -> CriterionComparison:
    """The k-th criterion's entry, with a bound 0.2 above its own design."""
    name, criterion = list(scored.items())[k]
    numbers = [float(criterion.conventional_value(float(v), 9)) for v in phi[k]]
    return CriterionComparison(
        name=name,
        value=numbers[k],
        bound=float(criterion.conventional_value(float(phi[k, k] + 0.2), 9)),
        efficiency=float(np.exp(-0.2)),
        proven=False,
        gain=float(np.exp(phi[k, k] - phi[k, 0])),
        values=dict(zip(scored, numbers, strict=True)),
    )


@pytest.mark.parametrize("main", ["D", "Ds", "kappa"])
def test_efficiencies_are_ratios_of_phi(main):
    """Against phi itself, of random plans; the report knows only the stored numbers."""
    rng = np.random.default_rng(3)
    rows = rng.normal(size=(13, 9, 4))
    scored = _criteria(main, rng)
    informations = [h.T @ h for h in rows]
    phi = np.array([[c.value(m) for m in informations] for c in scored.values()])
    expected = np.exp(phi - np.diag(phi)[:, None])
    entries = [_comparison(k, phi, scored) for k in range(len(scored))]
    np.testing.assert_allclose(criteria.efficiencies(entries), expected, rtol=1e-9)
    # Proven designs leave only the gain, and for D the directions.
    replace = msgspec.structs.replace
    proven = [replace(entry, bound=entry.value, efficiency=1.0) for entry in entries]
    again = criteria.efficiencies(proven, 4)
    known = slice(0 if main != "Ds" else 1, None)
    np.testing.assert_allclose(again[known], expected[known], rtol=1e-9)


# -- path ------------------------------------------------------------------------------
def _poses(commands: list[dict[str, float]]) -> list[PlannedReading]:
    return [
        PlannedReading("a", "1", k, command, {}) for k, command in enumerate(commands)
    ]


def test_the_path_takes_the_coordinates_that_vary_most():
    # 2000 mm, 18 mm, 5.7 degrees, 20 degrees
    commands = [
        {"a_mm": 1e3 * k, "b_um": 9e3 * k, "c_rad": 0.05 * k, "d_deg": 10.0 * k}
        for k in range(3)
    ]
    plane = plan.choose_plane(_poses(commands))
    assert plane.names == ("a_mm", "d_deg")
    along_b = _poses([{"a_mm": 5.0, "b_mm": 1.0 * k} for k in range(3)])
    single = plan.choose_plane(along_b)
    assert single.names == ("reading", "b_mm")


def test_a_way_over_a_full_turn_is_the_short_one():
    poses = _poses(
        [
            {"z_mm": 0.0, "psi_deg": 350.0},
            {"z_mm": 10.0, "psi_deg": 20.0},
            {"z_mm": 20.0, "psi_deg": 120.0},
        ]
    )
    with style.applied():
        axes = plan.draw_path(poses).axes[0]
    ends = [np.array(line.get_xydata()) for line in axes.lines]
    segments = [points for points in ends if len(points) == 2]
    lengths = [float(np.ptp(points[:, 1])) for points in segments]
    assert lengths == pytest.approx([30.0, 30.0, 100.0])
    low, high = axes.get_ylim()
    assert high - low == pytest.approx(360.0)
    plane = plan.choose_plane(poses)
    assert plane is not None
    assert plan.crosses_edge(plane, ["a", "a", "a"])
    assert not plan.crosses_edge(plane, ["a", "b", "b"])


@pytest.mark.parametrize("count", [12, 90, 400])
def test_numbers_of_the_path_do_not_overlap(count):
    rng = np.random.default_rng(5)
    commands = [
        {"z_mm": float(10 * rng.integers(12)), "psi_deg": float(15 * rng.integers(24))}
        for _ in range(count)
    ]
    with style.applied():
        figure = plan.draw_path(_poses(commands))
        figure.draw_without_rendering()
        notes = figure.axes[0].texts
        patches = [note.get_bbox_patch() for note in notes]
        boxes = [p.get_window_extent() for p in patches if p is not None]
    assert len(boxes) == len(notes) >= 10
    numbers = {number for note in notes for number in note.get_text().split()}
    assert {"1", str(count)} <= numbers
    for a, b in itertools.combinations(boxes, 2):
        apart = a.x0 >= b.x1 or b.x0 >= a.x1
        above = a.y0 >= b.y1 or b.y0 >= a.y1
        assert apart or above


# -- scenarios -------------------------------------------------------------------------
def test_the_figure_shows_the_share_of_scenarios():
    half, quarter = float(np.log(0.5)), float(np.log(0.25))
    summary = RobustSummary(
        risk="worst",
        level=0.0,
        scenarios=2,
        value=half,
        bound=0.0,
        efficiency=1.0,
        nominal=quarter,
        values=[0.0, half],
        nominal_values=[quarter],
    )
    with style.applied():
        axes = design.draw_robust(summary).axes[0]
    steps = {line.get_label(): np.array(line.get_xydata()) for line in axes.lines}
    of_robust = steps["robust plan, each scenario"]
    np.testing.assert_allclose(of_robust, [[50.0, 50.0], [100.0, 100.0]])
    np.testing.assert_allclose(steps["nominal plan, each scenario"], [[25.0, 100.0]])
    np.testing.assert_allclose(steps["robust plan, by the risk"][:, 0], 50.0)


# -- number of readings ----------------------------------------------------------------
def test_a_panel_has_plans_the_bound_and_what_is_wanted():
    """A little wider than the numbers of readings, and a third than the accuracies."""
    summary = result_of(report_fixture.sample()).design.how_many
    number = list(summary.accuracy).index("z_um")
    found, bound = summary.accuracy["z_um"], summary.bound["z_um"]
    with style.applied():
        axes = design.draw_how_many(summary).axes[number]
    assert axes.get_xlim() == pytest.approx((10.0 / 1.08, 60.0 * 1.08))
    limits = (min([*bound, 50.0]) / 1.3, 1.3 * max(found))
    assert axes.get_ylim() == pytest.approx(limits)
    lines = {line.get_label(): line for line in axes.lines}
    expected = np.transpose([summary.sizes, found])
    np.testing.assert_allclose(lines["plans found"].get_xydata(), expected)
    assert set(lines["wanted"].get_ydata()) == {50.0}
    fewest = lines["fewest that reach all wanted: 34"]
    assert set(fewest.get_xdata()) == {34}
