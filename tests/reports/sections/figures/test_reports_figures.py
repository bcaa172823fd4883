"""Figures: those without data say so, all words stay inside, and many marks become pixels."""

import re
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
import report_fixture
from matplotlib.figure import Figure
from report_fixture import check_inside, result_of

from oed.result import Drawing
from pkm_reports import style
from pkm_reports.page import Document
from pkm_reports.sections import (
    acceptance,
    accuracy,
    criteria,
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
