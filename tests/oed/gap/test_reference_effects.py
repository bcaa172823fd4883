"""Errors of the references of set-ups, against plain numpy: forms, offers, and names."""

import numpy as np
import pandas as pd
import pytest
from effects_sample import REFERENCES, columns, effect_of
from shipped_models import (
    a3_head,
    ball_bar,
    ball_plate,
    height_probe,
    hexapod,
    length_gauge,
    linear_delta,
    planar_2dof,
    pose_tracker,
    relative,
)

from kernel import planar_session
from kernel.laws import STATED_LAW
from oed import Measurement, mount
from oed.effect_model import Effect, State
from oed.gap import diagnose, prepare
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.measurement import draw_parameters, draw_readings
from pkm_studies import catalogue


def _problem(machine, instrument, command, change=None, **settings):
    """Readings of a drawn machine at commands, changed by `change` of its tool points."""
    setup = mount(instrument, "a", **settings)
    measurement = Measurement(machine, [setup])
    series = [measurement.series("a", command, ["1"] * len(command))]
    rng = np.random.default_rng(3)
    theta = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, theta, rng)
    n = len(series[0])
    rows = pd.DataFrame({"setup": "a", "run": "1", "order": np.arange(1, n + 1)})
    plain = prepare(measurement, series, y, rows)
    if change is None:
        return plain
    return prepare(measurement, series, y + change(plain.states[0]), rows)


def _tilts(count: int = 80) -> np.ndarray:
    """Commands of a hexapod at tilts up to 15 degrees about x and y."""
    rng = np.random.default_rng(5)
    home = hexapod.machine.home_command
    spread = np.array([0.08, 0.08, 0.03, 0.26, 0.26, 0.0])
    return home + rng.uniform(-1.0, 1.0, (count, 6)) * spread


def _reading(name: str, state: State, coefficient: str, channel: str) -> np.ndarray:
    return columns(name, state)[f"set-up a {coefficient}"].reading[channel]


# -- forms -----------------------------------------------------------------------------
def test_a_bow_is_its_sagitta_in_the_middle_and_nothing_at_the_ends():
    line = np.column_stack([np.linspace(-1.4, 1.4, 5), np.full(5, 0.5)])
    state = _problem(planar_2dof.machine, relative.rm5, line).states[0]
    bow = _reading("ruler_bow", state, "bow", "dz")
    y = state.tool[:, 1]
    u = 2.0 * (y - y.min()) / (y.max() - y.min()) - 1.0
    order = np.argsort(y)
    np.testing.assert_allclose(bow[order], (1.0 - u**2)[order], atol=1e-12)
    assert bow[order][2] == pytest.approx(1.0, abs=1e-3)


def test_a_square_error_is_its_angle_times_the_way():
    line = np.column_stack([np.zeros(6), np.linspace(0.2, 1.2, 6)])
    problem = _problem(planar_2dof.machine, relative.rm4, line)
    signature = problem.signature(effect_of("square_error"), {})
    way = line[1:, 1] - line[0, 1]  # but for the machine's own errors
    assert signature.columns[:, 0] == pytest.approx(-10e-6 * way, rel=0.01)


def test_lobes_have_two_and_three_fold_symmetry_about_the_stylus():
    state = _problem(hexapod.machine, height_probe.instrument, _tilts()).states[0]
    up = state.rotation[:, 2, :]  # base z in the platform's frame
    angle = np.arctan2(up[:, 1], up[:, 0])
    lateral = np.hypot(up[:, 0], up[:, 1])
    for k in (2, 3):
        for name, wave in (("cos", np.cos), ("sin", np.sin)):
            lobe = _reading("probe_lobing", state, f"{name} {k}", "height")
            np.testing.assert_allclose(lobe, lateral**k * wave(k * angle), atol=1e-12)


def test_an_abbe_offset_reads_the_height_of_a_point_beside_the_tool():
    state = _problem(hexapod.machine, length_gauge.instrument, _tilts()).states[0]
    offset = np.array([3e-5, -2e-5, 0.0])
    height = (state.rotation @ offset)[:, 2]
    found = 3e-5 * _reading("probe_abbe", state, "offset x", "height")
    found -= 2e-5 * _reading("probe_abbe", state, "offset y", "height")
    np.testing.assert_allclose(found, height, atol=1e-15)


def test_a_plate_and_the_air_scale_all_lengths():
    command = np.random.default_rng(1).uniform(-0.05, 0.05, (20, 3))
    command += linear_delta.machine.home_command
    plate = _problem(
        linear_delta.machine, ball_plate.instrument, command, at_x=0.1
    ).states[0]
    tracker = _problem(linear_delta.machine, pose_tracker.position, command).states[0]
    x = _reading("plate_certificate", plate, "scale", "ball_x")
    np.testing.assert_allclose(x, plate.tool[:, 0] - 0.1)
    for k, axis in enumerate("xyz"):
        length = _reading("air_refraction", tracker, "scale", f"read_{axis}")
        np.testing.assert_allclose(length, tracker.tool[:, k])


# -- offers ----------------------------------------------------------------------------
@pytest.mark.parametrize(("instrument", "wanted"), [
    (relative.rm4, {"ruler_bow", "square_error"}),
    (relative.rm5, {"ruler_bow", "air_refraction"}),
    (relative.rm1, {"air_refraction"}),
])  # fmt: skip
def test_only_what_the_set_ups_can_have_is_tried(instrument, wanted):
    offered = {
        name for name in REFERENCES if effect_of(name).is_offered([instrument.name])
    }
    assert offered == wanted


def test_what_a_parameter_of_the_set_up_does_as_well_is_not_testable():
    """A free angle of the square is its error; a distance's free scale its certificate."""
    line = np.column_stack([np.zeros(9), np.linspace(0.1, 1.3, 9)])
    setup = mount(relative.rm4, "a", tolerances={"tilt": 1e-3})
    measurement = Measurement(planar_2dof.machine, [setup])
    series = [measurement.series("a", line, ["1"] * len(line))]
    rows = pd.DataFrame({"setup": "a", "run": "1", "order": np.arange(1, 9)})
    y = measurement.readings(series, measurement.nominal)
    problem = prepare(measurement, series, y, rows)
    refused = library.build(problem, [effect_of("square_error")]).not_testable
    assert "free parameters" in refused["square_error"]
    command = linear_delta.machine.home_command + np.random.default_rng(2).uniform(
        -0.05, 0.05, (30, 3)
    )
    distances = _problem(linear_delta.machine, ball_plate.distance, command)
    refused = library.build(distances, [effect_of("plate_certificate")]).not_testable
    assert "free parameters" in refused["plate_certificate"]


def test_a_parallel_machine_without_tilts_cannot_show_what_comes_with_them():
    command = linear_delta.machine.home_command + np.random.default_rng(2).uniform(
        -0.05, 0.05, (30, 3)
    )
    problem = _problem(linear_delta.machine, height_probe.instrument, command)
    effects = [effect_of("probe_lobing"), effect_of("probe_abbe")]
    refused = library.build(problem, effects).not_testable
    assert set(refused) == {"probe_lobing", "probe_abbe"}


# -- names -----------------------------------------------------------------------------
def _offered(problem: GapProblem) -> list[Effect]:
    used = [state.instrument for state in problem.states]
    every = [effect for _, effect in catalogue.named_items("effects").values()]
    return [effect for effect in every if effect.is_offered(used)]


def _diagnosis(problem: GapProblem) -> Diagnosis:
    rng = np.random.default_rng(1)
    return diagnose(problem, _offered(problem), rng, law=STATED_LAW)


def test_a_bent_ruler_is_named_as_of_its_set_up():
    """Other instruments read the same lines, and the ruler lies along one of them."""
    setups = ("rm5", "rm2")
    problem = planar_session.ruler_session(setups, 12e-6, 1, interleaved=True)
    diagnosis = _diagnosis(problem)
    assert diagnosis.answers[0].effects[0] == "ruler_bow"
    assert diagnosis.where[0].block == "set-up rm5"
    assert any("ruler" in sentence for sentence in diagnosis.next)


def _session(machine, setups, commands, change):
    """Readings of a drawn machine in one run a set-up, or along lines, plus a change."""
    measurement = Measurement(machine, setups)
    rng = np.random.default_rng(11)
    series, rows = [], []
    for setup in setups:
        command = commands[setup.name]
        relative_to = setup.instrument.reference == "run"
        axis = 0 if setup.name == "rm4" else 1
        runs = [f"{v:g}" for v in command[:, axis]] if relative_to else None
        series.append(measurement.series(setup.name, command, runs))
        labels = np.asarray(series[-1].run, dtype=str)
        order = np.arange(1, len(labels) + 1)
        rows.append(pd.DataFrame({"setup": setup.name, "run": labels, "order": order}))
    theta = draw_parameters(measurement, rng)
    y = draw_readings(measurement, series, theta, rng)
    y[: len(change)] += change
    return prepare(measurement, series, y, pd.concat(rows, ignore_index=True))


def _lines(along, across, order):
    points = [(a, b) for a in across for b in along]
    return np.array(points)[:, list(order)]


def test_a_square_s_error_is_named_where_a_third_instrument_reads():
    """A common tilt of both guides is a square's error to RM 4 and RM 5 alone."""
    up, along = np.linspace(0.0, 1.5, 11), np.linspace(-1.5, 1.5, 13)
    commands = {
        "rm4": _lines(up, [-1.5, 0.0, 1.5], (0, 1)),
        "rm5": _lines(along, [0.0, 0.75, 1.5], (1, 0)),
    }
    commands["tracker"] = commands["rm5"]
    setups = [mount(relative.rm4, "rm4"), mount(relative.rm5, "rm5")]
    setups.append(mount(pose_tracker.position, "tracker"))
    change = 40e-6 * np.tile(up[1:], 3)
    diagnosis = _diagnosis(_session(planar_2dof.machine, setups, commands, change))
    assert diagnosis.answers[0].effects[0] == "square_error"
    assert diagnosis.where[0].block == "set-up rm4"
    assert any("square" in sentence for sentence in diagnosis.next)


def test_a_bar_that_is_off_is_named_with_its_set_up():
    rng = np.random.default_rng(3)
    upright, angle = (1.09, -np.pi, 0.0), (1.24, np.pi, np.deg2rad(38.0))
    commands = {
        name: rng.uniform(upright, angle, (60, 3)) for name in ("short", "long")
    }
    bars = {"short": (0.15, (0.0, 0.0, -0.1)), "long": (0.3, (0.0, 0.0, -0.2))}
    teach = [1.16, 0.0, 0.0]
    setups = [
        mount(ball_bar.instrument, name, length=length, teach=teach, tool=tool)
        for name, (length, tool) in bars.items()
    ]
    change = np.full(60, -8e-6)
    diagnosis = _diagnosis(_session(a3_head.machine, setups, commands, change))
    assert diagnosis.answers[0].effects[0] == "bar_length"
    assert diagnosis.where[0].block == "set-up short"
    assert diagnosis.where[0].same_as == "run short 1"
