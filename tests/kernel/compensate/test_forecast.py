"""Forecast compensation of the gantry: strut motion, grids and what they leave."""

import dataclasses

import numpy as np
import pytest
from oracles import planar_geometry

from oed.compensate.error_field import Box, ErrorField, Kernel
from oed.compensate.forecast import (
    ForecastCompensator,
    check_forecast,
    forecast_from_field,
    forecast_from_nodes,
    predicted_residual,
    refined_knots,
    strut_motion,
)
from oed.compensate.table import InterpolationTable, grid_nodes
from oed.mechanism.kinematics import Kinematics
from pkm_models.machines import planar_2dof

PLANAR = Kinematics(planar_2dof.machine)
BOX = Box(("y", "z"), np.array([-1.0, 0.0]), np.array([1.0, 1.0]))
BEND, SD = 8e-3, 2e-6


class Parabola(ErrorField):
    """A field whose error is known: BEND y^2 along y, nothing along z."""

    def __init__(self) -> None:
        nothing = np.zeros((0, 2))
        kernel = Kernel("3/2", 1.0, np.ones(2))
        motion = strut_motion(PLANAR)
        super().__init__(BOX, motion, nothing, nothing, nothing, (kernel, kernel))

    def mean(self, places: np.ndarray) -> np.ndarray:
        return np.column_stack([BEND * places[:, 0] ** 2, np.zeros(len(places))])

    def sd(self, places: np.ndarray, reference: np.ndarray) -> np.ndarray:
        return np.full((len(places), 2), SD)


def test_a_longer_strut_moves_the_platform_as_differences_say() -> None:
    command = np.array([[0.2, 0.1], [-1.1, 0.9]])
    joints = planar_geometry.inverse(command)
    step, expected = 1e-6, np.zeros((2, 2, 2))
    for k in (0, 1):
        change = step * (np.arange(7) == 3 + k)
        ahead = planar_geometry.forward(joints, planar_geometry.NOMINAL + change)
        behind = planar_geometry.forward(joints, planar_geometry.NOMINAL - change)
        expected[:, :, k] = (ahead - behind) / (2.0 * step)
    assert strut_motion(PLANAR)(command) == pytest.approx(expected, abs=1e-8)


def test_errors_read_at_nodes_are_taken_off_against_the_reference() -> None:
    knots = (np.array([-1.0, 0.0, 1.0]), np.array([0.0, 1.0]))
    nodes = grid_nodes(knots)
    errors = np.column_stack([1e-3 * nodes[:, 0] * nodes[:, 1], 2e-3 + nodes[:, 1]])
    reference = np.array([0.5, 0.5])
    compensator = forecast_from_nodes(PLANAR, knots, errors.reshape(3, 2, 2), reference)
    command = np.array([[0.25, 0.8], [0.5, 0.5]])
    relative = np.array([[1e-3 * (0.2 - 0.25), 0.3], [0.0, 0.0]])
    assert compensator.error(command) == pytest.approx(relative, abs=1e-15)
    assert compensator.corrected(command) == pytest.approx(command - relative)
    (limit,) = compensator.limits(command)
    assert "same command" in limit


def test_knots_are_halved_until_a_parabola_is_met() -> None:
    """Between knots h apart a line is off by BEND h^2 / 4 at most."""
    y, z = refined_knots(Parabola(), np.full(2, 0.03e-3))
    # h = 1/8 leaves 0.031 mm, h = 1/16 leaves 0.008 mm
    assert np.diff(y) == pytest.approx(np.full(32, 1.0 / 16.0))
    assert z == pytest.approx([0.0, 1.0])


def test_spread_and_interpolation_add_in_squares() -> None:
    field, reference = Parabola(), np.zeros(2)
    empty = InterpolationTable(
        ("y", "z"), (np.array([-1.0, 1.0]), np.array([0.0, 1.0])), np.zeros((2, 2, 2))
    )
    left = predicted_residual(ForecastCompensator(PLANAR, empty), field, reference)
    # the mean of y^4 over -1..1 is 1/5, by the trapezium rule of 21 places 0.2033
    mean = np.mean(np.linspace(-1.0, 1.0, 21) ** 4)
    assert left == pytest.approx([np.sqrt(BEND**2 * mean + SD**2), SD])
    fine = forecast_from_field(PLANAR, field, reference, np.full(2, 1e-4))
    places, knots = np.linspace(-1.0, 1.0, 21), fine.table.knots[0]
    error = BEND * (places**2 - np.interp(places, knots, knots**2))
    expected = [np.sqrt(np.mean(error**2) + SD**2), SD]
    assert expected[0] > 5.0 * SD
    assert fine.predicted == pytest.approx(expected)
    assert len(fine.limits(reference[None])) == 2


def test_a_machine_whose_errors_are_not_its_commands_is_refused() -> None:
    machine = planar_2dof.machine
    check_forecast(machine)
    other = dataclasses.replace(machine, command=machine.command[::-1])
    with pytest.raises(ValueError, match="a grid of errors cannot be subtracted"):
        check_forecast(other)
