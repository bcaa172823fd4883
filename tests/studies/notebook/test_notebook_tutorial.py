"""Figures of a notebook show what the sections say."""

import numpy as np
import pytest
import report_fixture
import report_fixture_plan
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from report_fixture import result_of

from oed.result import DesignSection
from pkm_studies.notebook import axes


def _drawn(draw, *sections) -> Axes:
    figure = Figure().subplots()
    draw(*sections, figure)
    return figure


def test_other_sections_are_drawn_too():
    full = result_of(report_fixture.sample())
    dots = np.vstack(
        [line.get_xydata() for line in _drawn(axes.design, full.design).lines[1::2]]
    )
    assert len(dots) == len(full.design.poses)
    residuals = _drawn(axes.residuals, full.estimate).lines[0].get_ydata()
    np.testing.assert_array_equal(residuals, full.estimate.residuals)
    bars = _drawn(axes.accuracy, full.prediction).containers[1]
    after = [c.after.rms for c in full.prediction.components.values()]
    assert [bar.get_height() for bar in bars] == after
    drawn = _drawn(axes.posterior, full.posterior, full.estimate.parameters)
    name = drawn.get_yticklabels()[0].get_text()
    marginal, p = full.posterior.marginals[name], full.estimate.parameters[name]
    low, high = drawn.lines[0].get_xdata()
    assert low * p.prior_sd + p.nominal == pytest.approx(marginal.q025)
    assert high * p.prior_sd + p.nominal == pytest.approx(marginal.q975)
    plan = result_of(report_fixture.bare() | {"plan": report_fixture_plan.plan()}).plan
    shares = _drawn(axes.stages, plan).lines[0].get_ydata()
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
        _drawn(axes.design, empty)
