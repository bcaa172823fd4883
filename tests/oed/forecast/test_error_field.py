"""Fields of errors and error rows of joints, against dense conditioning and closed forms."""

import dataclasses
import itertools

import numpy as np
import pytest
from oracles import a3_geometry, planar_geometry
from scipy import special
from scipy.stats import multivariate_normal
from shipped_models import a3_head, planar_2dof

from oed.forecast import JointErrors
from oed.forecast.error_field import (
    TREND_SIZE,
    ErrorField,
    ErrorRows,
    Kernel,
    design_nodes,
    expected_kernel,
    joint_size,
)
from oed.mechanism import Kinematics

PLANAR = Kinematics(planar_2dof.machine)
LOW, HIGH = np.array([-1.2, 0.0]), np.array([1.2, 1.5])
SIGMA = np.array([1e-6, 3e-6])


def model(rng: np.random.Generator, count: int = 60) -> JointErrors:
    return JointErrors(
        PLANAR, rng.uniform(LOW, HIGH, (count, 2)), "home", np.zeros((7, 0))
    )


def bent(command: np.ndarray) -> np.ndarray:
    """Errors (n, 2), m, that are 0 at home."""
    y, z = command.T
    return 1e-5 * np.column_stack([np.sin(2.0 * y) + y * z, 1.0 - np.cos(y) + z**2])


def some(rows: ErrorRows, index: np.ndarray) -> ErrorRows:
    fields = ("positions", "local", "at_home", "by_parameter")
    return ErrorRows(*(getattr(rows, name)[index] for name in fields))


def read_field(rng: np.random.Generator, nodes: int = 20) -> ErrorField:
    command = rng.uniform(LOW, HIGH, (nodes, 2))
    noise = SIGMA * rng.standard_normal((nodes, 2))
    sigma = np.broadcast_to(SIGMA, (nodes, 2))
    return model(rng).fit(command, bent(command) + noise, sigma)


@pytest.mark.parametrize(("order", "nu"), [("3/2", 1.5), ("5/2", 2.5)])
def test_a_kernel_is_materns(order, nu, rng):
    length = np.array([0.5, 2.0])
    first, second = rng.uniform(-1, 1, (4, 2)), rng.uniform(-1, 1, (6, 2))
    distance = np.array(
        [[np.linalg.norm((a - b) / length) for b in second] for a in first]
    )
    scaled = np.sqrt(2.0 * nu) * distance
    bessel = 2 ** (1 - nu) / special.gamma(nu) * scaled**nu * special.kv(nu, scaled)
    covariance = Kernel(order, 3.0, length).covariance(first, second)
    assert covariance == pytest.approx(9.0 * bessel, rel=1e-12)
    assert expected_kernel(3e-6, 2).covariance(first, first)[0, 0] == pytest.approx(
        9e-12
    )


def dense(field: ErrorField, command: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the errors, from the joint errors at all places at once."""
    model, kernel = field.model, field.kernel
    readings = len(field.rows.positions)
    rows = model.rows(command)
    places = np.vstack([field.rows.positions, rows.positions, model.home_place[None]])
    among = kernel.covariance(places, places)
    among += field.prior.trend**2 * (1.0 + places @ places.T)
    count = len(places)
    joints = np.kron(among, np.eye(2))  # two joints at each place
    effect = np.zeros((count - 1, 2, count, 2))
    for n in range(count - 1):
        source, row = (field.rows, n) if n < readings else (rows, n - readings)
        effect[n, :, n] = source.local[row]
        effect[n, :, -1] += source.at_home[row]
    effect = effect.reshape(2 * (count - 1), -1)
    whole = effect @ joints @ effect.T
    zero = field.prior.noise * field.rows.at_home.reshape(2 * readings, 2)
    head = slice(0, 2 * readings)
    noise = zero @ zero.T + np.diag(field.sigma**2)
    gain = whole[2 * readings :, head] @ np.linalg.inv(whole[head, head] + noise)
    covariance = (
        whole[2 * readings :, 2 * readings :] - gain @ whole[head, 2 * readings :]
    )
    return gain @ field.errors, covariance


def test_a_field_is_conditioned_on_its_readings(rng):
    field = read_field(rng)
    command = rng.uniform(LOW, HIGH, (4, 2))
    mean, covariance = dense(field, command)
    assert field.mean(command).ravel() == pytest.approx(mean, abs=1e-9)
    assert field.covariance(command) == pytest.approx(covariance, abs=1e-15)
    home = field.covariance(np.zeros((1, 2)))
    assert np.sqrt(np.abs(np.diag(home))) == pytest.approx([0.0, 0.0], abs=1e-8)


def test_noise_of_a_node_is_not_copied(rng):
    """One node in 41 that is off by five times its noise: the field follows half of it."""
    command = rng.uniform(LOW, HIGH, (41, 2))
    errors, sigma = bent(command), np.broadcast_to(SIGMA, (41, 2))
    plain = model(rng).fit(command, errors, sigma)
    errors[7] += 5.0 * SIGMA
    moved = dataclasses.replace(plain, errors=errors.ravel())
    change = (moved.mean(command) - plain.mean(command))[7]
    assert (np.abs(change) < 2.5 * SIGMA).all()
    assert (change > 0.0).all()


def test_left_out_nodes_are_predicted_by_the_others(rng):
    field = read_field(rng)
    residual, sd = (values.ravel()[field.read] for values in field.left_out())
    keep = np.arange(len(field.errors)) // 2 != 3
    others, rows = some(field.rows, keep[::2]), some(field.rows, np.array([3]))

    def covariance(first: ErrorRows, second: ErrorRows) -> np.ndarray:
        zeros = field.prior.zero(first) @ field.prior.zero(second).T
        return field.prior.variance(field.kernel, first, second) + zeros

    among = covariance(others, others) + np.diag(field.sigma[keep] ** 2)
    predicted = covariance(rows, others) @ np.linalg.solve(among, field.errors[keep])
    assert residual[6:8] == pytest.approx(field.errors[6:8] - predicted, abs=1e-10)
    assert (sd[6:8] > field.sigma[6:8]).all()


def test_repeats_are_averaged_and_gaps_passed_over(rng):
    command = rng.uniform(LOW, HIGH, (15, 2))
    errors = bent(command)
    sigma = np.broadcast_to(SIGMA, errors.shape)
    errors[0, 1] = np.nan
    field = model(rng).fit(command, errors, sigma)
    assert len(field.errors) == 29
    twice = np.vstack([command, command])
    more = field.model.fit(
        twice, np.vstack([errors, errors]), np.vstack([sigma, sigma])
    )
    at = np.sqrt(np.diag(field.covariance(command)))
    twofold = np.sqrt(np.diag(more.covariance(command)))
    assert 0.65 < np.median(twofold / at) < 0.95


def test_no_kernel_of_a_grid_is_more_probable(rng):
    field = read_field(rng, 14)

    def log_posterior(kernel: Kernel) -> float:
        rows = field.rows
        covariance = field.prior.variance(kernel, rows, rows)
        zero = field.prior.zero(rows)
        covariance = covariance + zero @ zero.T + np.diag(field.sigma**2)
        scale = 1e6
        likelihood = multivariate_normal(
            np.zeros(len(covariance)), covariance * scale**2
        ).logpdf(field.errors * scale)
        return float(likelihood - 0.5 * np.sum(np.log(kernel.length) ** 2))

    lengths = np.geomspace(0.3, 8.0, 8)
    sizes = field.kernel.size * np.geomspace(0.1, 10.0, 9)
    grid = itertools.product(("3/2", "5/2"), sizes, lengths, lengths)
    best = max(log_posterior(Kernel(o, s, np.array([a, b]))) for o, s, a, b in grid)
    assert best - 1e-3 <= log_posterior(field.kernel)
    sigma = np.broadcast_to(SIGMA, (3, 2))
    with pytest.raises(ValueError, match="3 nodes are too few: read 4 or more"):
        field.model.fit(np.eye(3, 2), np.zeros((3, 2)), sigma)


def test_a_design_predicts_what_dense_conditioning_says(rng):
    """The modes represent 99.9 % of the field, so predictions are that near."""
    lattice = np.array([(y, z) for y in (-1.2, 0.0, 0.7, 1.2) for z in (0.0, 0.8, 1.5)])
    errors = model(rng, 40)
    rows = errors.rows(errors.command)
    size = joint_size(rows, np.full((40, 2), 40e-6))
    kernel = expected_kernel(size, 2)
    nothing = np.full(2, np.nan)
    design = design_nodes(errors, lattice, 8, kernel, SIGMA, nothing)
    assert len(design.indices) == 8
    chosen = lattice[design.indices]
    read = errors.rows(chosen)
    noise = joint_size(errors.rows(np.vstack([lattice, errors.command])), SIGMA[None])
    field = read_field(rng)
    prior = type(field.prior)(errors.home_place, TREND_SIZE * size, noise)
    order, sigma = np.arange(16), np.tile(SIGMA, 8)
    field = ErrorField(
        errors, read, order, order // 2, np.zeros(16), sigma, kernel, prior
    )
    _, covariance = dense(field, errors.command)
    expected = np.sqrt(np.diag(covariance).reshape(-1, 2).mean(axis=0))
    assert design.predicted == pytest.approx(expected, rel=0.03)
    enough = design_nodes(errors, lattice, 12, kernel, SIGMA, design.predicted * 1.01)
    assert len(enough.indices) <= 8


PLANAR_MACHINE, HEAD = Kinematics(planar_2dof.machine), Kinematics(a3_head.machine)
COMMAND = np.array([[0.2, 0.1], [-1.1, 0.9], [1.3, 1.2]])
NOTHING = np.zeros((7, 0))


def longer(command: np.ndarray, k: int) -> np.ndarray:
    """Motion of the platform per excess length of strut k, by differences."""
    joints, step = planar_geometry.inverse(command), 1e-6
    change = step * (np.arange(7) == 3 + k)
    ahead = planar_geometry.forward(joints, planar_geometry.NOMINAL + change)
    behind = planar_geometry.forward(joints, planar_geometry.NOMINAL - change)
    return (ahead - behind) / (2.0 * step)


def test_a_longer_strut_moves_the_platform_here_and_less_at_home():
    rows = JointErrors(PLANAR_MACHINE, COMMAND, "home", NOTHING).rows(COMMAND)
    for k in (0, 1):
        assert rows.local[:, :, k] == pytest.approx(longer(COMMAND, k), abs=1e-7)
        at_home = longer(np.zeros((3, 2)), k)
        assert rows.at_home[:, :, k] == pytest.approx(-at_home, abs=1e-7)
    absolute = JointErrors(PLANAR_MACHINE, COMMAND, "absolute", NOTHING).rows(COMMAND)
    assert absolute.local == pytest.approx(rows.local)
    assert not absolute.at_home.any()


def test_parameters_are_known_by_their_standard_deviations():
    spread = np.zeros((7, 1))
    spread[0] = 2e-6  # the distance of the columns
    rows = JointErrors(PLANAR_MACHINE, COMMAND, "home", spread).rows(COMMAND)
    slopes = planar_geometry.rows(COMMAND) - planar_geometry.rows(np.zeros(2))
    assert rows.by_parameter[:, :, 0] == pytest.approx(
        2e-6 * slopes[:, :, 0], abs=1e-12
    )


def test_places_go_round_and_fill_minus_one_to_one(rng):
    low, high = [1.066, 0.0, 0.1], [1.266, 2.0 * np.pi, 0.6]
    model = JointErrors(
        HEAD, rng.uniform(low, high, (50, 3)), "home", np.zeros((24, 0))
    )
    places = model.positions(model.command)
    assert places.min(axis=0) == pytest.approx([-1.0] * 3)
    assert places.max(axis=0) == pytest.approx([1.0] * 3)
    ends = model.positions(np.array([[1.1, 0.0, 0.3], [1.1, 2.0 * np.pi, 0.3]]))
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)
    # distances among places are those of the oracle's joints, each axis over its span
    joints = a3_geometry.inverse_nominal(*model.command.T)
    span = np.linalg.svd(joints - joints.mean(axis=0), full_matrices=False)[2]
    along = joints @ span.T
    scaled = 2.0 * along / np.ptp(along, axis=0)
    differences = np.abs(places - places[0])
    assert differences == pytest.approx(np.abs(scaled - scaled[0]), abs=1e-9)


def test_psi_of_an_upright_tool_has_no_meaning():
    model = JointErrors(HEAD, np.array([[1.1, 0.0, 0.3]]), "home", np.zeros((24, 0)))
    command = np.array([[1.1, 0.0, 0.3], [1.1, 0.0, 0.0]])
    meaningful = model.meaningful(command)
    assert meaningful.tolist() == [[True] * 3, [True, False, True]]
