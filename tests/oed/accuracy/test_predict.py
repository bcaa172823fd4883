"""Predicted residual accuracy: published figures, exact references, Monte Carlo errors."""

import dataclasses

import numpy as np
import pytest
from oracles import a3_geometry as a3
from reference import tian_2016 as paper
from scipy import stats
from scipy.spatial.transform import Rotation
from shipped_models import a3_head, ball_bar, planar_2dof, relative

from kernel import a3_plans
from oed import Measurement, identifiability, mount
from oed.acceptance import Promise
from oed.accuracy import (
    BudgetModel,
    ErrorMaps,
    Prediction,
    Spread,
    components_against,
    driven_errors,
    least_error,
    predict,
    prediction,
    relative_to_reference,
    variance_over_machines,
)
from oed.measurement import draw_parameters
from oed.mechanism import AssemblyError, ErrorModel, Kinematics, pose_error
from oed.result import CompensationName

ARCSEC = 180 * 3600 / np.pi
A3 = Kinematics(a3_head.machine)


@pytest.fixture(scope="module")
def passage() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Whitened H of the paper's 2 x 15 with a free cup, tolerances, posterior covariance."""
    machine = a3_plans.with_tolerances(
        {"dq": 1e-3, "db": 0.3e-3, "da": 0.3e-3, "beta": 5e-3}
    )
    m = a3_plans.measurement(taught=False, of=machine)
    series = a3_plans.circles(m, 15)
    h = identifiability.scaled(m, [series], m.nominal, "tolerance")
    return (
        h,
        m.tolerance,
        identifiability.posterior_covariance(h) * np.outer(m.tolerance, m.tolerance),
    )


def predicted(maps: ErrorMaps, passage: tuple, **options: object) -> Prediction:
    _, tolerance, covariance = passage
    prior = np.diag(tolerance[:24] ** 2)
    return predict(
        maps, prior, covariance[:24, :24], np.random.default_rng(1), **options
    )


def test_the_published_passage(passage):
    """x, y 55.4 um, z 86.1 um; 6.7 arcsec of the spindle's axis and 33.4 arcsec of spin."""
    command = a3_plans.workspace()
    told = predicted(ErrorMaps.of(A3, command, "home"), passage).fully_corrected
    for name, um in paper.HOME_REFERENCED_UM.items():
        assert 1e6 * told[name].rms == pytest.approx(um, rel=0.01)
    model = ErrorModel.of(A3, A3.machine.and_home(command, np.zeros(3)))
    frame = model.rotation, model.point, "home", A3.machine.lever
    errors = [
        relative_to_reference(1e-6 * model.raw[..., k], *frame) for k in range(24)
    ]
    turns = 1e6 * np.stack([e[:, 3:] for e in errors], axis=-1)
    own_axes = np.swapaxes(model.rotation[:-1], 1, 2) @ turns
    variance = np.einsum(
        "nip,pq,niq->ni", own_axes, passage[2][:24, :24], own_axes
    ).mean(axis=0)
    tilts_and_spin = ARCSEC * np.sqrt(variance)
    assert tilts_and_spin[:2] == pytest.approx(
        paper.HOME_REFERENCED_ARCSEC["axis"], rel=0.01
    )
    assert tilts_and_spin[2] == pytest.approx(
        paper.HOME_REFERENCED_ARCSEC["spin"], rel=0.01
    )


def test_home_referenced_slopes_are_the_oracles():
    """Derivatives of the exact Euler angles of a machine that was zeroed at home."""
    command = a3_plans.workspace()[::7]
    maps = ErrorMaps.of(A3, command, "home")
    q = a3.inverse_nominal(*command.T)
    home_q = a3.inverse_nominal(*A3.machine.home_command)
    tip, _ = a3.nominal_pose(*command.T)
    home_tip, home_rotation = a3.nominal_pose(*A3.machine.home_command)
    h = 1e-6
    for k in range(24):
        ends = []
        for step in (h, -h):
            real = a3.forward(step * np.eye(24)[k], q)
            home = a3.forward(step * np.eye(24)[k], home_q)
            zeroed = np.column_stack(a3.euler(real.R @ home.R.T @ home_rotation))
            ends.append(np.hstack([real.tip - tip - (home.tip - home_tip), zeroed]))
        slope = ends[0] - ends[1]
        slope[:, 3:] = np.angle(np.exp(1j * slope[:, 3:]))
        assert (
            np.abs(maps.raw[..., k] - slope / (2 * h)).max()
            < 1e-6 * np.abs(maps.raw).max()
        )


@pytest.mark.parametrize("reference", ["home", "absolute"])
def test_compensated_components_are_nulled(reference):
    maps = ErrorMaps.of(A3, a3_plans.workspace(), reference)
    assert maps.names == ("x", "y", "z", "psi", "theta", "phi")
    assert np.abs(maps.remaining[:, 2:5]).max() < 1e-12 * np.abs(maps.raw).max()
    assert np.abs(maps.remaining[:, [0, 1, 5]]).max() > 0.1


def test_the_absolute_error_is_the_papers_and_the_home_referenced_one_vanishes_at_home():
    """Beside home, as z-x-z angles have no slopes at theta = 0."""
    near_home = A3.machine.home_command[None] + [0.0, 0.4, 1e-3]
    home = ErrorMaps.of(A3, near_home, "home")
    absolute = ErrorMaps.of(A3, near_home, "absolute")
    assert np.abs(home.raw[:, :3]).max() < 3e-3 * np.abs(absolute.raw[:, :3]).max()
    assert absolute.raw == pytest.approx(
        A3.error_components_jacobian(near_home) @ a3.linear_model(*near_home.T),
        rel=1e-9,
    )


def test_best_fit_removes_any_rigid_motion():
    command = a3_plans.workspace()
    model = ErrorModel.of(A3, A3.machine.and_home(command, np.zeros(3)))
    rng = np.random.default_rng(3)
    shift, turn = rng.standard_normal(3), rng.standard_normal(3)
    rigid = np.hstack(
        [shift + np.cross(turn, model.point[:-1]), np.tile(turn, (len(command), 1))]
    )
    other = rng.standard_normal((len(command), 6))

    def fitted(twist: np.ndarray) -> np.ndarray:
        with_home = np.vstack([twist, other[:1]])
        frame = model.rotation, model.point, "best_fit", A3.machine.lever
        return relative_to_reference(with_home, *frame)

    assert np.abs(fitted(rigid)).max() < 1e-12
    assert fitted(other + rigid) == pytest.approx(fitted(other), abs=1e-12)
    weight = np.r_[np.ones(3), np.full(3, A3.machine.lever)]
    assert np.linalg.norm(fitted(other) * weight) <= np.linalg.norm(other * weight)
    assert np.linalg.norm(fitted(other) * weight) <= np.linalg.norm(
        (fitted(other) + 1e-3 * rigid) * weight
    )
    with_home = np.vstack([other, other[:1]])
    frame = model.rotation, model.point, "absolute", A3.machine.lever
    assert (relative_to_reference(with_home, *frame) == other).all()


def test_spreads_are_those_of_many_machines(passage):
    """Plan mode against 4000 machines: rms to 4 %, percentiles of its 400 draws to 12 %."""
    _, tolerance, covariance = passage
    maps = ErrorMaps.of(A3, a3_plans.workspace()[::5])
    told = predicted(maps, passage)
    rng, posterior = np.random.default_rng(4), covariance[:24, :24]
    prior = np.diag(tolerance[:24] ** 2)
    left = rng.multivariate_normal(np.zeros(24), posterior, 4000, method="eigh")
    found = rng.multivariate_normal(
        np.zeros(24), prior - posterior, 4000, method="eigh"
    )
    for key, moved in (
        ("before", maps.raw),
        ("after", maps.remaining),
        ("fully_corrected", 0.0 * maps.raw),
    ):
        errors = np.einsum("nkp,dp->dnk", maps.raw, left) + np.einsum(
            "nkp,dp->dnk", moved, found
        )
        for k, name in enumerate(maps.names):
            want, got = (Spread.of_errors(errors[..., k]), getattr(told, key)[name])
            assert got.rms == pytest.approx(want.rms, rel=0.04)
            assert (got.p95, got.largest) == pytest.approx(
                (want.p95, want.largest), rel=0.12
            )
            assert got.rms < got.p95 < got.largest
            ends = [
                (got.rms_interval, want.rms_interval),
                (got.p95_interval, want.p95_interval),
                (got.largest_interval, want.largest_interval),
            ]
            for (low, high), (wanted_low, wanted_high) in ends:
                assert high == pytest.approx(wanted_high, rel=0.15)
                assert low == pytest.approx(wanted_low, abs=0.05 * wanted_high)


def test_a_known_variance_replaces_that_of_the_maps(passage):
    maps = ErrorMaps.of(A3, a3_plans.workspace()[::5])
    plain = predicted(maps, passage)
    linear = plain.sd_after**2
    doubled = predicted(maps, passage, variance=4.0 * linear)
    for name, component in zip(maps.names, A3.machine.components, strict=True):
        if component.compensatable:
            assert doubled.after[name].rms == pytest.approx(2 * plain.after[name].rms)
            assert doubled.after[name].p95 == pytest.approx(2 * plain.after[name].p95)


def test_after_identification_known_errors_stay_where_they_are(passage):
    """Before = the estimate's error and the posterior's, after = what is not compensated."""
    maps = ErrorMaps.of(A3, a3_plans.workspace())
    mean = 1e-3 * np.random.default_rng(2).standard_normal(24)
    sure = predict(
        maps, np.eye(24), np.zeros((24, 24)), np.random.default_rng(1), mean=mean
    )
    for k, name in enumerate(maps.names):
        assert sure.before[name].rms == pytest.approx(
            np.sqrt(np.mean((maps.raw @ mean)[:, k] ** 2))
        )
        assert sure.after[name].rms == pytest.approx(
            np.sqrt(np.mean((maps.remaining @ mean)[:, k] ** 2)), abs=1e-15
        )
        assert sure.fully_corrected[name].rms == 0.0
        assert sure.after[name].largest == pytest.approx(
            np.abs((maps.remaining @ mean)[:, k]).max(), abs=1e-15
        )
    unsure, plan = predicted(maps, passage, mean=mean), predicted(maps, passage)
    for name in maps.names:
        assert unsure.fully_corrected[name].rms == plan.fully_corrected[name].rms
        assert unsure.after[name].rms ** 2 == pytest.approx(
            sure.after[name].rms ** 2 + plan.fully_corrected[name].rms ** 2
        )


def test_same_seed_same_prediction(passage):
    maps = ErrorMaps.of(A3, a3_plans.workspace()[::20])
    assert predicted(maps, passage).after == predicted(maps, passage).after


def test_spread_by_hand():
    errors = np.array([[3.0, -4.0], [0.0, 0.0]])
    spread = Spread.of_errors(errors)
    assert spread.rms == pytest.approx(2.5)
    assert spread.largest == pytest.approx(0.95 * 4.0)


def test_an_unknown_reference_is_refused():
    with pytest.raises(ValueError, match=r"reference 'bed' is none of .*home"):
        ErrorMaps.of(A3, a3_plans.workspace()[:1], "bed")


@pytest.mark.parametrize("per_unit", [1.0, ARCSEC, 1e-6])
def test_least_error_counts_components_alike_in_any_unit(per_unit):
    """0.5^2 + 1.1^2 < 1 + 1 < 0.1^2 + 1.5^2, in units of the errors with nothing sent."""

    def spreads(z: float, tilt: float, x: float) -> dict[str, Spread]:
        sizes = {"z": 2e-4 * z, "tilt": 3e-5 * per_unit * tilt, "x": x}
        return {name: Spread(size, size, size) for name, size in sizes.items()}

    nothing = spreads(1.0, 1.0, 0.1)
    mended = spreads(0.5, 1.1, 9.0)
    turned = spreads(0.1, 1.5, 0.0)
    both = {"turned": turned, "mended": mended}
    assert least_error(nothing, both, ["z", "tilt"]) == "mended"
    only = least_error(nothing, {"turned": turned}, ["z", "tilt"])
    assert only == CompensationName.NOTHING
    assert least_error(nothing, both, ["z", "tilt", "x"]) == "turned"


instrument = ball_bar.instrument
machine = a3_head.machine

COMMAND = np.array(
    [[1.10, 0.0, 0.2], [1.15, 2.1, 0.4], [1.20, 4.2, 0.5], [1.13, 5.0, 0.1]]
)


@pytest.fixture(scope="module")
def kinematics():
    cup = mount(instrument, "cup", length=0.3, teach=machine.home_command)
    return Measurement(machine, [cup]).kinematics


@pytest.fixture(scope="module")
def drawn() -> np.ndarray:
    """Parameters (6, np), SI, of machines that lose milliradians at home."""
    rng = np.random.default_rng(3)
    free = ~np.isin([p.name for p in machine.parameters], machine.frame)
    tolerance = np.array([p.tolerance for p in machine.parameters])
    return machine.nominal + 0.3 * tolerance * free * rng.standard_normal(
        (6, len(free))
    )


def composed(kinematics, parameters: np.ndarray) -> np.ndarray:
    """Errors (n, k) by rotations: R R_home^T against the commanded turn from home."""
    poses = np.vstack([COMMAND, machine.home_command])
    x, q = kinematics.inverse(poses)
    rotation, point, _ = kinematics.frames(x, np.zeros(3))
    reached = kinematics.forward(q, parameters, x)
    true_rotation, true_point, _ = kinematics.frames(reached, np.zeros(3))
    wanted, true = (Rotation.from_matrix(r) for r in (rotation, true_rotation))
    turned = (true[:-1] * true[-1].inv()) * (wanted[:-1] * wanted[-1].inv()).inv()
    shift = true_point - point
    twist = np.hstack([shift[:-1] - shift[-1], turned.as_rotvec()])
    return kinematics.error_components(COMMAND, twist)


def test_exact_errors_are_relative_rotations(kinematics, drawn):
    poses = np.vstack([COMMAND, machine.home_command])
    nominal = machine.nominal
    expected = np.array([composed(kinematics, p) for p in drawn])
    _, q = kinematics.inverse(poses)
    twists = np.array([pose_error(kinematics, poses, q, p) for p in drawn])
    against = components_against(kinematics, COMMAND, twists, "home")
    sent = [driven_errors(kinematics, COMMAND, p, "home") for p in drawn]
    alone = driven_errors(kinematics, COMMAND, drawn, "home", believed=nominal)
    held = np.tile(nominal, (len(drawn), 1))
    virtual = driven_errors(kinematics, COMMAND, drawn, "home", believed=held)
    for found in (against, sent, alone, virtual):
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-10)
    # vectors subtracted would be another error by half of it
    subtracted = twists[:, :-1] - twists[:, -1:]
    wrong = kinematics.error_components(
        np.tile(COMMAND, (len(drawn), 1)), subtracted.reshape(-1, 6)
    ).reshape(expected.shape)
    psi = [c.name for c in machine.components].index("psi")
    assert (
        np.abs(wrong - expected)[..., psi].max()
        > 0.5 * np.abs(expected)[..., psi].max()
    )


def test_limits_and_power_of_an_even_error_are_those_of_chi_squared(rng):
    """An error that is the same at all poses, of 2 um, read to 1 um at 6 of 10."""
    size, uncertainty, count = 2e-6, 1e-6, 6
    stated = {"rms": np.array([size]), "uncertainty": np.array([uncertainty])}
    promise = Promise(("z",), np.ones((10, 1, 1)), [np.eye(1)], **stated)
    plan = promise.limits_at(np.arange(count), rng, miss=1.5, false_alarm=0.1)
    at_promise, beyond = (
        stats.ncx2(count, count * (factor * size / uncertainty) ** 2)
        for factor in (1.0, 1.5)
    )
    limit = at_promise.isf(0.1)
    assert plan.limits[0] == pytest.approx(
        uncertainty * np.sqrt(limit / count), rel=0.01
    )
    assert plan.power[0] == pytest.approx(beyond.sf(limit), abs=0.02)
    assert plan.false_alarm == pytest.approx(0.1, abs=1e-3)


def test_machines_that_do_not_assemble_are_left_out(rng):
    """Against the maps about each machine that assembles at all commands."""
    wide = [
        dataclasses.replace(p, tolerance=20.0 * p.tolerance)
        for p in planar_2dof.machine.parameters
    ]
    machine = planar_2dof.machine.with_parameters(wide)
    m = Measurement(machine, [mount(relative.rm5, "ruler")])
    # 8 mm before the second strut is level; its length is known to 10 mm
    command = np.array([[1.55, 0.2], [0.5, 0.2]])
    series = [m.series("ruler", np.array([[0.0, 0.2], [0.5, 0.2]]), run=["a"] * 2)]
    seed = int(rng.integers(1000))
    drawn = variance_over_machines(
        m, series, command, ["home"], np.random.default_rng(seed)
    )["home"]
    variances = []
    for truth in draw_parameters(m, np.random.default_rng(seed), 48):
        p = truth[: len(machine.parameters)]
        try:
            raw = ErrorMaps.of(m.kinematics, command, "home", parameters=p).raw
            covariance = BudgetModel.of(m, series, truth).covariance()
        except AssemblyError:
            continue
        variances.append(np.einsum("nkp,pq,nkq->nk", raw, covariance, raw))
    assert 24 <= len(variances) < 48
    assert drawn == pytest.approx(np.mean(variances, axis=0), rel=1e-6)


MACHINES, POSES, SAMPLES = 2000, 5, 200


@pytest.mark.parametrize("share", [0.025, 0.5, 0.95])
def test_a_quantile_of_normal_numbers(share, rng):
    """sqrt(p (1 - p) / m) over the density, of David and Nagaraja 2003."""
    exact = np.sqrt(share * (1.0 - share) / MACHINES)
    exact /= stats.norm.pdf(stats.norm.ppf(share))
    drawn = [
        prediction.quantile(rng.standard_normal(MACHINES), share)
        for _ in range(SAMPLES)
    ]
    values, errors = np.array(drawn).T
    assert np.mean(errors) == pytest.approx(exact, rel=0.05)
    assert np.std(values) == pytest.approx(exact, rel=0.2)


def test_poses_of_one_machine_are_no_independent_draws(rng):
    """Errors of a machine that all its poses share: five poses count as one."""
    pooled, squares = [], []
    for _ in range(SAMPLES):
        errors = np.tile(rng.standard_normal((400, 1)), POSES)
        pooled.append(prediction.pooled_quantile(np.abs(errors), 0.95))
        squares.append(prediction.root_mean_square(errors))
    for drawn in (pooled, squares):
        values, errors = np.array(drawn).T
        assert np.mean(errors) == pytest.approx(np.std(values), rel=0.2)
    # rms of 400 normal numbers: sd 1 / sqrt(2 m)
    assert np.mean(np.array(squares)[:, 1]) == pytest.approx(800**-0.5, rel=0.05)


def test_draws_of_a_chain_are_worth_less(rng):
    values = rng.standard_normal(MACHINES)
    alone = prediction.quantile(values, 0.5)
    related = prediction.quantile(values, 0.5, worth=MACHINES / 4)
    assert related.value == alone.value
    assert related.error == pytest.approx(2.0 * alone.error, rel=0.2)


def test_every_drawn_figure_of_a_spread_has_its_error(rng):
    size = np.abs(rng.standard_normal((MACHINES, 1)))
    spreads = [
        Spread.of_errors(size * rng.standard_normal((MACHINES, POSES)))
        for _ in range(2)
    ]
    for name, errors in spreads[0].monte_carlo.items():
        first, second = (np.atleast_1d(getattr(s, name)) for s in spreads)
        assert len(errors) == len(first)
        assert (np.array(errors) > 0.0).all()
        assert (np.abs(first - second) < 5.0 * np.sqrt(2.0) * np.array(errors)).all()
    whole = Spread.of_errors(np.zeros((10, 3)))
    assert set(whole.monte_carlo.values()) == {(0.0,), (0.0, 0.0)}
