"""Micro-CMM: closed form, closure and an oracle agree; the paper's closed forms do not;
what readings can see.
"""

import numpy as np
import pytest
from oracles import micro_cmm_geometry as oracle
from shipped_models import ball_plate, camera

from oed.accuracy import ErrorMaps
from oed.base import Array
from oed.identifiability import Assessment
from oed.instrument import Setup, mount
from oed.measurement import Measurement
from oed.mechanism import Kinematics
from pkm_models.machines import micro_cmm

MACHINE = micro_cmm.machine
KINEMATICS = Kinematics(MACHINE)
RHO = micro_cmm.R_FRAME - micro_cmm.R_PLATFORM


def grid(nx: int, nz: int) -> Array:
    """Positions over the whole workspace, (n, 3)."""
    ranges = [
        np.linspace(c.lower, c.upper, n)
        for c, n in zip(MACHINE.command, (nx, nx, nz), strict=True)
    ]
    return np.column_stack([m.ravel() for m in np.meshgrid(*ranges, indexing="ij")])


def random_machines(rng: np.random.Generator, n: int) -> Array:
    tolerance = np.array([p.tolerance for p in MACHINE.parameters])
    return MACHINE.nominal + 3.0 * tolerance * rng.standard_normal((n, len(tolerance)))


def centres(p: Array) -> Array:
    rf, rp, thetaf, thetap = (p[..., 3 * k : 3 * k + 3] for k in range(4))
    return oracle.centres(rf, rp, thetaf, thetap)


# -- direct kinematics -----------------------------------------------------------------
def test_closed_form_and_newton_agree_over_the_workspace(rng):
    points = grid(9, 6)
    lengths = oracle.legs(
        points, oracle.centres([0.2] * 3, [0.06] * 3, oracle.THETA, oracle.THETA)
    )
    closed = micro_cmm.direct(lengths)
    newton = KINEMATICS.forward(
        lengths, MACHINE.nominal, points + rng.uniform(-0.02, 0.02, points.shape)
    )
    assert np.abs(closed - newton).max() < 1e-12
    assert np.abs(closed - points).max() < 1e-12


def test_newton_agrees_with_the_oracle_on_machines_that_are_not_perfect(rng):
    points, machines = grid(4, 3), random_machines(rng, 30)
    _, q = KINEMATICS.inverse(points)
    found = KINEMATICS.forward(q, machines, points)
    expected = oracle.probe(q + machines[:, None, 12:], centres(machines)[:, None])
    assert np.abs(found - expected).max() < 1e-12
    assert np.abs(found - points).max() > 1e-4  # the machines differ


# -- the closed forms (6)-(8), as the extracted text has them ---------------------------
def test_extracted_x_lacks_a_minus_sign_and_has_a_term_that_vanishes():
    """With the sign of 2 l1^2 restored, x is off by rho / 4 (35 mm): the term in rho is
    to be cos^2 + sin^2 - 1 = 0.
    """
    points = grid(5, 3)
    _, q = KINEMATICS.inverse(points)
    x = oracle.printed(q, RHO)[:, 0]
    assert np.abs(x.real - points[:, 0]).min() > 0.1
    restored = x.real - 4.0 * q[:, 0] ** 2 / (6.0 * RHO)
    assert np.abs(restored - (points[:, 0] + RHO / 4.0)).max() < 1e-13


def test_extracted_y_has_the_opposite_sign():
    points = grid(5, 3)
    _, q = KINEMATICS.inverse(points)
    assert np.abs(oracle.printed(q, RHO)[:, 1].real + points[:, 1]).max() < 1e-13


def test_extracted_z_needs_the_opposite_signs_of_x_and_y():
    points = grid(5, 3)
    _, q = KINEMATICS.inverse(points)
    x, y, z = points.T
    turned = oracle.printed_z(-x, -y, q[:, 1], RHO)
    assert np.abs(turned - np.abs(z)).max() < 1e-13
    as_printed = oracle.printed_z(x, y, q[:, 1], RHO)
    off_centre = np.hypot(x, y) > 0.03
    assert (
        np.abs(as_printed - np.abs(z))[
            off_centre & (np.abs(x - np.sqrt(3) * y) > 0.02)
        ].min()
        > 1e-3
    )
    # all three together: nowhere in the workspace is the printed model right
    assert (
        np.linalg.norm(oracle.printed(q, RHO) * [1, 1, -1] - points, axis=1).min() > 0.1
    )


def test_two_signs_and_a_sine_make_them_those_of_a_frame_turned_half_round():
    """(6) with 2 l1^2 - l2^2 - l3^2 and without its second term; (7) and (8) as they are."""
    points = grid(5, 3)
    _, q = KINEMATICS.inverse(points)
    l1, l2, l3 = q.T
    x = (2.0 * l1**2 - l2**2 - l3**2) / (6.0 * RHO)
    y = (l2**2 - l3**2) / (2.0 * np.sqrt(3.0) * RHO)
    c, s = RHO * np.cos(np.deg2rad(120)), RHO * np.sin(np.deg2rad(120))
    z = np.sqrt(l2**2 - (x + c) ** 2 - (y + s) ** 2)
    assert np.abs(np.column_stack([-x, -y, -z]) - points).max() < 1e-13


def test_spherical_joints_do_not_keep_the_platform_parallel():
    """Turn the platform about a horizontal axis: it can be shifted so that all three
    legs keep their lengths.
    """
    ring = np.column_stack([np.cos(oracle.THETA), np.sin(oracle.THETA), np.zeros(3)])
    frame, platform, at = 0.200 * ring, 0.060 * ring, np.array([0.01, 0.02, -0.2])
    wanted = np.linalg.norm(at + platform - frame, axis=1)
    angle = np.deg2rad(5.0)
    tilt = np.array(
        [
            [np.cos(angle), 0, np.sin(angle)],
            [0, 1, 0],
            [-np.sin(angle), 0, np.cos(angle)],
        ]
    )
    tilted = platform @ tilt.T
    for _ in range(30):
        away = at + tilted - frame
        length = np.linalg.norm(away, axis=1)
        at = at - np.linalg.solve(away / length[:, None], length - wanted)
    assert np.abs(np.linalg.norm(at + tilted - frame, axis=1) - wanted).max() < 1e-15
    assert np.linalg.norm(at - [0.01, 0.02, -0.2]) < 0.01


# -- what readings see -----------------------------------------------------------------
def measurement(*setups: Setup) -> Measurement:
    return Measurement(MACHINE, setups)


def test_position_readings_see_nine_of_fifteen_in_the_stated_combinations():
    m = measurement(mount(camera.known_frame, "position"))
    seen = Assessment.of(m, [m.series("position", grid(4, 3))])
    assert len(seen.names) == 15
    assert seen.identifiability.rank == 9
    found = seen.identifiability.coefficients_by_name(seen.identifiability.combinations)
    for i in (1, 2, 3):
        assert pytest.approx({f"rf{i}": 1.0, f"rp{i}": -1.0}, rel=1e-6) in found
        assert {f"dl{i}": 1.0} in [pytest.approx(c) for c in found]
        # R_f theta_f - R_p theta_p, told per unit of its pivot: with R_f = 200, R_p =
        # 60 mm
        pair = next(c for c in found if f"thetaf{i}" in c)
        assert set(pair) == {f"thetaf{i}", f"thetap{i}"}
        assert pair[f"thetaf{i}"] / pair[f"thetap{i}"] == pytest.approx(
            -0.200 / 0.060, rel=1e-6
        )


def test_the_lost_directions_change_no_reading_at_all():
    """Not only to first order: R_f and R_p together leave every position where it was."""
    points = grid(4, 3)
    _, q = KINEMATICS.inverse(points)
    p = MACHINE.nominal.copy()
    p[[0, 3]] += 1e-3
    assert np.abs(KINEMATICS.forward(q, p, points) - points).max() < 1e-14


def test_a_ball_plate_loses_the_machines_motions_in_its_plane_as_well():
    """15 + 6 of the plate's registration, of which 12 are seen: 9 + 6 less x, y and the
    turn about z.
    """
    m = measurement(mount(ball_plate.instrument, "plate", at_z=-0.2))
    seen = Assessment.of(m, [m.series("plate", grid(4, 2))])
    assert (len(seen.names), seen.identifiability.rank) == (21, 12)


def test_distances_see_as_much_of_the_machine_as_the_plate(rng):
    """Machine 9 less the three motions in the plane; the scale is a seventh."""
    m = measurement(mount(ball_plate.distance, "gauge"))
    pairs = np.vstack([rng.permutation(grid(3, 2)) for _ in range(4)])
    seen = Assessment.of(
        m, [m.series("gauge", pairs, [str(i // 2) for i in range(len(pairs))])]
    )
    assert (len(seen.names), seen.identifiability.rank) == (16, 7)


def test_a_machine_turned_as_a_whole_is_accurate_after_the_best_fit():
    """It never turns its platform, so that its points alone are aligned: frame and
    platform turned together.
    """
    maps = ErrorMaps.of(KINEMATICS, grid(3, 2), "best_fit")
    turned = np.zeros(15)
    turned[6:12] = 1e-3
    home = ErrorMaps.of(KINEMATICS, grid(3, 2), "home")
    assert np.abs(home.raw @ turned).max() > 30e-6
    assert np.abs(maps.raw @ turned).max() < 1e-15
