"""Rules, limits, polish and order of a study's [design], each checked on the plan."""

import itertools
from pathlib import Path

import numpy as np
import pytest
import sample
from design_sample import (
    EXTRA,
    FREE,
    GRID,
    GRIDS,
    KNOWN,
    THREE,
    chosen,
    rows,
    section,
    text,
    value,
)

from oed import dataset
from pkm_studies import stages, study
from pkm_studies.base import InputError
from pkm_studies.resolve import ResolvedStudy

#: of one set-up, four points each
FOUR_CIRCLES = GRID.format(name="cup").replace(
    "[1086, 1246]", "[1086, 1146, 1206, 1246]"
)


# -- rules -----------------------------------------------------------------------------
def test_the_best_two_of_three_setups():
    plan = KNOWN.replace("3", "4") + "setups_max = 2\n"
    tables = GRIDS.replace(", 230]", "]")
    resolved, design = chosen(text(plan, tables=tables, setups=THREE))
    owner = np.concatenate([[s.setup] * len(s) for s in resolved.candidates])
    h = rows(resolved)
    subsets = (list(s) for s in itertools.combinations(range(len(h)), 4))
    best = max(value("D", h[s], resolved) for s in subsets if len(set(owner[s])) <= 2)
    assert len(set(owner[design.choice.indices])) <= 2
    assert design.choice.value == pytest.approx(best, rel=1e-9)
    assert design.choice.bound is not None
    assert design.choice.bound >= best
    assert set(design.measurement.setups) == set(owner[design.choice.indices])
    assert section(resolved, design).setups == design.order.setups


def test_a_budget_is_respected_and_used():
    plan = 'scaling = "tolerance"\nprior = true\nbudget_min = 31\n'
    report = section(*chosen(text(plan, tables=GRIDS, setups=THREE)))
    assert report.cost_min is not None
    # two set-ups of 15 min, and 10 readings of 6 s
    assert report.cost_min <= 31.0 + 1e-9
    assert (len(report.setups), report.n) == (2, 10)
    _, fewer = chosen(text(KNOWN + "budget_min = 31\n", tables=GRIDS, setups=THREE))
    assert sum(map(len, fewer.series)) == 3


def nearest(plan: str) -> float:
    """Least distance of two readings of a plan, in units of 320 mm and 110 degrees."""
    _, design = chosen(text(plan))
    command = np.vstack([s.reading_commands() for s in design.series])[:, :2]
    command /= [0.32, np.radians(110)]
    distances = np.linalg.norm(command[:, None] - command[None], axis=2)
    return float(distances[np.triu_indices(3, 1)].min())


def test_readings_keep_their_distance():
    assert nearest(KNOWN + "apart = { z_mm = 320, psi_deg = 110 }\n") >= 1.0 - 1e-9
    assert nearest(KNOWN) < 1.0
    resolved, fewer = chosen(text(KNOWN + "apart = { z_mm = 200, psi_deg = 200 }\n"))
    words = "the study asks for 3, but the rules leave no room for more"
    assert words in section(resolved, fewer).words


def test_whole_circles():
    tables = FOUR_CIRCLES + 'runs_by = "z"\n'
    plan = KNOWN.replace("3", "2") + "whole_runs = true\n"
    resolved, design = chosen(text(plan, tables=tables))
    report = section(resolved, design)
    assert (report.n, report.candidates) == (8, 4)
    assert report.words.endswith(("of 4 runs.", "of 4 runs is better by D."))
    h = rows(resolved).reshape(4, 4, -1)
    pairs = itertools.combinations(range(4), 2)
    best = max(pairs, key=lambda s: value("D", np.vstack(h[list(s)]), resolved))
    assert tuple(design.choice.indices) == best
    runs = [p.run for p in report.poses]
    assert runs == [r for r in dict.fromkeys(runs) for _ in range(4)]


def retained_plan(setup: str) -> str:
    """The grid of a set-up as a reference plan."""
    table = GRID.format(name=setup).replace("candidates", "reference")
    return table.replace(f'"{setup}"', f'"{setup}"\nname = "before"')


def retained_rows(resolved: ResolvedStudy) -> np.ndarray:
    m, old = resolved.measurement, resolved.reference_plans[0].series
    return (m.jacobian(old, m.nominal) * m.tolerance / 0.5e-6)[:, m.free]


def test_a_plan_is_added_to():
    """The best three, added to eight retained ones."""
    tables = GRID.format(name="cup").replace("1086", "1106") + retained_plan("cup")
    resolved, design = chosen(text(KNOWN + 'keep = "before"\n', tables=tables))
    report = section(resolved, design)
    assert (report.n, report.retained) == (11, 8)
    assert [p.run for p in report.poses] == ["1"] * 8 + ["added"] * 3
    h, old = rows(resolved), retained_rows(resolved)
    subsets = (list(s) for s in itertools.combinations(range(8), 3))
    best = max(value("D", np.vstack([old, h[s]]), resolved) for s in subsets)
    assert design.choice.value == pytest.approx(best, rel=1e-9)
    assert report.value == pytest.approx(best, rel=1e-9)
    assert "added to 8 retained readings" in report.words


def test_a_set_up_of_retained_readings_is_mounted_already():
    """One of two further set-ups, besides the one with retained readings."""
    plan = KNOWN + 'setups_max = 1\nkeep = "before"\n'
    tables = GRIDS + retained_plan("low")
    resolved, design = chosen(text(plan, tables=tables, setups=THREE))
    h, old = rows(resolved), retained_rows(resolved)
    owner = np.concatenate([[s.setup] * len(s) for s in resolved.candidates])
    subsets = (list(s) for s in itertools.combinations(range(len(h)), 3))
    best = max(
        value("D", np.vstack([old, h[s]]), resolved)
        for s in subsets
        if not {"high", "side"} <= set(owner[s])
    )
    # directions are lost: determinants of the squared rows round to 1e-9
    assert design.choice.value == pytest.approx(best, rel=1e-8)
    assert set(design.order.setups) == {"low"} | set(owner[design.choice.indices])


def test_readings_of_a_file_are_retained(tmp_path):
    resolved, first = chosen(text(KNOWN))
    y = resolved.measurement.readings(first.series, resolved.measurement.nominal)
    readings = dataset.from_series(first.series, y, resolved.measurement)
    (tmp_path / "first.csv").write_text(dataset.to_csv(readings), "utf-8")
    _, second = chosen(text(KNOWN + 'keep_readings = "first.csv"\n'), tmp_path)
    assert second.retained == 3
    assert sum(map(len, second.series)) == 6
    assert second.choice.value > first.choice.value + 1.0


def test_limits_are_counted_in_words():
    limits = """
[design.limits]
joints = { q1_mm = { from = 380, to = 800 } }
travel_mm = 1.0
cup_cone = { axis = [0, 0, -1], half_angle_deg = 60 }
"""
    resolved, design = chosen(text(KNOWN, tables=GRID.format(name="cup") + limits))
    unlimited = sample.resolved(text(KNOWN)).candidates[0]
    m = resolved.measurement
    _, tip, _ = m.kinematics.frames(unlimited.start[:8], np.zeros(3))
    down = np.degrees(np.arccos((np.array([0, 0, 1.286]) - tip)[:, 2] / 0.3))
    joints, cone = (unlimited.q[:8, 0] < 0.38) | (unlimited.q[:8, 0] > 0.8), down > 60
    assert resolved.refusals == {
        "leave the travel of joint q1": int(joints.sum()),
        "leave the cone at the cup": int(cone.sum()),
    }
    assert 0 < joints.sum() < 8
    assert 0 < cone.sum() < 8
    assert len(resolved.candidates[0]) == int((~joints & ~cone).sum())
    assert section(resolved, design).refused == resolved.refusals
    assert any("leave the cone at the cup" in w for w in resolved.warnings)


def test_a_sphere_in_the_way_and_an_unlikely_travel():
    obstacle = (
        "\n[design.limits]\nspheres = [{ at_mm = [90, 80, 1180], radius_mm = 20"
        " }]\nbar_mm = 5\nmargin_mm = 15\n"
    )
    resolved, _ = chosen(text(KNOWN, tables=GRID.format(name="cup") + obstacle))
    free = sample.resolved(text(KNOWN)).candidates[0]
    _, tip, _ = resolved.measurement.kinematics.frames(free.start[:8], np.zeros(3))
    positions = np.linspace(0, 1, 2001)[:, None, None]
    bar = np.array([0, 0, 1.286]) + positions * (tip - np.array([0, 0, 1.286]))
    clearance = np.linalg.norm(bar - np.array([0.090, 0.080, 1.180]), axis=2)
    crowded = clearance.min(axis=0) < 0.040
    assert 0 < crowded.sum() < 8
    assert resolved.refusals == {"come too near an obstacle": int(crowded.sum())}
    unlikely = "\n[design.limits]\ntravel_mm = 0.001\ntravel_chance = 0.9\n"
    refusal = "8 leave the travel of the instrument on too many machines"
    with pytest.raises(InputError, match=refusal):
        sample.resolved(text(KNOWN, tables=GRID.format(name="cup") + unlikely))


# -- polish and order ------------------------------------------------------------------
@pytest.mark.parametrize("criterion", [
    "D",
    pytest.param("I", marks=pytest.mark.slow),
    pytest.param("c", marks=pytest.mark.slow),
])  # fmt: skip
def test_polished_poses_are_better_and_on_hold(criterion, tmp_path):
    table = GRID.format(name="low").replace("[1086, 1246]", "[1126, 1226]")
    table += (
        "\n[design.polish]\nfree = { low = { at_x_mm = [-20, 20] } }\niterations = 60\n"
    )
    fields = f'criterion = "{criterion}"\n' + EXTRA + KNOWN.replace("3", "6")
    fields = text(fields, tables=table, setups=FREE.format(name="low", x=0, z=1126))
    parsed = study.Study.parse(fields, Path("x.study.toml"))
    result = stages.run_study(parsed, tmp_path, report=False)
    design = result.design
    assert design.polished.after > design.polished.before
    assert design.value == pytest.approx(design.polished.after, rel=1e-9)
    # in working order: rounded otherwise
    assert design.plans[0].value == pytest.approx(design.value, rel=1e-8)
    assert (design.bound, design.efficiency) == (None, None)
    assert "polishing gained" in design.words
    lengths = [p.reading["length_mm"] for p in design.poses]
    assert lengths == pytest.approx([300.0] * len(lengths), abs=1e-6)
    at = design.polished.setups["low"]["at_x_mm"]
    assert -20 <= at <= 20
    assert any("write at_x_mm" in w for w in result.warnings)
    assert result.setups[0].numbers["at_x_mm"] == at


def test_the_order_is_short_and_the_reference_comes_often_enough(tmp_path):
    order = """
[design.order]
speed_mm_s = 2.0
reference_every_min = 6.0
reference = { z_mm = 1166, psi_deg = 90, theta = "hold" }
"""
    parsed = study.Study.parse(
        text(KNOWN.replace("3", "8"), tables=GRID.format(name="cup") + order),
        Path("x.study.toml"),
    )
    design = stages.run_study(parsed, tmp_path, report=False).design
    assert design.order.exact
    assert design.order.after_s < design.order.before_s
    resolved, unordered = chosen(text(KNOWN.replace("3", "8")))
    (series,), m = unordered.series, resolved.measurement
    q = np.vstack(
        [m.kinematics.inverse(m.machine.home_command)[1], series.q[series.index[:, 0]]]
    )
    times = [
        np.abs(np.diff(q[[0, *p]], axis=0)).max(axis=1).sum() / 2e-3
        for p in itertools.permutations(range(1, 9))
    ]
    assert design.order.after_s == pytest.approx(min(times), rel=1e-9)
    runs = [p.run for p in design.poses]
    assert runs[0] == runs[-1] == "reference"
    assert runs.count("reference") == design.order.references == len(runs) - 8
    # time from the end of a reference reading to the begin of the next
    poses = np.array([[p.command["z_mm"] / 1e3, *np.radians([p.command["psi_deg"], p.command["theta_deg"]])]
                      for p in design.poses])  # fmt: skip
    joints = m.kinematics.inverse(poses)[1]
    steps = np.abs(np.diff(joints, axis=0)).max(axis=1) / 2e-3
    clock, times_of_reference = 0.0, []
    for k, run in enumerate(runs):
        clock += float(steps[k - 1]) if k else 0.0
        if run == "reference":
            times_of_reference.append(clock)
        clock += 6.0
    assert max(np.diff(times_of_reference)) - 6.0 <= 360.0 + 1e-6
    filled = tmp_path / "filled.readings.csv"
    lines = sample.table_lines((tmp_path / "poses.csv").read_text())
    filled.write_text(
        "\n".join([lines[0], *(line + "300.0" for line in lines[1:])]) + "\n"
    )
    assert len(dataset.load([filled], m)) == len(runs)
    assert [line.split(",")[1] for line in lines[1:]] == runs
    assert [line.split(",")[2] for line in lines[1:] if ",reference," in line] == [
        str(k + 1) for k in range(design.order.references)
    ]
