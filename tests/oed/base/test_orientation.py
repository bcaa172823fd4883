"""Angles and rotations of an orientation, against matrices multiplied in their order."""

import numpy as np
import pytest
import stated_order

from oed.base import Orientation

ORDERS = [
    Orientation.rotation(("x", "a"), ("y", "b"), ("z", "c")),
    Orientation.rotation(("z", "a"), ("y", "b"), ("x", "c")),
    Orientation.tilt_and_spin("a", "b", "c"),
    Orientation.direction(("x", "a"), ("y", "b")),
    Orientation.direction(("z", "a"), ("x", "b")),
    Orientation.tilt("a", "b"),
]


@pytest.mark.parametrize("stated", ORDERS, ids=lambda o: o.formula)
def test_angles_and_rotations_undo_each_other(stated, rng):
    angles = {n: rng.uniform(-0.9, 0.9, 20) for n in stated.names}
    if stated.axis_only and stated.factors[0][0] == "z":
        angles["b"] = np.abs(angles["b"])  # a nutation
    matrices = stated.matrices(angles)
    one = stated_order.rotation(stated, {n: v[3] for n, v in angles.items()})
    assert matrices[3] == pytest.approx(one, abs=1e-14)
    back = stated.angles(matrices)
    for name, values in angles.items():
        assert back[name] == pytest.approx(values, abs=1e-12)
    assert stated.angles(np.eye(3)[None])  # regular where nothing is turned


def test_a_product_without_an_inverse_says_so():
    stated = Orientation.rotation(("z", "a"), ("x", "b"), ("z", "c"))
    with pytest.raises(ValueError, match="has no inverse"):
        stated.angles(np.eye(3)[None])
