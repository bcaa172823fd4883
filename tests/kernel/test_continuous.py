"""Designs with free points: closed forms, brute force, finite differences, and the
20-factor problem.
"""

import casadi as ca
import numpy as np
import pytest
from scipy import optimize

from oed import criteria
from oed.design import continuous, smooth

V = ca.SX.sym("v", 1)
QUADRATIC = ca.Function("quadratic", [V], [ca.horzcat(1, V, V**2)])
PLANE = ca.SX.sym("w", 2)
#: two rows a point, neither affine
CURVED = ca.Function(
    "curved",
    [PLANE],
    [
        ca.vertcat(
            ca.horzcat(1, PLANE[0], PLANE[1], ca.sin(2 * PLANE[0]) * PLANE[1]),
            ca.horzcat(PLANE[1], ca.exp(PLANE[0]), 1, PLANE[0] * PLANE[1] ** 2),
        )
    ],
)
BOX = (np.array([-1.0, -1.0]), np.array([1.0, 1.0]))


def rng() -> np.random.Generator:
    return np.random.default_rng(3)


def quadratic(criterion: smooth.Smooth, size: int) -> continuous.Continuous:
    return continuous.optimise(
        QUADRATIC, [-1.0], [1.0], size, rng(), criterion, starts=5, rounds=20
    )


# -- closed forms ----------------------------------------------------------------------


@pytest.mark.parametrize("each", [1, 3])
def test_quadratic_d_optimum(each: int) -> None:
    """Equal numbers at -1, 0, 1: det M = 4 each^3."""
    found = quadratic(smooth.determinant(), 3 * each)
    assert np.sort(found.points[:, 0]) == pytest.approx(
        np.repeat([-1.0, 0.0, 1.0], each), abs=1e-5
    )
    assert found.value == pytest.approx(np.log(4.0 * each**3), abs=1e-9)


def test_quadratic_a_optimum() -> None:
    """A quarter at each end and half at 0: tr M^-1 = 8 / N (Pukelsheim 2006, section
    9.9).
    """
    found = quadratic(smooth.variance(), 8)
    assert np.sort(found.points[:, 0]) == pytest.approx(
        [-1, -1, 0, 0, 0, 0, 1, 1], abs=1e-5
    )
    assert found.value == pytest.approx(-np.log(8.0 / 8), abs=1e-9)


def test_extrapolation_c_optimum() -> None:
    """Straight line told at x0 = 2 from [-1, 1]: variance (x0^2 at the least) with 1/2
    (1 +- 1/x0) at the ends.
    """
    line = ca.Function("line", [V], [ca.horzcat(1, V)])
    c = np.array([1.0, 2.0])
    found = continuous.optimise(
        line, [-1.0], [1.0], 8, rng(), smooth.variance(np.outer(c, c)), rounds=20
    )
    assert np.sort(found.points[:, 0]) == pytest.approx(
        [-1, -1, 1, 1, 1, 1, 1, 1], abs=1e-6
    )
    assert found.value == pytest.approx(-np.log(4.0 / 8), abs=1e-9)


def test_ds_of_the_slope() -> None:
    """The slope of a line alone: as many at either end, information N."""
    line = ca.Function("line", [V], [ca.horzcat(1, V)])
    found = continuous.optimise(
        line, [-1.0], [1.0], 6, rng(), smooth.of_interest([[0.0], [1.0]]), rounds=20
    )
    assert found.value == pytest.approx(np.log(6.0), abs=1e-9)
    assert abs(found.points.sum()) < 1e-6


# -- the 20-factor problem -------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1])
def test_twenty_factors_in_thirty_runs(seed: int) -> None:
    """Above 70.77, which coordinate exchange on a grid reaches elsewhere; below (28^19)
    50 48, Ehlich and Wojtas.
    """
    v = ca.SX.sym("v", 20)
    rows = ca.Function("rows", [v], [ca.horzcat(1, v.T)])
    found = continuous.optimise(
        rows, -np.ones(20), np.ones(20), 30, np.random.default_rng(seed), rounds=150
    )
    x = np.column_stack([np.ones(30), found.points])
    assert np.abs(found.points).max() <= 1.0
    assert found.value == pytest.approx(np.linalg.slogdet(x.T @ x)[1], abs=1e-9)
    assert 70.77 <= found.value <= 19 * np.log(28) + np.log(50 * 48) + 1e-9
    again = continuous.optimise(
        rows, -np.ones(20), np.ones(20), 30, np.random.default_rng(seed), rounds=150
    )
    assert np.array_equal(found.points, again.points)


# -- against other ways to the same ----------------------------------------------------


def _criteria() -> dict[str, smooth.Smooth]:
    w = np.diag([1.0, 2.0, 0.0, 0.5])
    return {
        "D": smooth.determinant(),
        "A": smooth.variance(),
        "I": smooth.variance(w),
        "Ds": smooth.of_interest(
            np.array([[1.0, 0.2, 0.0, 0.0], [0.0, 0.0, 1.0, 3.0]]).T
        ),
        "power 1": smooth.power(1),
        "power 5": smooth.power(5),
    }


CRITERIA = _criteria()


def _direct(name: str, m: np.ndarray) -> float:
    """The definitions, as they are written."""
    inverse = np.linalg.inv(m)
    if name in ("D", "A"):
        return (
            float(np.log(np.linalg.det(m))) if name == "D" else -np.log(-criteria.a(m))
        )
    if name == "I":
        return -np.log(inverse[0, 0] + 2 * inverse[1, 1] + 0.5 * inverse[3, 3])
    if name == "Ds":
        k = CRITERIA["Ds"].interest
        return -float(np.log(np.linalg.det(k.T @ inverse @ k)))
    p = int(name.split()[1])
    return -float(np.log(np.trace(np.linalg.matrix_power(inverse, p)))) / p


@pytest.mark.parametrize("name", CRITERIA)
def test_values_slopes_and_expressions(name: str) -> None:
    criterion = CRITERIA[name]
    x = rng().standard_normal((9, 4))
    m = x.T @ x
    assert criterion.value(m) == pytest.approx(_direct(name, m), abs=1e-10)
    symbol = ca.SX.sym("m", 4, 4)
    assert float(
        ca.Function("f", [symbol], [criterion.expression(symbol)])(m)
    ) == pytest.approx(_direct(name, m))
    direction = rng().standard_normal((4, 4))
    direction = direction + direction.T
    step = 1e-5
    differences = (
        _direct(name, m + step * direction) - _direct(name, m - step * direction)
    ) / (2 * step)
    assert np.sum(criterion.slope(m) * direction) == pytest.approx(
        differences, rel=1e-6
    )


@pytest.mark.parametrize("name", CRITERIA)
def test_slopes_of_points(name: str) -> None:
    problem = continuous.Problem(CURVED, *BOX, CRITERIA[name], 0.1 * np.eye(4))
    points = problem.draw(5, rng())
    _, slope = problem.slope(points)
    for i, j in np.ndindex(points.shape):
        ends = [points.copy(), points.copy()]
        ends[0][i, j] += 1e-6
        ends[1][i, j] -= 1e-6
        values = [_direct(name, problem.information(e)) for e in ends]
        assert slope[i, j] == pytest.approx(
            (values[0] - values[1]) / 2e-6, rel=1e-5, abs=1e-7
        )


@pytest.mark.parametrize("name", CRITERIA)
def test_reaches_what_many_random_starts_reach(name: str) -> None:
    """Another solver, without our slopes, from ten starts."""
    prior = 0.05 * np.eye(4)
    found = continuous.optimise(
        CURVED, *BOX, 4, rng(), CRITERIA[name], prior, starts=5, rounds=30
    )
    problem = continuous.Problem(CURVED, *BOX, CRITERIA[name], prior)

    def cost(z: np.ndarray) -> float:
        return -_direct(name, problem.information(z.reshape(4, 2)))

    starts = rng().uniform(-1, 1, (10, 8))
    best = max(
        -optimize.minimize(cost, z, bounds=[(-1, 1)] * 8, method="L-BFGS-B").fun
        for z in starts
    )
    assert found.value >= best - 1e-6
    assert found.stationary
    assert found.value > found.start


@pytest.mark.parametrize("name", ["D", "I", "Ds"])
def test_one_sweep_takes_the_best_end_of_each_coordinate(name: str) -> None:
    """Affine rows: the compiled sweep against plain trial of both ends with M formed
    anew each time.
    """
    v = ca.SX.sym("v", 3)
    rows = ca.Function("rows", [v], [ca.horzcat(1, v[0], v[1], v[2] + v[0] * v[1])])
    lower, upper = np.array([-1.0, 0.0, -2.0]), np.array([1.0, 3.0, 1.0])
    problem = continuous.Problem(rows, lower, upper, CRITERIA[name])
    points = problem.draw(6, rng())
    m = problem.information(points)
    inverse = np.linalg.inv(m)
    sweep = continuous.Sweep(problem.rows, lower, upper, 6, CRITERIA[name], 5)
    assert sweep.straight
    moved = sweep(inverse, CRITERIA[name].partner(m, inverse), points, rng())
    expected = points.copy()
    for i, j in np.ndindex(points.shape):
        trials = []
        for value in (expected[i, j], lower[j], upper[j]):
            expected[i, j] = value
            trials.append((_direct(name, problem.information(expected)), value))
        expected[i, j] = max(trials)[1]
    assert moved == pytest.approx(expected, abs=1e-12)


# -- polish ----------------------------------------------------------------------------


def test_polish_is_never_worse() -> None:
    problem = continuous.Problem(CURVED, *BOX)
    for seed in range(5):
        start = problem.draw(4, np.random.default_rng(seed))
        found = continuous.polish(CURVED, start, *BOX)
        assert found.value > problem.value(start)
        assert problem.feasible(found.points)
        again = continuous.polish(CURVED, found.points, *BOX)
        assert found.value <= again.value <= found.value + 1e-6


def test_constraints_are_kept_and_bind() -> None:
    """In the unit disc, a plane through three points: the largest triangle is the
    equilateral one on the rim.
    """
    plane = ca.Function("plane", [PLANE], [ca.horzcat(1, PLANE.T)])
    disc = ca.Function("disc", [PLANE], [ca.sumsqr(PLANE) - 1])
    found = continuous.optimise(
        plane, *BOX, 3, rng(), constraints=disc, starts=5, rounds=20
    )
    assert np.linalg.norm(found.points, axis=1).max() <= 1 + 1e-9
    assert found.value == pytest.approx(2 * np.log(3 * np.sqrt(3) / 2), abs=1e-6)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"upper": [-1.0]}, "lower < upper"),
        ({"upper": [np.inf]}, "finite"),
        ({"upper": [1.0, 1.0], "lower": [0.0, 0.0]}, "the box has 2"),
        ({"size": 2}, "cannot determine"),
        ({"constraints": ca.Function("never", [V], [V + 2])}, "keeps the constraints"),
    ],
)
def test_what_cannot_be_is_told(change: dict, told: str) -> None:
    given = {
        "rows": QUADRATIC,
        "lower": [-1.0],
        "upper": [1.0],
        "size": 3,
        "rng": rng(),
    }
    with pytest.raises(ValueError, match=told):
        continuous.optimise(**{**given, **change})


def test_polish_refuses_a_start_outside() -> None:
    with pytest.raises(ValueError, match="leaves its box"):
        continuous.polish(QUADRATIC, np.array([[-2.0], [0.0], [1.0]]), [-1.0], [1.0])
