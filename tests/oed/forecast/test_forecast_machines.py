"""Forecast compensation of machines that are simulated without the toolkit.

Nodes are planned, read with noise and fitted; the table then acts on the simulated
machine. What is left is as predicted, within a factor of 1.2.
"""

import numpy as np
import pytest
from oracles import forecast_machines
from oracles.forecast_machines import PLANAR
from shipped_models import planar_2dof

from oed.compensate import GridAxis, joint_motion
from oed.forecast.error_field import JointErrors, design_nodes, expected_kernel
from oed.mechanism import Kinematics

#: noise of a length and of an angle, m and rad; expected joint errors, m
LENGTH, ANGLE, EXPECTED = 2e-6, 5e-6, 50e-6
FACTOR = 1.2
MACHINE = planar_2dof.machine


def forecast(simulated, rng):
    """Compensation planned, read and fitted at 40 nodes."""
    kinematics, kind, count = Kinematics(MACHINE), simulated.kind, 40
    places = rng.uniform(kind.low, kind.high, (200, len(kind.low)))
    model = JointErrors(
        kinematics, places, "home", np.zeros((len(MACHINE.parameters), 0))
    )
    sigma = np.array([LENGTH if c.unit == "m" else ANGLE for c in model.driven])
    candidates = rng.uniform(kind.low, kind.high, (150, len(kind.low)))
    ends = rng.random(candidates.shape) < 0.5  # edges matter
    edge = np.where(rng.random(candidates.shape) < 0.5, kind.low, kind.high)
    candidates = np.where(ends, edge, candidates)
    kernel = expected_kernel(EXPECTED, model.home_place.shape[0])
    nothing = np.full(len(sigma), np.nan)
    design = design_nodes(model, candidates, count, kernel, sigma, nothing)
    nodes = candidates[design.indices]
    read = simulated.errors(nodes) + sigma * rng.standard_normal((count, len(sigma)))
    field = model.fit(nodes, read, np.broadcast_to(sigma, read.shape))
    axes = tuple(
        GridAxis(c.name, c.unit, low, high, c.name == "psi")
        for c, low, high in zip(MACHINE.command, kind.low, kind.high, strict=True)
    )
    table = field.forecast(lambda c: np.zeros((len(c), len(sigma))), axes, 5000, rng)
    return table, table.table


def test_the_oracle_is_the_machine(rng):
    """Joints of the controller, and the effect of joint errors on errors against home."""
    kinematics = Kinematics(MACHINE)
    command = rng.uniform(PLANAR.low, PLANAR.high, (4, len(PLANAR.low)))
    joints = kinematics.inverse(command)[1]
    assert joints == pytest.approx(PLANAR.joints(command), abs=1e-9)
    simulated = forecast_machines.draw(PLANAR, rng)
    added = 1e-6 * rng.standard_normal(joints.shape)
    change = simulated.errors(command, added) - simulated.errors(command)
    motion = joint_motion(kinematics, command)
    expected = np.einsum("nkq,nq->nk", motion, added)
    assert change == pytest.approx(expected, rel=0.02, abs=1e-7)


def test_what_is_left_is_as_predicted():
    """Realised over predicted rms of two machines, each component in its own unit."""
    predicted, realised = [], []
    for seed in range(2):
        rng = np.random.default_rng(seed)
        simulated = forecast_machines.draw(PLANAR, rng)
        made, table = forecast(simulated, rng)
        places = rng.uniform(PLANAR.low, PLANAR.high, (300, len(PLANAR.low)))
        before = simulated.errors(places)
        after = simulated.errors(places, table.at(places))
        assert (np.mean(after**2, axis=0) < 0.06 * np.mean(before**2, axis=0)).all()
        predicted.append(made.predicted**2)
        realised.append(np.mean(after**2, axis=0))
    left = np.sqrt(np.mean(realised, axis=0) / np.mean(predicted, axis=0))
    assert np.sqrt(np.mean(left**2)) < FACTOR
    assert left.max() < 1.5  # two machines are few for one component
