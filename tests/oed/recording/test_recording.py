"""What else to record: moments over courses, errors by dense updates, and the table."""

import design_sample
import numpy as np
import pytest
import sample
from shipped_models import planar_2dof, pose_tracker

from oed import Measurement, mount
from oed.effect_model import Column, Effect
from oed.effects import CourseColumns, ExpectedColumns, SessionStates
from oed.recording import PlannedReadings, relative, remaining_error
from pkm_reports.blocks import Table
from pkm_reports.sections.plan import recording_blocks
from pkm_studies.resolve import GapRequest
from pkm_studies.stages import select_design
from pkm_studies.stages.headline import recording_sentences
from pkm_studies.tables import ConditionsTable

machine = planar_2dof.machine

PLAY = 8e-6
STUDY = """
schema = 1
name = "small_planar"

[machine]
model = "planar_2dof"

[[setup]]
name = "tracker"
instrument = "pose_tracker_position"

[design]
criterion = "I"
readings = 8
scaling = "tolerance"
prior = true
effects = ["backlash", "leg_thermal"]

[[design.candidates]]
setup = "tracker"
y_mm = { from = -1000.0, to = 1000.0, count = 4 }
z_mm = { from = 300.0, to = 1200.0, count = 3 }

[prediction]
y_mm = [-900.0, 0.0, 900.0]
z_mm = [400.0, 1100.0]
"""


def unknowns(rng: np.random.Generator) -> tuple[np.ndarray, ...]:
    """White rows (9, 6), information (6, 6), slopes (4, 2, 6), rest (2,)."""
    factor = rng.standard_normal((6, 6))
    information = np.eye(6) + factor @ factor.T
    slopes = rng.standard_normal((4, 2, 6))
    return 0.5 * rng.standard_normal((4, 6)), information, slopes, rng.random(2)


def dense(white, information, slopes, rest, times):
    covariance = np.linalg.inv(information + times * white.T @ white)
    squares = np.einsum("ncu,uv,ncv->nc", slopes, covariance, slopes)
    return rest + squares.mean(axis=0)


def test_repeated_readings_leave_what_a_dense_update_leaves():
    arguments = unknowns(np.random.default_rng(1))
    error = remaining_error(*arguments)
    for times in (0.0, 1.0, 7.5, 1e9):
        assert error.after(times) == pytest.approx(dense(*arguments, times), rel=1e-6)
    assert error.after(np.inf) == pytest.approx(dense(*arguments, 1e9), rel=1e-6)


def test_equal_times_are_where_the_errors_meet():
    arguments = unknowns(np.random.default_rng(2))
    error, unit = remaining_error(*arguments), dense(*arguments, 1.0)
    reached = dense(*arguments, 6.0)
    assert error.equal_times(reached) == pytest.approx(6.0, rel=1e-4)
    assert error.equal_times(2.0 * unit) == 1.0
    floor = dense(*arguments, 1e12)
    assert error.equal_times(0.99 * floor) == np.inf
    assert relative(unit, unit) == pytest.approx(1.0)


def play(state):  # type: ignore[no-untyped-def]
    yield Column("leg 1", PLAY, joints={0: -0.5 * state.motion_sign[:, 0]})


def test_a_side_that_is_not_recorded_is_scatter():
    """Play of one drive: half of it times the slope, and no mean."""
    measurement = Measurement(machine, [mount(pose_tracker.position, "tracker")])
    y, z = np.meshgrid(np.linspace(-1.0, 1.0, 4), np.linspace(0.3, 1.2, 3))
    series = [measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))]
    request = GapRequest((), (0.0, 0.0, -1.0), (), ConditionsTable())
    rng = np.random.default_rng(3)
    problem, courses = request.planned_courses(measurement, series, rng, 3600.0)
    effect = Effect(
        name="play",
        source="ISO 230-2",
        about="play of one drive",
        columns=play,
        needs=("direction: both",),
    )
    columns = ExpectedColumns.of(problem, [effect], unknown=False)
    assert columns is not None
    session, where = SessionStates.of(problem), np.array([[0.0, 0.8], [0.5, 0.6]])
    over = CourseColumns.of(
        problem, courses, columns, session, where, "absolute", np.random.default_rng(0)
    )
    assert over.of_course.all()
    by_joint = np.concatenate([r.joints[0][:, :, 0].ravel() for r in problem.responses])
    assert over.scatter(over.of_course) == pytest.approx(
        0.5 * PLAY * np.abs(by_joint), abs=1e-12
    )
    assert over.mean == pytest.approx(0.0, abs=1e-12)
    times = np.array([c.covariates["time"] for c in courses])
    assert np.ptp(times.mean(axis=0)) < 0.2 * np.ptp(times)


def test_a_recorded_course_is_known_and_another_is_not():
    """Readings with a shared effect, by the covariance of the readings alone."""
    rng = np.random.default_rng(4)
    changes, tool = rng.standard_normal((2, 6, 3)), rng.standard_normal((2, 4, 2, 3))
    of_course = np.array([True, True, False])
    changes[1, :, 2], tool[1, :, :, 2] = changes[0, :, 2], tool[0, :, :, 2]
    effects = CourseColumns(changes, tool, of_course)
    h, slopes = rng.standard_normal((6, 4)), rng.standard_normal((4, 2, 4))
    planned = PlannedReadings(h, np.ones(6), np.eye(4), slopes)
    recorded = np.array([True, False, False])
    errors = planned.predict(effects, recorded, np.zeros(6))
    assert len(errors) == 2
    for number, error in enumerate(errors):
        g, e = changes.mean(axis=0), tool.mean(axis=0)
        hidden, hidden_tool = changes[:, :, 1] - g[:, 1], tool[..., 1] - e[..., 1]
        g[:, 0], e[:, :, 0] = changes[number, :, 0], tool[number, :, :, 0]
        noise = np.diag(1.0 + (hidden**2).mean(axis=0))
        rows, whole = np.hstack([h, g]), np.concatenate([slopes, e], axis=2)
        gain = rows.T @ np.linalg.inv(rows @ rows.T + noise) @ rows
        left = np.einsum("ncu,uv,ncv->c", whole, np.eye(7) - gain, whole) / 4.0
        rest = (hidden_tool**2).mean(axis=(0, 1))
        assert error.after(1.0) == pytest.approx(left + rest, rel=1e-9)


def test_the_table_of_a_design(tmp_path):
    """More of what legs do is known with more thermometers, and less is left."""
    resolved = sample.resolved(STUDY, tmp_path)
    design = select_design(resolved, np.random.default_rng(0))
    assert design is not None
    whole = design_sample.section(resolved, design)
    section = whole.effects.recording
    choices = {choice.name: choice for choice in section.choices}
    assert {"direction", "time", "reference run", "temp_leg1_C"} <= set(choices)
    one, both = choices["temp_leg1_C"], choices["temp_leg1_C, temp_leg2_C"]
    assert both.gain > one.gain > 0.0
    assert choices["direction"].effects == ["backlash"]
    assert one.words == "a thermometer on leg 1"
    for key, value in section.accuracy.items():
        assert section.floor[key] < value
        assert both.accuracy[key] < value
    (sentence,) = recording_sentences(whole)
    assert section.choices[0].words in sentence
    table = recording_blocks(section)[1]
    assert isinstance(table, Table)
    assert len(table.rows) == len(choices) + 2
