"""The third world: its physics against closed forms, its machines, one case."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.harness import diagnosis
from benchmarks.third import faults, physics, world
from benchmarks.third.machines import MACHINES, change, session

COULOMB, BRISTLE = 30.0, 1e6  # N, N/m


def test_friction_slides_steadily_and_springs_before_it_slides():
    time = np.linspace(0.0, 10.0, 200)
    for speed in (2e-3, -20e-3):
        force = physics.lugre(speed * time, time, np.array(COULOMB), BRISTLE, 50.0)
        steady = np.sign(speed) * physics.stribeck(speed, COULOMB) + 50.0 * speed
        assert force[-1] == pytest.approx(steady, rel=1e-12)
    creep = np.linspace(0.0, 1e-7, 50)
    force = physics.lugre(creep, np.linspace(0, 1e3, 50), np.array(COULOMB), BRISTLE)
    assert force[-1] == pytest.approx(BRISTLE * creep[-1], rel=2e-3)


def test_friction_is_the_solution_of_its_equation():
    def rate(t: float, z: np.ndarray) -> np.ndarray:
        speed = 6e-3 * np.cos(t)
        return speed - BRISTLE * abs(speed) * z / physics.stribeck(speed, COULOMB)

    time = np.linspace(0.0, 7.0, 20001)
    options = {"t_eval": time, "rtol": 1e-8, "atol": 1e-12}
    solution = solve_ivp(rate, (0.0, 7.0), [0.0], "LSODA", **options)
    force = physics.lugre(6e-3 * np.sin(time), time, np.array(COULOMB), BRISTLE)
    assert np.abs(force - BRISTLE * solution.y[0]).max() < 0.01 * COULOMB


def test_servo_answers_a_step_of_force_as_three_poles_do():
    time = np.linspace(0.0, 1.0, 20001)
    force = 10.0 * (time > 0.0)
    error = physics.servo_error(force, time, mass=40.0, bandwidth=12.0)
    exact = 10.0 * time**2 / (2 * 40.0) * np.exp(-12.0 * time)
    assert np.abs(error - exact).max() < 2e-3 * exact.max()


def test_play_is_taken_up_after_a_reversal():
    path = np.concatenate([np.arange(0, 30), np.arange(30, 0, -1)]) * 1e-6
    lag = physics.play(path, 5e-6)
    assert lag[20] == pytest.approx(-5e-6)
    assert lag[35] == pytest.approx(0.0, abs=1e-12)
    assert lag[-1] == pytest.approx(5e-6)


def test_heat_that_comes_in_is_stored_or_leaves():
    rng = np.random.default_rng(1)
    capacity, to_room = rng.uniform(5e2, 5e3, 4), np.array([1.0, 0.5, 0.0, 4.0])
    conductance = np.triu(rng.uniform(0.5, 3.0, (4, 4)), 1)
    conductance = conductance + conductance.T
    power, room = rng.uniform(0.0, 30.0, (3000, 4)), rng.normal(size=3000)
    rise = physics.network(capacity, conductance, to_room, power, room, 10.0)
    inwards = power + to_room * (room[:, None] - rise)
    assert capacity @ rise[-1] == pytest.approx(10.0 * inwards[1:].sum(), rel=1e-9)
    constant, still = np.tile(power[:1], (20000, 1)), np.zeros(20000)
    rise = physics.network(capacity, conductance, to_room, constant, still, 10.0)
    assert to_room @ rise[-1] == pytest.approx(power[0].sum(), rel=1e-6)


def test_a_loose_joint_is_in_equilibrium():
    load = np.linspace(-400.0, 400.0, 101)
    shift = physics.contact(load, 8e-6)
    assert physics.contact_force(shift, 8e-6, 3e9, 2e5) == pytest.approx(load)
    assert np.allclose(shift, -shift[::-1], atol=1e-14)
    assert np.all(np.diff(shift) > 0.0)


@pytest.mark.parametrize("number", range(3))
def test_geometry_alone_is_no_fault_here_and_in_the_toolkit(
    number, tmp_path, monkeypatch
):
    rng = np.random.default_rng(number)
    machine = MACHINES[number]()
    drawn_world = faults.world(session(machine, rng), rng)
    sight = world.Sight(drawn_world, "white", rng)
    legs = np.full((len(drawn_world.s.time), machine.legs), 5e-6)
    assert np.linalg.norm(sight.differences(change(drawn_world.s, legs=legs))) < 0.2
    label = {"machine": machine.name, "law": {"law": "white"}}
    drawn = sight, label, sight.read(change(drawn_world.s))
    monkeypatch.setattr(world, "drawn", lambda seed: drawn)
    case = world.draw({}, number, tmp_path)
    problem, _ = diagnosis.prepare(case.study, case.readings)
    fit = np.linalg.lstsq(problem.slopes, problem.residual, rcond=1e-9)[0]
    rest = problem.residual - problem.slopes @ fit
    assert np.abs(problem.residual).max() > 100.0
    assert np.abs(rest).max() < 1e-3


def test_size_of_a_fault_is_as_drawn():
    _, label, values = world.drawn(4)
    _, again, same = world.drawn(4)
    assert (label["kind"], label["machine"]) == ("single", "delta")
    assert label["sqrt_lambda_total"] == pytest.approx(20.0, rel=1e-3)
    assert label == again
    assert np.array_equal(values, same)
