"""The numbers of docs/errata.md that no other test holds, from oracles that share no
code with the toolkit.
"""

import re
from pathlib import Path

import numpy as np
import pytest
from oracles import a3_geometry as a3
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
HOME_Z = a3.C + a3.D
CUP = np.array([0.0, 0.0, a3.Z_TEACH])
TABLE_3 = a3.errors(**{k: v for k, v in a3.TABLE3.items() if k != "ds"})
COLUMNS = np.r_[a3.EQ17, 24, 25, 26]  # Eq. (17) and the cup
DA01X = 12
# (9, 3): da0 by a turn about the TCP
ROTATIONS = np.vstack([np.cross(np.eye(3), place).T for place in a3.A0_NOM])


def circle_rows(strokes: list[float], points: int, *, taught: bool) -> np.ndarray:
    """Rows (n, 27) of the bar on circles at some strokes (m), all columns as lengths."""
    stroke, psi = (
        v.ravel()
        for v in np.meshgrid(
            strokes, 2 * np.pi * np.arange(points) / points, indexing="ij"
        )
    )
    theta = a3.circle_theta(HOME_Z + stroke, psi, CUP)
    return (
        a3.bar_rows(HOME_Z + stroke, psi, theta, CUP, taught=taught)
        * np.r_[a3.SCALE, 1, 1, 1]
    )


def workspace(theta_deg: list[float]) -> tuple[np.ndarray, ...]:
    """z, psi, theta (n,): strokes 0, 100, 200 mm and 12 psi."""
    grid = np.meshgrid(
        [0, 0.1, 0.2], 2 * np.pi * np.arange(12) / 12, np.deg2rad(theta_deg)
    )
    stroke, psi, theta = (v.ravel() for v in grid)
    return HOME_Z + stroke, psi, theta


def errors(
    pose: tuple[np.ndarray, ...], q: np.ndarray, machine: np.ndarray = TABLE_3
) -> np.ndarray:
    """Exact errors (n, 3) in z, psi, theta of a machine sent to joints q."""
    z, psi, theta = pose
    real = a3.forward(machine, q)
    found = a3.euler(real.R)
    return np.column_stack(
        [real.tip[:, 2] - z, np.angle(np.exp(1j * (found[0] - psi))), found[1] - theta]
    )


# -- A3: what one bar at one tool point cannot see ------------------------------------
@pytest.mark.parametrize("taught", [True, False])
@pytest.mark.parametrize("circles", [2, 3, 4, 5])
def test_dropping_da01x_does_not_make_h_regular(taught, circles):
    """20 columns, still rank 18: a tilt about u does not move da01x, nor one about v
    with a spin of c/a of it.
    """
    h = circle_rows(list(np.linspace(0.08, 0.2, circles)), 20, taught=taught)
    for columns, rank in (
        (COLUMNS, 18),
        (np.delete(COLUMNS, list(COLUMNS).index(DA01X)), 18),
    ):
        s = np.linalg.svd(h[:, columns], compute_uv=False)
        assert s[rank - 1] > 2e-5 * s[0]
        assert s[rank] < 1e-14 * s[0]
    for turn in ([1, 0, 0], [0, a3.A, a3.C]):
        lost = np.zeros(27)
        lost[a3.SL_A] = ROTATIONS @ turn
        assert abs(lost[DA01X]) < 1e-15
        assert np.abs(h @ lost).max() < 1e-13


def test_a_finite_turn_of_the_platform_joints_changes_no_reading():
    """Not only to first order: the platform's frame may be chosen anew about the TCP.
    The platform stands turned.
    """
    rng = np.random.default_rng(0)
    psi, theta = rng.uniform(-np.pi, np.pi, 300), np.deg2rad(rng.uniform(0, 40, 300))
    q = a3.inverse_nominal(HOME_Z + rng.uniform(0, 0.2, 300), psi, theta)
    turn = Rotation.from_rotvec([5e-3, -3e-3, 2e-3])
    turned = TABLE_3.copy()
    turned[a3.SL_A] = (
        turn.apply(a3.A0_NOM + TABLE_3[a3.SL_A].reshape(3, 3)) - a3.A0_NOM
    ).ravel()
    first, second = (
        a3.ball_bar_reading(p, q, a3.taught_cup(p, a3.TABLE3["ds"]))
        for p in (TABLE_3, turned)
    )
    assert np.ptp(first) > 0.1
    assert np.abs(first - second).max() < 1e-14
    between = Rotation.from_matrix(
        a3.forward(turned, q).R @ np.swapaxes(a3.forward(TABLE_3, q).R, 1, 2)
    )
    assert between.magnitude() == pytest.approx(turn.magnitude(), rel=1e-9)


def test_one_circle_of_any_density_leaves_the_eighteenth_direction_at_metres():
    exact = [
        np.linalg.svd(
            circle_rows([0.08], points, taught=False)[:, COLUMNS], compute_uv=False
        )
        for points in (18, 19)
    ]
    assert max(s[17] / s[0] for s in exact) < 1e-15
    for points, metres in ((20, 8.7), (30, 3.2), (72, 2.4), (720, 0.76)):
        s = np.linalg.svd(
            circle_rows([0.08], points, taught=False)[:, COLUMNS], compute_uv=False
        )
        assert 0.5e-6 / s[17] == pytest.approx(metres, rel=0.02)
        assert s[16] > 6e-6


def test_kappa_over_the_18_directions_dips_at_15_points():
    """m = 2 circles of n points: Table 2's strokes, and the stroke's ends."""
    n = np.arange(12, 25)

    def kappa(strokes: list[float], taught: bool) -> np.ndarray:
        values = [
            np.linalg.svd(
                circle_rows(strokes, k, taught=taught)[:, COLUMNS], compute_uv=False
            )
            for k in n
        ]
        return np.array([s[0] / s[17] for s in values])

    taught = kappa([0.08, 0.2], True)
    assert np.round(taught[:5]) == pytest.approx([3908, 5210, 4587, 3748, 4530])
    assert n[taught.argmin()] == 15
    assert taught[n > 15].min() > 1.11 * taught.min()  # 15 is a dip
    # and 12 points are better than any number from 16 to 24
    assert taught[0] < taught[n > 15].min()
    free = kappa([0.08, 0.2], False)
    assert np.round(free[[0, 3, 4, -1]]) == pytest.approx([19446, 17705, 17033, 16855])
    assert free[n > 15].max() < free[3]  # no minimum at 15
    assert free[0] / free[-1] < 1.16  # and no rapid fall before it
    ends = kappa([0.0, 0.2], True)
    assert np.round(ends[:5]) == pytest.approx([5808, 6279, 6105, 4816, 5545])


@pytest.mark.parametrize(
    ("angle_unit", "kappas"),  # m: a reading of 1 rad as a length
    [
        (1.0, [64536, 23811, 18577, 17658, 17259, 15769, 15007, 14121]),
        (a3.D, [46288, 17186, 13503, 12930, 12736, 11732, 11360, 10946]),
        (1e-3, [38567, 14914, 12118, 11922, 12024, 11336, 11372, 11218]),
    ],
)
def test_kappa_of_approach_1_falls_to_13_points_and_slowly_after(angle_unit, kappas):
    """H of Eq. (14) with 11 to 20 points on each of Table 2's circles."""
    points = [11, 12, 13, 14, 15, 16, 18, 20]
    units = np.r_[[1.0] * 3, [angle_unit] * 3]
    for n, expected in zip(points, kappas, strict=True):
        rows = a3.approach_1([0.08, 0.2], n)
        rows[:6] *= units[:, None]
        assert np.linalg.cond(rows) == pytest.approx(expected, abs=1)
    at = dict(zip(points, kappas, strict=True))
    assert at[11] > 3 * at[13]
    assert at[13] < 1.10 * at[15]
    assert at[15] < 1.25 * at[20]


def test_table_3_has_a_part_that_no_bar_reading_backs():
    """Least squares of its da0 on the turns of the platform: 1.67 mrad about u, -0.56
    about v, no spin.
    """
    da0 = a3.TABLE3["da0"].ravel()
    turn = np.linalg.lstsq(ROTATIONS, da0)[0]
    assert 1e3 * turn == pytest.approx([1.675, -0.556, 0.004], abs=1e-3)
    assert np.linalg.norm(ROTATIONS @ turn) / np.linalg.norm(da0) == pytest.approx(
        0.68, abs=0.005
    )
    unseen = np.zeros(27)
    unseen[a3.SL_A] = ROTATIONS @ turn
    assert (
        np.abs(circle_rows([0.0, 0.08, 0.14, 0.2], 30, taught=True) @ unseen).max()
        < 1e-16
    )
    without = TABLE_3.copy()
    without[a3.SL_A] -= ROTATIONS @ turn
    q = a3.inverse_nominal(*workspace([5, 15, 25, 35]))
    tilt = Rotation.from_matrix(
        a3.forward(TABLE_3, q).R @ np.swapaxes(a3.forward(without, q).R, 1, 2)
    )
    assert np.rad2deg(tilt.magnitude()) * 60 == pytest.approx(6.07, abs=0.02)  # arcmin


# -- A3: the linear compensator --------------------------------------------------------
@pytest.mark.parametrize(("theta_deg", "left"), [
    ([5, 15, 25, 35], [0.234e-3, 0.98e-3, 0.61e-3]),
    ([2], [0.040e-3, 2.37e-3, 0.094e-3]),
])  # fmt: skip
def test_one_step_of_eq_24_leaves_tenths_of_a_millimetre(theta_deg, left):
    """Largest errors in z (m), psi, theta (rad) with Table 3's errors; two more steps
    leave nothing.
    """
    pose = workspace(theta_deg)
    q = a3.inverse_nominal(*pose)
    q = q + a3.compensator(*pose).dq @ TABLE_3
    assert np.abs(errors(pose, q)).max(axis=0) == pytest.approx(left, rel=0.02)
    for _ in range(2):
        step = 1e-7
        slope = np.stack(
            [(errors(pose, q + step * e) - errors(pose, q)) / step for e in np.eye(3)],
            axis=-1,
        )
        q = q - np.linalg.solve(slope, errors(pose, q)[..., None])[..., 0]
    assert np.abs(errors(pose, q)).max() < 1e-10


# -- the page --------------------------------------------------------------------------
def test_the_tests_that_the_page_names_are_there():
    page = (ROOT / "docs" / "errata.md").read_text(encoding="utf-8")
    named = re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page)
    assert len(named) > 5
    for path, test in named:
        assert f"def {test}(" in (ROOT / path).read_text(encoding="utf-8"), (
            f"{path}::{test}"
        )
