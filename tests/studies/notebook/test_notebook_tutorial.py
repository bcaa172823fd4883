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


def _new_axes() -> Axes:
    return Figure().subplots()


def test_other_sections_are_drawn_too():
    full = result_of(report_fixture.sample())
    dots = np.vstack(
        [
            line.get_xydata()
            for line in axes.design(full.design, _new_axes()).lines[1::2]
        ]
    )
    assert len(dots) == len(full.design.poses)
    residuals = axes.residuals(full.estimate, _new_axes()).lines[0].get_ydata()
    np.testing.assert_array_equal(residuals, full.estimate.residuals)
    bars = axes.accuracy(full.prediction, _new_axes()).containers[1]
    after = [c.after.rms for c in full.prediction.components.values()]
    assert [bar.get_height() for bar in bars] == after
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
