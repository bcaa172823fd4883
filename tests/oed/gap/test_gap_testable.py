"""Which effects readings can test: those whose usual sizes show, not expected ones alone."""

import numpy as np
import pandas as pd
import pytest
from shipped_models import encoder_scale, planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.gap import GapProblem, prepare
from oed.gap.forms import library
from oed.measurement import draw_parameters, draw_readings

effect = encoder_scale.effect
position = pose_tracker.position
machine = planar_2dof.machine


def problem(noise: float) -> GapProblem:
    sigma = np.full(3, noise)
    measurement = Measurement(machine, [mount(position, "tracker", sigma=sigma)])
    y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    rng = np.random.default_rng(1)
    truth = draw_parameters(measurement, rng)
    readings = draw_readings(measurement, [series], truth, rng)
    covariates = pd.DataFrame(
        {"setup": "tracker", "run": "1", "order": np.arange(25), "direction": 1}
    )
    return prepare(measurement, [series], readings, covariates)


@pytest.mark.parametrize(("norm", "tested"), [(3.0, True), (0.1, True), (0.003, False)])
def test_an_effect_is_tested_where_its_usual_sizes_show(norm, tested):
    """By the norm over all readings of what it changes at its expected size."""
    quiet = problem(1e-6)
    (constants,) = effect.constant_grid()
    columns = quiet.signature(effect, constants).columns
    noise = float(np.linalg.norm(columns)) / norm
    built = library.build(problem(noise), [effect])
    assert (effect.name not in built.not_testable) == tested
