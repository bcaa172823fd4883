"""The tutorial for notebooks runs as written, and its figures show what the sections say."""

import re
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
import report_fixture
import report_fixture_plan
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from report_fixture import result_of

from oed.result import DesignSection
from pkm_studies.notebook import axes

PAGE = Path(__file__).resolve().parents[3] / "docs" / "tutorial_notebook.md"


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """What the cells of the page leave behind."""
    matplotlib.use("agg")
    folder = tmp_path_factory.mktemp("notebook")
    cells = re.findall(
        r"^```python\n(.*?)^```$", PAGE.read_text("utf-8"), re.DOTALL | re.MULTILINE
    )
    assert len(cells) == 6
    cell_names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for cell in cells:
            exec(compile(cell, PAGE.name, "exec"), cell_names)
    assert (folder / "both.png").read_bytes().startswith(b"\x89PNG")
    yield cell_names
    matplotlib.pyplot.close("all")


@pytest.mark.slow
def test_the_design_is_drawn_over_its_commands(names):
    drawn = names["design"].plot(_new_axes())
    poses = names["design"].section.poses
    dots = np.vstack([line.get_xydata() for line in drawn.lines[1::2]])
    expected = [[pose.command["psi_deg"], pose.command["theta_deg"]] for pose in poses]
    assert len(dots) == len(poses)
    assert {drawn.get_xlabel(), drawn.get_ylabel()} <= {
        "z [mm]",
        "psi [°]",
        "theta [°]",
    }
    assert sorted(dots[:, 0]) in (
        sorted(v[0] for v in expected),
        sorted(v[1] for v in expected),
    )


@pytest.mark.slow
def test_residuals_and_bars_are_those_of_the_sections(names):
    drawn = names["estimate"].plot(_new_axes())
    np.testing.assert_array_equal(
        drawn.lines[0].get_ydata(), names["estimate"].section.residuals
    )
    bars = names["accuracy"].plot(_new_axes()).containers[1]
    after = [c.after.rms for c in names["accuracy"].section.components.values()]
    assert [bar.get_height() for bar in bars] == after


def _new_axes() -> Axes:
    return Figure().subplots()


def test_other_sections_are_drawn_too():
    full = result_of(report_fixture.sample())
    drawn = axes.posterior(full.posterior, full.estimate.parameters, _new_axes())
    name = drawn.get_yticklabels()[0].get_text()
    marginal, p = full.posterior.marginals[name], full.estimate.parameters[name]
    low, high = drawn.lines[0].get_xdata()
    assert low * p.prior_sd + p.nominal == pytest.approx(marginal.q025)
    assert high * p.prior_sd + p.nominal == pytest.approx(marginal.q975)
    plan = result_of(report_fixture.bare() | {"plan": report_fixture_plan.plan()}).plan
    shares = axes.stages(plan, _new_axes()).lines[0].get_ydata()
    key = next(iter(plan.start_accuracy))
    assert shares[0] == 1.0
    assert shares[-1] * plan.start_accuracy[key] == pytest.approx(
        plan.stages[-1].accuracy[key]
    )


def test_what_cannot_be_drawn_says_why():
    design = result_of(report_fixture.sample()).design
    assert isinstance(design, DesignSection)
    import msgspec

    empty = msgspec.structs.replace(design, poses=[])
    with pytest.raises(ValueError, match="no commands"):
        axes.design(empty, _new_axes())
