"""Mistakes that no check can see: they turn a machine of the model into another one."""

import blunder_machines as machines
import numpy as np
import pytest

from oed.checks import judgement
from oed.estimation import identify


def test_check_and_fit_judge_by_one_noise_law():
    """Of readings with run offsets: scale of single readings, error of a run."""
    one = machines.session("delta", machines.readings("delta", 3, "run offsets"))
    search = judgement.find_outliers(one, np.zeros(0, dtype=np.intp))
    law, _ = judgement.estimated_law(search.solution)
    estimate = identify(one.measurement, one.series, one.y, estimate_noise=True)
    posterior = estimate.noise_posterior
    fitted = posterior.prior.laws(posterior.mode[None])
    scales = [law.scale[name] for name in posterior.structure.names]
    assert scales == pytest.approx(fitted.scale[0].tolist(), rel=0.1)
    assert law.law.level[0] == pytest.approx(fitted.level[0], rel=0.2)
    assert fitted.level[0] > 0.9


def test_no_sign_is_lost_where_none_is_known():
    """Heights of a nominal machine are zero: its noise does not tell their sign."""
    rows = machines.readings("delta", 0)
    probe = rows["setup"] == "probe"
    rows.loc[probe, "height_mm"] = rows.loc[probe, "height_mm"].abs().round(0)
    checked = machines.check("delta", rows)
    assert all("is lost" not in one.what for one in checked.explanations)
