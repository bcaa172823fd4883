"""Modes of smooth curves and fields, and angles of orientations, by other formulas."""

import numpy as np
import pytest
import stated_order
from scipy import special

from oed.base import Orientation, smooth_basis

NODES, WEIGHTS = np.polynomial.legendre.leggauss(60)


def _matern(reach: float) -> np.ndarray:
    return _correlation(np.abs(NODES[:, None] - NODES), reach)


def _correlation(way: np.ndarray, reach: float) -> np.ndarray:
    """Matern's correlation of smoothness 3/2 from its definition by a Bessel function."""
    way = np.sqrt(3.0) * way / reach
    safe = np.where(way > 0.0, way, 1.0)
    half = 2.0 ** (1.0 - 1.5) / special.gamma(1.5) * safe**1.5 * special.kv(1.5, safe)
    return np.where(way > 0.0, half, 1.0)


def _curves(reach: float, count: int, straight: int) -> np.ndarray:
    how = {"correlation_length": reach, "count": count, "detrend": straight}
    return np.column_stack(
        [smooth_basis.curve_mode(NODES, k, **how) for k in range(count)]
    )


@pytest.mark.parametrize("reach", [0.2, 0.5])
@pytest.mark.parametrize("straight", [0, 1, 2])
def test_modes_have_the_covariance_of_the_curve(reach, straight):
    made, lines = _curves(reach, 60, straight), np.vander(NODES, straight)
    inner = lines.T @ (WEIGHTS[:, None] * lines)
    left = np.eye(len(NODES)) - lines @ np.linalg.solve(inner, lines.T * WEIGHTS)
    wanted, inside = left @ _matern(reach) @ left.T, np.abs(NODES) < 0.95
    assert (made @ made.T)[inside][:, inside] == pytest.approx(
        wanted[inside][:, inside], abs=0.01
    )


@pytest.mark.parametrize("straight", [0, 1, 2])
def test_modes_are_orthogonal_the_largest_first(straight):
    made = _curves(0.5, 8, straight)
    inner = made.T @ (WEIGHTS[:, None] * made)
    assert np.abs(inner - np.diag(np.diag(inner))).max() < 2e-3
    assert (np.diff(np.diag(inner)) < 0.0).all()
    straight_part = np.vander(NODES, straight).T @ (WEIGHTS[:, None] * made)
    assert np.abs(straight_part).max(initial=0.0) < 1e-3


def test_a_curve_stays_as_it_is_beyond_its_span():
    ends = smooth_basis.curve_mode(
        np.array([-5.0, -1.0, 1.0, 5.0]), 0, correlation_length=0.5, count=4
    )
    assert ends[0] == ends[1]
    assert ends[2] == ends[3]


@pytest.mark.parametrize("reach", [0.3, 0.8])
def test_a_field_has_the_covariance_between_its_places_and_is_the_same_in_the_same_place(
    reach, rng
):
    there = rng.uniform(-1.0, 1.0, (40, 3))
    places = np.vstack([there, there[::-1]])  # there and back
    made = smooth_basis.field_modes(
        places, correlation_length=reach, energy_share=1.0, count=1000
    )
    far = np.linalg.norm(places[:, None] - places, axis=-1)
    assert made @ made.T == pytest.approx(_correlation(far, reach), abs=1e-6)
    assert made[:40] == pytest.approx(made[:39:-1])
    assert made.shape[1] <= 40


def test_a_field_is_told_by_as_few_modes_as_hold_its_share(rng):
    places = rng.uniform(-1.0, 1.0, (60, 2))
    limits = [
        {"energy_share": s, "count": c} for s, c in ((1.0, 99), (0.9, 99), (0.9, 3))
    ]
    modes = [
        smooth_basis.field_modes(places, correlation_length=0.8, **d) for d in limits
    ]
    every, some, few = modes
    told = np.cumsum(np.square(every).sum(axis=0)) / 60.0
    assert told[some.shape[1] - 1] >= 0.9 > told[some.shape[1] - 2]
    assert some == pytest.approx(every[:, : some.shape[1]])
    assert few == pytest.approx(every[:, :3])


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
