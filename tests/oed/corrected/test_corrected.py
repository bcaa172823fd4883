"""Parameters and effects estimated together, on A3 heads of the oracle."""

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from scipy.interpolate import RegularGridInterpolator
from shipped_models import backlash, leg_thermal

from kernel import a3_machines, a3_plans, corrected_cases, corrected_machines
from kernel.a3_machines import (
    NOISE,
    PER_KELVIN,
    PLAY,
    PLAY_LEG,
    WARM_LEG,
    planned,
    read,
    travel_sense,
    turned,
)
from oed import compensate
from oed.compensate import GridAxis
from oed.corrected import CorrectedEstimate, EffectReadings
from oed.estimation import Estimate, identify
from oed.measurement import Measurement
from pkm_studies.stages.correct.corrected import effect_tables


@dataclasses.dataclass
class Session:
    """Readings of one machine of the oracle, with what was fitted to them."""

    truth: np.ndarray
    plain: Estimate
    corrected: CorrectedEstimate


def session(m: Measurement, rng: np.random.Generator) -> Session:
    series, rows = planned(m)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = read(series, rows, truth, rng)
    plain = identify(m, [series], y)
    effects = [leg_thermal.effect, backlash.effect]
    readings = EffectReadings(m, (series,), y, rows)
    corrected = readings.estimate(effects, plain.theta)
    assert corrected is not None
    return Session(truth, plain, corrected)


@pytest.fixture(scope="module")
def measured() -> tuple[Measurement, Session]:
    m = a3_plans.measurement()
    return m, session(m, np.random.default_rng(5))


def deviations(estimate: Estimate, truth: np.ndarray) -> np.ndarray:
    """Errors of the identified parameters, in their standard deviations."""
    free = estimate.prior_sd[: len(truth)] > 0
    error = (estimate.theta[: len(truth)] - truth)[free]
    return error / estimate.sd[: len(truth)][free]


def test_the_plain_fit_is_bent_and_the_corrected_one_is_not(measured):
    _, s = measured
    assert np.abs(deviations(s.plain, s.truth)).max() > 6.0
    corrected = deviations(s.corrected.estimate, s.truth)
    assert np.abs(corrected).max() < 4.0
    assert np.sqrt(np.mean(corrected**2)) < 1.6


def test_few_readings_far_off_do_not_make_an_effect_look_small():
    """Twelve readings are 80 noise deviations off; the play is estimated all the same."""
    m = a3_plans.measurement()
    series, rows = planned(m)
    senses = np.column_stack([travel_sense(series, k) for k in range(3)])
    play = np.array([15e-6, -12e-6, 20e-6])
    q = series.q[series.index[:, 0]] - 0.5 * senses * play
    cup = a3.forward(np.zeros(24), series.q[series.index[:1, 1]]).tip
    rng = np.random.default_rng(4)
    y = a3.ball_bar_reading(np.zeros(24), q, cup) + NOISE * rng.standard_normal(len(q))
    y[rng.choice(len(y), 12, replace=False)] += 80.0 * NOISE
    corrected = EffectReadings(m, (series,), y, rows).estimate(
        [backlash.effect], m.nominal
    )
    start = corrected.parameters
    values = corrected.estimate.theta[start:] * corrected.scales
    sds = corrected.estimate.sd[start:] * corrected.scales
    names = corrected.coefficient_names
    at = [names.index(f"backlash: leg {k}") for k in (1, 2, 3)]
    assert values[at] == pytest.approx(play, rel=0.05)
    assert (sds[at] < 0.05 * np.abs(play)).all()
    assert (corrected.measurement.tolerance[start:] >= 1.0).all()


def test_coefficients_are_those_of_the_machine(measured):
    _, s = measured
    wanted = {
        "leg_thermal: leg 2 per kelvin": PER_KELVIN,
        "leg_thermal: leg 1 per kelvin": 0.0,
        "backlash: leg 3": PLAY,
        "backlash: leg 1": 0.0,
    }
    estimate, at = s.corrected.estimate, s.corrected.parameters
    for name, value in wanted.items():
        if name not in s.corrected.coefficient_names:
            assert value == 0.0  # legs that stay at their temperature change nothing
            continue
        k = s.corrected.coefficient_names.index(name)
        scale = s.corrected.scales[k]
        sd = estimate.sd[at + k] * scale
        assert abs(estimate.theta[at + k] * scale - value) < 4.0 * sd, name
        assert sd < 0.6 * scale, name


def realised(m: Measurement, s: Session, command: np.ndarray) -> np.ndarray:
    """Errors (n, 3) of the oracle's machine, warm and with its play, against home."""
    believed = s.corrected.estimate.theta[:24]
    names = s.corrected.coefficient_names
    at = s.corrected.parameters
    size = dict(
        zip(names, s.corrected.estimate.theta[at:] * s.corrected.scales, strict=True)
    )
    warm, sense = 3.0, 1.0
    q = compensate.compensated_joints(m.kinematics, command, believed)
    actual = q.copy()
    per_kelvin = size["leg_thermal: leg 2 per kelvin"]
    actual[:, WARM_LEG] *= (1 + PER_KELVIN * warm) / (1 + per_kelvin * warm)
    known = size["backlash: leg 3"]
    actual[:, PLAY_LEG] += 0.5 * (known - PLAY) * sense
    tip, _ = a3.nominal_pose(*command.T)
    return np.asarray(a3.forward(s.truth[:24], actual).tip - tip)


def test_the_predicted_height_error_is_realised(measured):
    m, s = measured
    command = a3_plans.workspace()
    accuracy = s.corrected.predict(command, "absolute", np.random.default_rng(1))
    z = realised(m, s, command)[:, 2]
    # one machine: its rms is that of few effective directions
    before, after = accuracy.compensated.before["z"], accuracy.compensated.after["z"]
    assert np.sqrt(np.mean(z**2)) < 3.0 * after.rms
    assert after.rms < 0.5 * before.rms
    assert after.rms <= accuracy.parameters_only["z"].rms


def test_the_budget_of_the_corrected_accuracy_adds_up(measured):
    """It has the effects' sizes; without them, covariances are those of known effects."""
    _, s = measured
    command = a3_plans.workspace()[::12]
    accuracy = s.corrected.predict(command, "home", np.random.default_rng(1))
    budget = accuracy.budget
    total = np.sum([line.variance for line in budget.lines], axis=0)
    spreads = accuracy.compensated.fully_corrected
    predicted = np.array([spreads[name].rms ** 2 for name in budget.names])
    assert total == pytest.approx(predicted, rel=0.01)
    lines = {line.source: line for line in budget.lines}
    effects = lines["sizes of the effects"]
    assert effects.kind == "effects"
    assert effects.without is not None
    assert (effects.without <= np.sqrt(predicted) * (1.0 + 1e-9)).all()
    z = budget.names.index("z")
    assert effects.variance[z] > 0.01 * predicted[z]


def test_tables_correct_the_machine_by_its_states(measured):
    """The oracle's machine, warm and with its play, errs as little as with the formula."""
    m, s = measured
    command = a3_plans.workspace()[::7]
    tabled = s.corrected.tables(command)
    by_axis = {t.axis: t for t in tabled.tables}
    assert set(by_axis) == {"temp_leg2", "direction"}
    assert tabled.missing == {}
    warm = by_axis["temp_leg2"]
    correction = (
        warm.joints[1] * (3.0 / warm.values[1]) + by_axis["direction"].joints[1]
    )
    believed = s.corrected.estimate.theta[:24]
    actual = compensate.compensated_joints(m.kinematics, command, believed) + correction
    actual[:, WARM_LEG] *= 1 + PER_KELVIN * 3.0
    actual[:, PLAY_LEG] -= 0.5 * PLAY
    tip, _ = a3.nominal_pose(*command.T)
    by_tables = a3.forward(s.truth[:24], actual).tip - tip
    # both take the coefficients; the tables hold the form as estimated as well
    assert by_tables == pytest.approx(realised(m, s, command), abs=1.5e-6)
    left_alone = actual - correction
    error = a3.forward(s.truth[:24], left_alone).tip - tip
    assert np.abs(error - by_tables)[:, 2].max() > 10e-6


def test_tables_are_as_fine_as_the_growth_of_the_leg_needs(measured):
    """The leg grows with its joint's length; play is almost the same everywhere."""
    _, s = measured
    command = a3_plans.workspace()
    axes = GridAxis.box_axes(s.corrected.readings.measurement.machine, command)
    tables, missing = effect_tables(s.corrected, command, axes, None)
    assert missing == {}
    warm, play = sorted(tables, key=lambda t: t.state, reverse=True)
    assert play.interpolation["q3"] == pytest.approx(0.0, abs=0.05)
    nodes = np.array([list(c.values()) for c in warm.commands])
    knots = [np.unique(axis) for axis in nodes.T]
    assert len(knots[1]) >= 5
    assert knots[1][-1] - knots[1][0] == pytest.approx(360.0)
    rng = np.random.default_rng(6)
    places = rng.uniform(nodes.min(axis=0), nodes.max(axis=0), (4000, 3))

    def needed(at: np.ndarray) -> np.ndarray:
        z, psi, theta = at.T
        q = a3.inverse_nominal(1e-3 * z, np.deg2rad(psi), np.deg2rad(theta))
        return -1e6 * PER_KELVIN * warm.values[1] * q[:, WARM_LEG]

    shape = [len(axis) for axis in knots]
    lines = RegularGridInterpolator(knots, needed(nodes).reshape(shape))
    lost = np.sqrt(np.mean((lines(places) - needed(places)) ** 2))
    tabled, exact = 1e3 * np.array(warm.table)[1, :, WARM_LEG], needed(nodes)
    share = tabled @ exact / (exact @ exact)  # of the growth, as it is estimated
    assert 0.5 < share < 1.5
    assert warm.interpolation["q2"] == pytest.approx(share * lost, rel=0.1)
    assert lost > 0.1


EFFECTS = [leg_thermal.effect, backlash.effect]


def corrected(seed: int, runs: list[str]) -> CorrectedEstimate:
    m = a3_plans.measurement()
    rng = np.random.default_rng([seed, 26])
    series, rows = a3_machines.planned(m)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = a3_machines.read(series, rows, truth, rng)
    theta = identify(m, [series], y).theta
    given = EffectReadings(m, (series,), y, turned(rows, runs))
    estimate = given.estimate(EFFECTS, theta, estimate_noise=False)
    assert estimate is not None
    return estimate


@pytest.mark.parametrize(("seed", "runs"), [(0, ["80-1"]), (1, [])])
def test_turned_runs_are_named(seed, runs):
    result = corrected(seed, runs).turned_runs()
    if not runs:
        assert result is None
        return
    assert [run for _, run in result.runs] == runs
    assert result.after < 0.75 * result.before


def test_a_planar_machine_is_as_far_off_as_predicted():
    found = corrected_machines.coverage(corrected_cases.planar_case(), 2, 3)
    assert (np.abs(found.error) < 5.0 * found.sd).all()
    assert (found.ratio < 2.5).all()


@pytest.mark.parametrize(("name", "most"), [
    ("planar_2dof", 0), ("linear_delta", 0), ("a3_head", 0), ("a3_turning", 12),
])  # fmt: skip
def test_joints_arrive_in_the_sense_of_the_path(name, most):
    """As the oracle's path says, but where a leg stands almost still at its turn."""
    case = corrected_cases.CASES[name]()
    session, m = corrected_machines.planned(case), case.measurement
    y = m.readings([session.series], m.nominal)
    readings = EffectReadings(m, (session.series,), y, session.rows)
    (state,) = readings.problem(m.nominal).states
    read = session.series.index[:, 0]
    assert np.sum(state.motion_sign[read] != session.sense) <= most
