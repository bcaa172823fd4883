"""Columns of effects at their expected sizes: readings and workspace together."""

import numpy as np
import pytest
from shipped_models import backlash, bar_length, encoder_scale, screw_cyclic

from kernel.planar_session import ruler_session
from oed.effects import ExpectedColumns, SessionStates
from oed.effects.columns import VARIANCE_SHARE
from oed.gap import DOWN, GapProblem
from oed.measurement import Measurement

EFFECTS = [e.effect for e in (backlash, encoder_scale, screw_cyclic, bar_length)]


@pytest.fixture(scope="module")
def problem() -> GapProblem:
    return ruler_session(("rm2",), 0.0, 3, interleaved=False)


@pytest.fixture(scope="module")
def columns(problem: GapProblem) -> ExpectedColumns:
    found = ExpectedColumns.of(problem, EFFECTS)
    assert found is not None
    return found


def of_forms(problem: GapProblem, columns: ExpectedColumns) -> np.ndarray:
    """Changes of the readings (N, a) by all coefficients of all forms, SI."""
    parts = []
    for form in columns.forms:
        signature = problem.signature(form.effect, form.constants)
        assert signature.names == form.names
        parts.append(signature.columns)
    return np.hstack(parts)


def test_columns_are_combinations_of_the_signatures(problem, columns):
    combined = of_forms(problem, columns) @ columns.mixing
    scale = np.abs(combined).max()
    assert columns.discrepancy.columns == pytest.approx(combined, abs=1e-9 * scale)


def test_other_readings_of_the_session_change_as_they_would_in_it(problem, columns):
    session = SessionStates(
        problem.measurement, problem.covariates, problem.states, problem.gravity
    )
    changes = columns.changes(problem, session)
    expected = columns.discrepancy.columns
    assert changes == pytest.approx(expected, abs=1e-9 * np.abs(expected).max())


def members_of(columns: ExpectedColumns) -> list[np.ndarray]:
    """Numbers of the coefficients of each group."""
    discrepancy = columns.discrepancy
    groups = range(len(discrepancy.names))
    return [np.flatnonzero(discrepancy.group == g) for g in groups]


def test_few_columns_hold_the_variance_of_a_group(problem, columns):
    discrepancy, every = columns.discrepancy, of_forms(problem, columns)
    number = discrepancy.names.index("screw_cyclic: leg 1")
    members = members_of(columns)[number]
    rows = np.flatnonzero(columns.mixing[:, members].any(axis=1))
    forms = sum(form.effect.name == "screw_cyclic" for form in columns.forms)
    whole = np.sum(every[:, rows] ** 2) / forms
    kept = np.sum(discrepancy.columns[:, members] ** 2)
    assert len(members) < len(rows)
    # what the readings see and what the tool does are kept together
    assert 1.0 - 2.0 * (1.0 - VARIANCE_SHARE) < kept / whole < 1.0 + 1e-9


def test_unknown_effects_are_as_large_as_known_ones(problem, columns):
    white = problem.noise_units(columns.discrepancy.columns)
    members = members_of(columns)
    sizes = np.array([np.sqrt((white[:, m] ** 2).sum(axis=1).mean()) for m in members])
    unknown = columns.discrepancy.unknown
    assert unknown.any()
    typical = float(np.median(sizes[~unknown]))
    assert sizes[unknown] == pytest.approx(typical, rel=0.02)


def test_what_a_machine_cannot_have_is_left_out(columns):
    names = {name.partition(":")[0] for name in columns.discrepancy.names}
    assert {"backlash", "encoder_scale", "screw_cyclic"} <= names
    assert "bar_length" not in names  # no bar in these set-ups


def test_no_effects_give_no_columns(problem):
    assert ExpectedColumns.of(problem, [bar_length.effect]) is None


def test_workspace_maps_are_the_forward_kinematics(problem, columns):
    """Scale errors of both joints: commanded joints, changed, through the closure."""
    measurement: Measurement = problem.measurement
    kinematics = measurement.kinematics
    command = np.array([[-0.9, 0.3], [0.2, 0.9], [1.1, 0.6]])
    session = SessionStates(measurement, problem.covariates, problem.states, DOWN)
    maps = columns.workspace_maps(
        session, measurement.nominal, command, "absolute", np.random.default_rng(1)
    )
    discrepancy = columns.discrepancy
    group = discrepancy.names.index("encoder_scale: leg 1")
    (member,) = members_of(columns)[group]
    amount = columns.mixing[:, member].sum()
    (form,) = [f for f in columns.forms if f.effect.name == "encoder_scale"]
    pose, joints = kinematics.inverse(command)
    state = problem.states[0]
    (column,) = [
        c for c in form.effect.columns(state, **form.constants) if c.name in form.names
    ][:1]
    # the form at the session's joints is linear in the joint
    slope, offset = np.polyfit(state.joints[:, 0], column.joints[0], 1)
    changed = joints.copy()
    changed[:, 0] += (slope * joints[:, 0] + offset) * column.scale * amount
    moved = kinematics.forward(changed, measurement.nominal[:7], pose)
    difference = (
        kinematics.frames(moved, np.zeros(3))[1]
        - kinematics.frames(pose, np.zeros(3))[1]
    )
    assert maps.raw[:, 0, member] == pytest.approx(difference[:, 1], abs=1e-8)
    assert maps.raw[:, 1, member] == pytest.approx(difference[:, 2], abs=1e-8)
