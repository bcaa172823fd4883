"""Studies as the kernel's objects: every number in SI where it belongs."""

import math
from pathlib import Path

import numpy as np
import pytest
import sample
from shipped_models import prs_spindle

from oed.instrument import Instrument
from oed.units import from_si
from pkm_studies import catalogue, shipped, study
from pkm_studies.base import InputError, Location, SourceAbsentError
from pkm_studies.resolve import conventions, resolve


def test_the_grid_varies_its_first_coordinate_slowest():
    resolved = sample.resolved()
    (series,) = resolved.candidates
    command = series.reading_commands()
    assert len(series) == 48
    np.testing.assert_allclose(command[:12, 0], 1.066)
    np.testing.assert_allclose(
        command[:12, 1], np.radians(np.arange(0, 360, 30)), atol=1e-12
    )
    reading = resolved.measurement.readings(
        resolved.candidates, resolved.measurement.nominal
    )
    np.testing.assert_allclose(reading, 0.300, rtol=1e-9)


def test_numbers_of_the_study_reach_the_kernel():
    text = (
        sample.STUDY
        + """
[[setup]]
name = "long"
instrument = "ball_bar"
tool_mm = [0.0, 0.0, -100.0]
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }
tolerance = { cup_x_um = 5 }

[noise.long]
length_um = 2

[[prior.tolerance]]
parameters = ["dq*", "*.cup_?"]
sigma_um = 300

[[prior.tolerance]]
parameters = ["dq3"]
sigma_mm = 2
"""
    )
    fixed = 'fixed = ["db?z", "beta1", "cup.cup_z"]'
    machine = f'"a3_head"\n{fixed}\nnominal = {{ dq2_mm = 8 }}'
    resolved = sample.resolved(sample.changed(text, ('"a3_head"', machine)))
    cup, long = resolved.setups["cup"], resolved.setups["long"]
    assert (cup.sigma, long.sigma) == ((0.5e-6,), (2e-6,))
    assert long.tool == (0.0, 0.0, -0.1)
    assert cup.settings == {"length": 0.3}
    by_name = {p.name: p for p in resolved.measurement_with(["cup", "long"]).parameters}
    assert by_name["dq2"].nominal == pytest.approx(8e-3)
    assert by_name["dq1"].tolerance == pytest.approx(300e-6)
    assert by_name["dq3"].tolerance == pytest.approx(2e-3)
    assert by_name["long.cup_x"].tolerance == pytest.approx(5e-6)
    assert by_name["long.cup_y"].tolerance == pytest.approx(300e-6)
    assert by_name["cup.cup_z"].tolerance == 0.0
    assert resolved.machine.frame == ("db1z", "db2z", "db3z", "beta1")


def test_a_set_up_that_only_a_reference_names_stays_out():
    text = (
        sample.STUDY
        + """
[[setup]]
name = "other"
instrument = "calliper"

[[design.reference]]
name = "both"
setup = "cup"
z_mm = [1146, 1266]
psi_deg = [0, 90]
theta = "hold"
runs_by = "z"

[[design.reference]]
name = "both"
setup = "other"
z_mm = [1146, 1266]
psi_deg = 0
theta_deg = 5
"""
    )
    resolved = sample.resolved(text)
    assert list(resolved.measurement.setups) == ["cup"]
    (plan,) = resolved.reference_plans
    assert plan.setups == ("cup", "other")
    assert list(plan.series[0].run) == ["z=1146mm", "z=1146mm", "z=1266mm", "z=1266mm"]
    assert [len(s) for s in plan.series] == [4, 1]
    assert list(resolved.measurement_with(plan.setups).setups) == ["cup", "other"]


def test_pairs_are_runs_of_two():
    text = (
        sample.DELTA
        + """
[[design.candidates]]
setup = "calliper"
pairs_mm = [[[0, 0, 20], [50, 0, 20]], [[0, 0, 20], [0, 50, 20]], [[0, 0, 20], [-50, 0, 20]]]
"""
    )
    resolved = sample.resolved(text)
    measurement = resolved.measurement
    readings = measurement.readings(resolved.candidates, measurement.nominal)
    np.testing.assert_allclose(readings, 0.050, rtol=1e-9)
    assert "outside the workspace" in str(
        sample.refused(text, ("[50, 0, 20]", "[500, 0, 20]"))
    )
    assert "two poses" in str(
        sample.refused(text, ('setup = "calliper"', 'setup = "probe"'))
    )


def test_candidates_without_a_held_reading_are_left_out_with_a_warning():
    resolved = sample.resolved(
        sample.changed(sample.STUDY, ("length_mm = 300.0", "length_mm = 100.0"))
    )
    assert 0 < len(resolved.candidates[0]) < 48
    assert "left out" in resolved.warnings[0]


def test_circles_are_spaced_over_the_range():
    text = (
        sample.STUDY
        + """
[[kappa]]
setup = "cup"
circles = [1, 2]
points = [15]
z_mm = { from = 1146.0, to = 1266.0 }
coordinate = "theta"
"""
    )
    (circles,) = sample.resolved(text).kappa_circles
    (one,), (two,) = circles.every_series()
    heights = two.reading_commands()[:, 0]
    np.testing.assert_allclose(np.unique(np.round(heights, 9)), [1.146, 1.266])
    np.testing.assert_allclose(one.reading_commands()[:, 0], 1.206)
    # 2 circles of 15 points, taught cup: condition number 3748 over the 18 identifiable
    # directions
    measurement = circles.measurement
    columns = (
        measurement.jacobian([two], measurement.nominal) / measurement.length_factors
    )
    values = np.linalg.svd(columns[:, measurement.free], compute_uv=False)
    assert values[0] / values[17] == pytest.approx(3748, rel=1e-3)


def test_circles_are_read_with_a_reference_plan():
    """Two circles of 15 points and the six home rows: 17259, home orientation in rad."""
    of_paper = study.Study.load(shipped.studies()["a3_home_orientation"].path)
    (circles,) = resolve(of_paper).kappa_circles
    assert [s.setup for s in circles.further] == ["home_point", "home_orientation"]
    m, series = circles.measurement, circles.every_series()[0][4]
    rows = m.jacobian([*circles.further, series], m.nominal) / m.length_factors
    assert np.linalg.cond(rows[:, m.free]) == pytest.approx(17259, abs=1)


def test_truth_is_in_si_and_names_the_set_up():
    truth = '[readings.truth]\nbeta1_deg = 0.5\n"cup.cup_y_um" = 3\n'
    of_setup = "[readings.truth.cup]\ncup_x_mm = 0.1\n"
    text = f"{sample.STUDY}[readings]\nsimulate = true\n{truth}{of_setup}"
    resolved = sample.resolved(text)
    assert resolved.true_parameters == {
        "beta1": pytest.approx(math.radians(0.5)),
        "cup.cup_y": pytest.approx(3e-6),
        "cup.cup_x": pytest.approx(1e-4),
    }


def test_readings_of_a_study_are_relative_to_it(tmp_path):
    (tmp_path / "a.csv").write_text(sample.READINGS, encoding="utf-8")
    text = sample.STUDY + '[readings]\nfiles = ["a.csv"]\n'
    resolved = sample.resolved(text, tmp_path)
    assert resolved.dataset is not None
    assert len(resolved.dataset) == 3
    assert (
        resolve(study.Study.parse(text, tmp_path / "x.toml"), readings=()).dataset
        is None
    )
    error = sample.refused(text + 'fit = ["cup"]\npredict = ["cup"]\n', folder=tmp_path)
    assert error.field == "readings.predict"


def test_an_absent_source_has_an_error_of_its_own(tmp_path):
    text = sample.DELTA + '[readings]\nsource = "delta_v400"\npath = "nowhere"\n'
    with pytest.raises(SourceAbsentError, match="nowhere"):
        sample.resolved(text, tmp_path)


def test_a_source_becomes_readings(tmp_path):
    (tmp_path / "sessions.json").write_text(
        '[{"session": "S1", "step_distance_mm": [0.01, 0.01, 0.02]}]'
    )
    (tmp_path / "heights.csv").write_text(
        "session,i,height_mm,steps_a,steps_b,steps_c\nS1,0,18.1,40000,40100,20050\n"
    )
    (tmp_path / "distances.csv").write_text(
        "session,i,distance_mm,p1_a,p1_b,p1_c,p2_a,p2_b,p2_c\nS1,0,64.9,41000,40000,20000,38000,40000,21000\n"
    )
    text = sample.changed(
        sample.DELTA, ('"probe"', '"S1_probe"'), ('"calliper"', '"S1_calliper"')
    )
    data = sample.resolved(
        text + '[readings]\nsource = "delta_v400"\npath = "."\n', tmp_path
    ).dataset
    np.testing.assert_allclose(data.y, [0.0181, 0.0649])
    np.testing.assert_allclose(data.series[0].q[0], [0.400, 0.401, 0.401])
    np.testing.assert_allclose(
        data.series[1].q[data.series[1].index[0]],
        [[0.38, 0.40, 0.42], [0.41, 0.40, 0.40]],
    )


TABLE = """
[design]
readings = 5

[[design.candidates]]
setup = "probe"
"""


def commands_mm(table: str, folder: Path = Path()) -> np.ndarray:
    """Commands (n, 3), mm, of the delta's candidates with a table."""
    resolved = sample.resolved(sample.DELTA + TABLE + table, folder)
    (series,) = resolved.candidates
    return from_si(series.command, "mm")


def refusal(table: str, folder: Path = Path()) -> str:
    with pytest.raises(InputError) as raised:
        sample.resolved(sample.DELTA + TABLE + table, folder)
    return str(raised.value)


def test_a_list_is_no_product():
    table = "poses = { x_mm = [0, 50, 0], y_mm = [0, 0, 60], z_mm = [10, 20, 30] }"
    wanted = [[0, 0, 10], [50, 0, 20], [0, 60, 30]]
    np.testing.assert_allclose(commands_mm(table), wanted)


def test_a_file_as_a_spreadsheet_writes_it(tmp_path):
    (tmp_path / "poses.csv").write_text("run;x_mm;y_mm;z_mm\na;0,5;1;10\nb;2;3;20,25\n")
    text = sample.DELTA + TABLE + 'file = "poses.csv"'
    (series,) = sample.resolved(text, tmp_path).candidates
    command = from_si(series.command, "mm")
    np.testing.assert_allclose(command, [[0.5, 1.0, 10.0], [2.0, 3.0, 20.25]])
    assert list(series.run) == ["a", "b"]


def test_a_circle_both_ways():
    """Worked by hand: in zx the angle runs from z to x."""
    table = (
        'circle = { centre_mm = [10, 5, 100], radius_mm = 40, plane = "zx",'
        ' direction = "both", start_deg = 90, count = 4 }'
    )
    forward = [[50, 5, 100], [10, 5, 60], [-30, 5, 100], [10, 5, 140]]
    backward = [forward[k] for k in (0, 3, 2, 1)]
    np.testing.assert_allclose(commands_mm(table), forward + backward, atol=1e-9)


def test_a_line_and_a_cube():
    table = "line = { from_mm = [0, 0, 20], to_mm = [30, 60, 20], count = 4 }"
    wanted = [[0, 0, 20], [10, 20, 20], [20, 40, 20], [30, 60, 20]]
    np.testing.assert_allclose(commands_mm(table), wanted, atol=1e-9)
    table = "cube = { centre_mm = [0, 0, 100], side_mm = 60 }"
    cube = commands_mm(table)
    assert len({tuple(np.round(point, 6)) for point in cube}) == 27
    assert cube.min(axis=0) == pytest.approx([-30, -30, 70])
    assert cube.max(axis=0) == pytest.approx([30, 30, 130])


def test_samples_fill_the_workspace_and_can_be_reached():
    points = commands_mm("")
    assert 200 < len(points) <= 500
    assert points[:, :2].min() < -120.0
    assert points[:, :2].max() > 120.0
    near = commands_mm("sample = 40\nz_mm = [10, 30]\nx_mm = 5")
    assert 10.0 <= near[:, 2].min() < 13.0
    assert 27.0 < near[:, 2].max() <= 30.0
    np.testing.assert_allclose(near[:, 0], 5.0)


def test_a_machine_commanded_in_angles_follows_a_circle():
    """An A3 head with a ball bar: all points lie on the sphere about the cup."""
    circle = (
        "circle = { centre_mm = [0, 0, 1106], radius_mm = 240,"
        ' plane = "xy", count = 12 }'
    )
    grid = sample.STUDY[
        sample.STUDY.index("z_mm = { from") : sample.STUDY.index("\n[report]")
    ]
    resolved = sample.resolved(sample.changed(sample.STUDY, (grid, circle)))
    (series,) = resolved.candidates
    tip = resolved.measurement.kinematics.frames(series.start[:12], np.zeros(3))[1]
    np.testing.assert_allclose(tip[:, 2], 1.106, atol=1e-9)
    np.testing.assert_allclose(np.hypot(tip[:, 0], tip[:, 1]), 0.240, atol=1e-9)
    angle = np.unwrap(np.arctan2(tip[:, 1], tip[:, 0]))
    np.testing.assert_allclose(np.diff(angle), np.radians(30.0), atol=1e-8)


@pytest.mark.parametrize(("table", "words"), [
    ("sample = 5\nline = { from_mm = [0,0,9], to_mm = [1,0,9] }", "line and sample"),
    ("poses = { x_mm = [0, 1], y_mm = [0, 1], z_mm = [9] }", "x 2, y 2, z 1"),
    ("poses = { x_mm = [0], y_mm = [0] }", "z_mm: missing"),
    ("circle = { centre_mm = [0,0,90], radius_mm = 900, count = 3 }", "cannot be put on 3"),
    ('circle = { centre_mm = [0,0,90], radius_mm = 9, plane = "xz" }', "zx"),
    ('file = "none.csv"', "there is no such CSV file"),
    ('file = "bad.csv"', "line 3, column y_mm = wide"),
    ("sample = 9\nz_mm = [900, 950]", "none of 9 sampled poses"),
    ('sample = 9\nz = "hold"', "sampled poses hold no reading"),
])  # fmt: skip
def test_poses_that_do_not_fit_are_refused(table, words, tmp_path):
    (tmp_path / "bad.csv").write_text("x_mm,y_mm,z_mm\n1,2,3\n1,wide,3\n")
    assert words in refusal(table, tmp_path)


def instrument(name: str) -> Instrument:
    return catalogue.instrument(name, Path(), Location("catalogue"))


def test_columns_of_a_file_are_stated_above_its_header():
    m = prs_spindle.machine
    tool = instrument("pose_tracker")
    header = [
        "setup", "run", "order", "alpha_deg", "q1_mm", "read_alpha_mrad", "time_s",
    ]  # fmt: skip
    lines = conventions.readings_comments(m, {"t": tool}, header)
    assert lines[0].startswith("base frame: ")
    stated = {line.partition(": ")[0] for line in lines}
    assert {"alpha_deg", "q1_mm", "read_alpha_mrad"} <= stated
    both = {"a": instrument("ball_bar"), "b": instrument("calliper")}
    (line,) = [
        line
        for line in conventions.readings_comments(m, both, ["length_mm"])
        if line.startswith("length_mm")
    ]
    assert "a: distance from the cup" in line
    assert "b: distance between the tool points" in line
