"""Interpolation tables against the functions that they must reproduce."""

import itertools

import numpy as np
import pytest

from oed.base import grid_nodes
from oed.compensate.command_grid import InterpolationTable

KNOTS = (np.array([0.0, 1.0, 4.0]), np.array([-1.0, 2.0]), np.array([7.0]))


def bilinear(places: np.ndarray) -> np.ndarray:
    a, b = places[:, 0], places[:, 1]
    return np.column_stack([2.0 + a - 3.0 * b + a * b, 5.0 * b])


def test_nodes_are_the_product_of_the_knots():
    assert grid_nodes(KNOTS) == pytest.approx(np.array(list(itertools.product(*KNOTS))))


def test_a_bilinear_function_is_reproduced_and_its_border_holds():
    """Along an axis of one knot nothing varies."""
    nodes = grid_nodes(KNOTS)
    table = InterpolationTable(
        ("a", "b", "c"), KNOTS, bilinear(nodes).reshape(3, 2, 1, 2)
    )
    places = np.array([[0.3, 1.1, 7.0], [2.0, -0.5, -9.0], [9.0, 1.0, 7.0]])
    inside = np.clip(places, [0, -1, 7], [4, 2, 7])
    assert table.at(places) == pytest.approx(bilinear(inside))


def test_a_full_turn_goes_on():
    turn = np.linspace(0.0, 2.0 * np.pi, 5)
    table = InterpolationTable(
        ("psi",), (turn,), np.array([1.0, 3.0, 5.0, 2.0, 1.0])[:, None], (True,)
    )
    place = np.array([[0.25 * np.pi]])
    for turns in (-1, 0, 3):
        assert table.at(place + 2.0 * np.pi * turns) == pytest.approx(2.0)


def test_values_of_another_shape_and_descending_knots_are_refused():
    with pytest.raises(ValueError, match="needs values of that shape"):
        InterpolationTable(("a",), (np.arange(3.0),), np.zeros((2, 1)))
    with pytest.raises(ValueError, match="knots of a must ascend"):
        InterpolationTable(("a",), (np.array([1.0, 0.0]),), np.zeros((2, 1)))
