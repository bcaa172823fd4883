"""Residuals of a diagnosis laid out run by run, and over places of the tool."""

import math
from pathlib import Path

import gap_fixture
import numpy as np
import pytest

from oed.gap import Diagnosis
from pkm_studies.stages.fit import run_curves


def _diagnosed(tmp_path: Path) -> Diagnosis:
    return gap_fixture.diagnosis(gap_fixture.problem(gap_fixture.written(tmp_path)))


def test_traces_are_circles_both_ways(tmp_path):
    diagnosis = _diagnosed(tmp_path)
    traces = run_curves.traces(diagnosis)
    assert [t.kind for t in traces] == ["circle"] * 4
    assert [t.base for t in traces] == ["z=1146mm"] * 2 + ["z=1206mm"] * 2
    assert [t.direction for t in traces] == [1, -1, 1, -1]
    # the tool stands on a sphere of 300 mm about the cup, and the circle's height tells
    # its radius
    assert traces[0].radius_mm == pytest.approx(
        math.sqrt(300.0**2 - 138.0**2), abs=15.0
    )
    assert all(np.diff(t.at).min() > 0.0 for t in traces)
    every = np.concatenate([t.before for t in traces])
    assert np.sqrt(np.mean(every**2)) == pytest.approx(
        1e6 * np.sqrt(np.mean(diagnosis.before**2)), rel=1e-4
    )
    explained = np.concatenate([t.explained for t in traces])
    change = every - np.concatenate([t.after for t in traces])
    np.testing.assert_allclose(explained, change, atol=3e-4)


@pytest.mark.parametrize(("points", "kind"), [
    ([[0.1 * k, 0.05 * k, 1.0] for k in range(8)], "line"),
    ([[math.cos(0.7 * k), math.sin(0.7 * k), 0.2] for k in range(9)], "circle"),
    ([[(k * 37 % 11) * 0.1, (k * 23 % 7) * 0.1, 0.0] for k in range(20)], "points"),
    ([[0.0, 0.0, 0.0]] * 6, "points"),
    ([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]], "points"),
])  # fmt: skip
def test_the_shape_of_a_run(points, kind):
    shape, at, radius = run_curves.run_shape(np.array(points), np.zeros(len(points)))
    assert shape == kind
    assert (radius is None) == (kind != "circle")
    if kind == "circle":
        assert radius == pytest.approx(1.0)
    if kind == "line":
        np.testing.assert_allclose(np.diff(at), 1e3 * math.hypot(0.1, 0.05))


def test_places_of_the_tool_gather_their_readings(tmp_path):
    diagnosis = _diagnosed(tmp_path)
    spots, unit = run_curves.spots(diagnosis)
    assert unit == "um"
    assert len(spots) == 48  # both ways at 24 poses of two circles
    total = sum(2.0 * s.before**2 for s in spots)
    assert total == pytest.approx(1e12 * float(np.sum(diagnosis.before**2)), rel=1e-3)
