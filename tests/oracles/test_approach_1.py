"""Approach 1 of Tian et al. (2016), Eqs. (13)-(15), on the oracle alone."""

import numpy as np
import pytest

from . import a3_geometry as a3

STEP = 1e-30  # complex step
HOME_Z = a3.D + a3.C
PAPER = a3.errors(**{k: v for k, v in a3.TABLE3.items() if k != "ds"})
EQ17_AND_CUP = np.r_[a3.EQ17, 24, 25, 26]


def rank(h: np.ndarray) -> int:
    return np.linalg.matrix_rank(h, tol=1e-11 * np.linalg.norm(h, 2))


#: condition numbers of H of Eq. (14), lengths in m and home orientation in rad
KAPPA_APPROACH_1 = {11: 64536, 12: 23811, 15: 17259, 16: 15769, 20: 14121, 24: 13079}


def test_approach_1_determines_all_27():
    """Eq. (15): with the six home rows the inverse exists, and returns every number."""
    for n, want in KAPPA_APPROACH_1.items():
        s = np.linalg.svd(a3.approach_1([0.08, 0.2], n), compute_uv=False)
        assert len(s) == 27
        assert s[0] / s[26] == pytest.approx(want, abs=1)
    h = a3.approach_1([0.08, 0.2], 15)
    truth = np.r_[PAPER / a3.SCALE, a3.TABLE3["ds"]]
    found = np.linalg.solve(h.T @ h, h.T @ (h @ truth))  # (H^T H)^-1 H^T dl
    assert np.abs(found - truth).max() < 1e-10  # m
    assert rank(h[3:]) == 24  # without the home point: the base's translations
    assert rank(h[[0, 1, 2, *range(6, 36)]]) == 24  # without the orientation
    assert rank(h[6:]) == 21  # the bar alone
    # Eq. (17), with the three orientation rows
    assert rank(h[3:][:, EQ17_AND_CUP]) == 21


def test_derivatives_of_the_home_readings_are_eq_13():
    q = a3.inverse_nominal(HOME_Z, 0.0, 0.0)
    moves = 1j * STEP * np.eye(24)
    point = a3.forward(moves, q).tip.imag.T / STEP
    step = 1e-6
    turns = a3.level_and_edge(step * np.eye(24), q).T / (2 * step)
    turns -= a3.level_and_edge(-step * np.eye(24), q).T / (2 * step)
    rows = a3.home_rows()
    assert np.abs(point - rows[:3, :24]).max() < 1e-12
    assert np.abs(turns - rows[3:, :24]).max() < 1e-7
