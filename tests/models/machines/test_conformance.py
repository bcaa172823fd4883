"""What every machine, and every machine x instrument, must do. Cases: kernel/cases.py."""

import math

import casadi as ca
import numpy as np
import pytest
from reference import parameter_names

from kernel.cases import CASES, PAIRS, Case, reading_series
from oed import units
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Coordinate

STEP = 2e-4  # m, rad or 1: finite differences


@pytest.fixture(params=CASES, scope="module")
def case(request: pytest.FixtureRequest) -> Case:
    return CASES[request.param]


@pytest.fixture(scope="module")
def kinematics(case: Case) -> Kinematics:
    return Kinematics(case.machine)


def named(items: tuple, values: np.ndarray) -> dict[str, float]:
    return {item.name: float(v) for item, v in zip(items, values, strict=True)}


def random_parameters(
    case: Case, rng: np.random.Generator, size: float = 1.0
) -> np.ndarray:
    spread = np.array([p.tolerance for p in case.machine.parameters])
    return case.machine.nominal + size * spread * rng.standard_normal(len(spread))


def test_names_and_their_order_are_frozen(case):
    machine = case.machine
    assert (
        tuple(p.name for p in machine.parameters) == parameter_names.NAMES[machine.name]
    )
    assert machine.frame == parameter_names.FRAME[machine.name]


def test_units_ranges_and_sources_are_stated(case):
    machine = case.machine
    coordinates: tuple[Coordinate, ...] = (
        machine.pose + machine.joints + machine.command
    )
    assert {
        c.unit for c in (*coordinates, *machine.components, *machine.parameters)
    } <= set(units.DISPLAY)
    assert all(
        math.isfinite(c.lower) and c.lower < c.upper < math.inf
        for c in machine.joints + machine.command
    )
    assert all(p.tolerance > 0 and p.about for p in machine.parameters)
    assert machine.source
    assert machine.about
    assert machine.lever > 0
    assert not machine.out_of_range(machine.home_command[None])


def test_there_are_as_many_equations_as_unknowns(case):
    machine = case.machine
    x, q, p = (
        dict.fromkeys(c.name for c in part)
        for part in (machine.pose, machine.joints, machine.parameters)
    )
    symbols = [{n: ca.SX.sym(n) for n in part} for part in (x, q, p)]
    assert len(machine.closure(*symbols)) >= len(x)
    assert len(machine.command) == len(
        machine.target({c.name: 0.1 for c in machine.command})
    )
    assert len(machine.components) == len(
        machine.read_error({c.name: 0.1 for c in machine.command}, [0.0] * 6)
    )


def test_inverse_closes_the_machine_where_it_was_commanded(case, kinematics, rng):
    machine, command = case.machine, case.commands(rng, 60)
    for p in (machine.nominal, random_parameters(case, rng, 3.0)):
        x, q = kinematics.inverse(command, p)
        for xi, qi, ci in zip(x, q, command, strict=True):
            pose = named(machine.pose, xi)
            gap = machine.closure(
                pose, named(machine.joints, qi), named(machine.parameters, p)
            )
            wanted = machine.target(named(machine.command, ci))
            reached = machine.commanded(pose, machine.platform(pose)[1])
            assert np.abs([float(g) for g in gap]).max() < 1e-14
            assert (
                np.abs(
                    [float(r) - float(w) for r, w in zip(reached, wanted, strict=True)]
                ).max()
                < 1e-14
            )


def test_forward_undoes_inverse(case, kinematics, rng):
    command = case.commands(rng, 200)
    for p in (case.machine.nominal, random_parameters(case, rng, 3.0)):
        x, q = kinematics.inverse(command, p)
        found = kinematics.forward(q, p, x + rng.uniform(-0.01, 0.01, x.shape))
        assert np.abs(found - x).max() < 1e-13


def test_joints_stay_in_their_range_over_the_workspace(case, kinematics, rng):
    command = case.commands(rng, 500)
    assert not case.machine.out_of_range(command)
    _, q = kinematics.inverse(command)
    for column, joint in zip(q.T, case.machine.joints, strict=True):
        assert joint.lower < column.min() <= column.max() < joint.upper


def test_the_workspace_is_far_from_singular_poses(case, kinematics, rng):
    x, q = kinematics.inverse(case.commands(rng, 500))
    assert (
        kinematics.slopes.reciprocal_condition(x, q, case.machine.nominal).min() > 0.05
    )


def test_a_pose_out_of_reach_is_named(case, kinematics, rng):
    command = np.insert(case.commands(rng, 8), 5, case.out_of_reach, axis=0)
    with pytest.raises(AssemblyError, match=f"{case.machine.name}: 1 of 9") as caught:
        kinematics.inverse(command)
    assert caught.value.indices.tolist() == [5]
    for c, value in zip(case.machine.command, case.out_of_reach[0], strict=True):
        assert f"{c.name} = {value:.6g} {c.unit}" in str(caught.value)


def test_joints_that_do_not_close_are_named(case, kinematics, rng):
    if len(case.machine.joints) > len(case.machine.command):
        pytest.skip(
            "a redundant machine settles at any joints, see"
            " tests/models/machines/test_cable_robot_real.py"
        )
    x, q = kinematics.inverse(case.commands(rng, 6))
    q[[2, 4], 1:3] += np.array([8.0, 24.0])[: q.shape[1] - 1]
    _, bad = kinematics.try_forward(q, case.machine.nominal, x)
    assert np.flatnonzero(bad).tolist() == [2, 4]
    with pytest.raises(
        AssemblyError, match=r"2 of 6 poses cannot be assembled \(pose numbers 2, 4\)"
    ) as caught:
        kinematics.forward(q, case.machine.nominal, x)
    assert caught.value.indices.tolist() == [2, 4]


def test_out_of_range_names_row_coordinate_and_limits(case):
    command = np.tile(case.machine.home_command, (3, 1))
    first = case.machine.command[0]
    command[1, 0] = first.upper + 0.01
    assert case.machine.out_of_range(command) == [
        (1, first.name, first.upper + 0.01, first.lower, first.upper)
    ]


@pytest.mark.parametrize(("name", "setup"), PAIRS)
def test_jacobian_is_the_slope_of_the_exact_readings(name, setup, rng):
    """30 random poses, at nominal and at a wrong machine, nuisances included. Central
    differences, extrapolated to fourth order; each column's error is told against its
    largest entry, of a hundred-thousandth of the largest of H at least. Readings round
    in their last digits: over the step, that is 3e-12.
    """
    case = CASES[name]
    m, series = reading_series(case, setup, rng, 30)
    assert len(series) == 30
    spread = np.array([p.tolerance for p in m.parameters])
    for theta in (m.nominal, m.nominal + spread * rng.standard_normal(len(spread))):
        moves = np.vstack(
            [f * np.eye(len(theta)) for f in (STEP, -STEP, STEP / 2, -STEP / 2)]
        )
        up, down, up_half, down_half = np.split(m.readings([series], theta + moves), 4)
        slope = (8.0 * (up_half - down_half) - (up - down)).T / (6.0 * STEP)
        h = m.jacobian([series], theta)
        largest = np.abs(h).max(axis=0)
        assert (
            np.abs(h - slope).max(axis=0)
            <= 1e-6 * np.maximum(largest, 1e-5 * largest.max())
        ).all()


@pytest.mark.parametrize(("name", "setup"), PAIRS)
def test_a_measurement_names_its_unknowns(name, setup, rng):
    case = CASES[name]
    m, series = reading_series(case, setup, rng, 20)
    nuisances = tuple(f"{setup}.{n}" for n in parameter_names.NUISANCES[setup])
    assert m.names == parameter_names.NAMES[name] + nuisances
    assert [n for n, f in zip(m.names, m.free, strict=True) if not f] == [
        n for n in m.names if n in parameter_names.FRAME[name]
    ]
    instrument = case.setups[setup].instrument
    assert {
        c.unit
        for c in (*instrument.channels, *instrument.settings, *instrument.nuisances)
    } <= set(units.DISPLAY)
    assert instrument.cost.setup > 0
    assert instrument.cost.reading > 0
    stated = [c.sigma * math.hypot(1.0, c.shared) for c in instrument.channels]
    found = m.sigma([series]).reshape(20, -1) / stated
    if instrument.sources is None:
        assert found == pytest.approx(np.ones_like(found))
    else:  # correlated inside: what is stated is the size, the place decides
        assert 0.1 < np.median(found) < 3.0


@pytest.mark.parametrize(("name", "setup"), PAIRS)
def test_many_machines_at_once_read_as_one_by_one(name, setup, rng):
    m, series = reading_series(CASES[name], setup, rng, 20)
    spread = np.array([p.tolerance for p in m.parameters])
    thetas = m.nominal + spread * rng.standard_normal((7, len(spread)))
    together = m.readings([series], thetas)
    assert together.shape == (7, 20 * len(m.setups[setup].instrument.channels))
    for row, theta in zip(together, thetas, strict=True):
        assert np.abs(m.readings([series], theta) - row).max() < 1e-14


@pytest.mark.parametrize(("name", "setup"), PAIRS)
def test_recorded_joints_give_the_same_readings(name, setup, rng):
    m, series = reading_series(CASES[name], setup, rng, 10)
    reads = series.q if m.setups[setup].teach is None else series.q[:-1]
    runs = (
        None
        if m.setups[setup].instrument.reference != "run"
        else [str(i // 6) for i in range(len(reads))]
    )
    recorded = m.series_from_joints(setup, reads, run=runs)
    theta = m.nominal + 0.5 * m.tolerance * rng.standard_normal(len(m.names))
    assert (
        np.abs(m.readings([recorded], theta) - m.readings([series], theta)).max()
        < 1e-13
    )
