"""Assessments of small plans against covariances written out and known lost directions."""

import dataclasses

import numpy as np
import pytest
from shipped_models import a3_head, ball_bar, calliper, height_probe, linear_delta

from oed import identifiability
from oed.identifiability import (
    Assessment,
    column_scale,
    combination_text,
    explain,
    parameter_covariance,
    posterior_covariance,
    prior_information,
    recoveries,
)
from oed.identifiability.assessment import free_parameters
from oed.instrument import mount
from oed.measurement import Measurement, Series
from oed.model import CommonTolerance

GRID = np.linspace(-0.06, 0.06, 4)
POINTS = np.array([[x, y, 0.0] for x in GRID for y in GRID])


@pytest.fixture(scope="module")
def delta() -> Measurement:
    setups = [
        mount(height_probe.instrument, "probe"),
        mount(calliper.instrument, "calliper"),
    ]
    return Measurement(linear_delta.machine, setups)


@pytest.fixture(scope="module")
def heights(delta: Measurement) -> list[Series]:
    return [delta.series("probe", POINTS)]


@pytest.fixture(scope="module")
def assessment(delta: Measurement, heights: list[Series]) -> Assessment:
    return Assessment.of(delta, heights)


def test_covariances_are_inverses_of_prior_and_information(delta, heights):
    slopes, noise = delta.jacobian(heights, delta.nominal), delta.sigma(heights)
    white = slopes * delta.tolerance / noise[:, None]
    scaled = identifiability.scaled(delta, heights, delta.nominal, "tolerance")
    np.testing.assert_allclose(scaled, white, rtol=1e-9, atol=1e-12)
    whole = np.linalg.inv(np.eye(white.shape[1]) + white.T @ white)
    told = posterior_covariance(scaled)
    np.testing.assert_allclose(told, whole, atol=1e-9)
    in_si = parameter_covariance(delta, heights, delta.nominal)
    outer = np.outer(delta.tolerance, delta.tolerance)
    np.testing.assert_allclose(in_si, whole * outer, atol=1e-9 * outer.max())


def test_each_scaling_has_its_units(delta, heights):
    slopes = delta.jacobian(heights, delta.nominal)
    angles = np.array([p.unit == "rad" for p in delta.parameters])
    lengths = np.where(angles, 1.0 / delta.machine.lever, 1.0)
    for scaling, factor in (("si", 1.0), ("length", lengths)):
        told = identifiability.scaled(delta, heights, delta.nominal, scaling)
        np.testing.assert_allclose(told, slopes * factor, rtol=1e-12)
    with pytest.raises(ValueError, match="scaling 'mm' is none of"):
        column_scale(delta, "mm")  # type: ignore[arg-type]


def test_a_common_cause_is_in_the_prior_information(delta):
    assert (prior_information(delta) == np.eye(delta.free.sum())).all()
    names = tuple(
        p.name for p in linear_delta.machine.parameters if "endstop" in p.name
    )
    machine = dataclasses.replace(
        linear_delta.machine, correlated=(CommonTolerance(names[:2], 0.5),)
    )
    matrix = prior_information(Measurement(machine, []))
    assert np.sort(np.linalg.eigvalsh(matrix))[[0, -1]] == pytest.approx([1 / 1.5, 2.0])


def test_heights_leave_the_common_size_to_the_calliper(delta, assessment):
    """Of height readings alone some direction is lost; distances recover it."""
    assert len(assessment.names) == len(free_parameters(delta, assessment.series))
    assert not any(name.startswith("calliper") for name in assessment.names)
    lost = len(assessment.names) - assessment.identifiability.rank
    assert lost > 0
    wide = np.array([[0.06, 0.0, 0.0], [-0.06, 0.0, 0.0], [0.0, 0.06, 0.0]])
    both = [*assessment.series, delta.series("calliper", wide)]
    together = Assessment.of(delta, both)
    recovered = lost - (len(together.names) - together.identifiability.rank)
    alternatives = {"distances": (delta, both[1:])}
    phrases = recoveries(assessment, alternatives)
    of_distances = [p for p in phrases if p.startswith("adding the readings of dist")]
    assert bool(of_distances) == (recovered > 0)
    kinds = [finding.kind for finding in explain(assessment, alternatives)]
    assert "lost" in kinds


def test_a_longer_tool_recovers_what_one_circle_loses():
    bar = mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))
    m = Measurement(a3_head.machine, [bar])
    psi = np.linspace(-3.0, 3.0, 15)
    command = np.column_stack([np.full(15, 1.15), psi, np.full(15, 0.4)])
    one = Assessment.of(m, [m.series("cup", command)])
    (phrase,) = [p for p in recoveries(one, {}) if p.startswith("a second tool")]
    assert phrase.startswith("a second tool, 100 mm longer, in a set-up of its own")
    lost = len(one.names) - one.identifiability.rank
    assert phrase.endswith((f"of {lost} lost directions", "all lost directions"))


def test_a_combination_begins_with_its_pivot():
    terms = {"z1": 0.2791, "beta1": 1.0, "q": -2.0}
    units = {"z1": "m", "beta1": "rad", "q": "rad"}
    assert combination_text(terms, units) == "beta1 + 0.279 rad/m z1 - 2 q"
