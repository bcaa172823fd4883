"""Drift over sessions against one least-squares fit of all, and the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sample

from oed import session_drift
from oed.session_change import Session
from pkm_studies import cli

N = 4
NAMES = [f"p{k}" for k in range(N)]
TOLERANCE = np.array([1.0, 0.1, 2.0, 0.5])
NOMINAL = np.array([10.0, 0.0, -3.0, 1.0])
TIMES = np.array([0.0, 30.0, 70.0, 90.0, 180.0])


def measured(
    rng: np.random.Generator, machine: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Session]:
    """Slopes and readings of one session, and its posterior by normal equations."""
    h = 20.0 * rng.standard_normal((25, N)) / TOLERANCE
    y = h @ machine + rng.standard_normal(25)
    covariance = np.linalg.inv(h.T @ h + np.diag(TOLERANCE**-2.0))
    return h, y, Session(NOMINAL + covariance @ h.T @ y, covariance)


def history(
    rng: np.random.Generator, rate: np.ndarray, knock: float = 0.0
) -> tuple[np.ndarray, np.ndarray, list[Session]]:
    """Design, readings and sessions of a machine that drifts, and may be knocked."""
    start = TOLERANCE * rng.standard_normal(N)
    rows, readings, sessions = [], [], []
    for time in TIMES:
        machine = start + rate * (time - TIMES[-1])
        machine[0] += knock * (time > 60.0) * (time < 80.0)
        h, y, session = measured(rng, machine)
        rows.append(np.hstack([h, h * (time - TIMES[-1])]))
        readings.append(y)
        sessions.append(session)
    return np.vstack(rows), np.concatenate(readings), sessions


def test_the_drift_is_that_of_one_fit_of_all_sessions() -> None:
    rate = np.array([2e-3, 0.0, 0.0, 0.0])
    design, y, sessions = history(np.random.default_rng(2), rate)
    drifted = session_drift.drift(NAMES, NOMINAL, TOLERANCE, sessions, TIMES)
    fitted, _, _, _ = np.linalg.lstsq(design, y)
    covariance = np.linalg.inv(design.T @ design)[N:, N:]
    assert drifted.rate == pytest.approx(fitted[N:], rel=1e-5, abs=1e-8)
    assert drifted.widening == 1.0
    assert np.diag(drifted.covariance) == pytest.approx(np.diag(covariance), rel=1e-4)
    misfit = float(np.sum((y - design @ fitted) ** 2))
    own = sum(
        float(np.linalg.lstsq(h[:, :N], v)[1][0])
        for h, v in zip(np.split(design, 5), np.split(y, 5), strict=True)
    )
    assert drifted.rest == pytest.approx(misfit - own, rel=1e-3)
    assert drifted.rest_dof == 3 * N
    surest = drifted.combinations[0]
    assert surest.coefficients == pytest.approx({"p0": 1.0})
    assert surest.p_value < 1e-6


def test_a_knock_is_not_reported_as_an_even_drift() -> None:
    _, _, sessions = history(np.random.default_rng(3), np.zeros(N), knock=0.5)
    drifted = session_drift.drift(NAMES, NOMINAL, TOLERANCE, sessions, TIMES)
    assert drifted.widening > 2.0
    assert drifted.p_value > 0.001


def test_intervals_hold_the_true_rate() -> None:
    rng, rate = np.random.default_rng(4), np.array([1e-3, 2e-4, 0.0, -1e-3])
    inside = []
    for _ in range(150):
        _, _, sessions = history(rng, rate)
        d = session_drift.drift(NAMES, NOMINAL, TOLERANCE, sessions, TIMES)
        inside.append(np.abs(d.rate - rate) < 1.96 * np.sqrt(np.diag(d.covariance)))
    assert 0.92 < np.mean(inside) < 0.98


def test_the_next_calibration_is_when_the_error_reaches_its_limit() -> None:
    rate = np.array([2e-3, 0.0, 0.0, 0.0])
    _, _, sessions = history(np.random.default_rng(5), rate)
    d = session_drift.drift(NAMES, NOMINAL, TOLERANCE, sessions, TIMES)
    maps = np.zeros((7, N))
    maps[:, 0] = 1.0
    rng = np.random.default_rng(6)
    due = session_drift.next_calibration(maps, d, after=0.3, limit=0.5, rng=rng)
    assert due.time == pytest.approx(0.4 / d.rate[0])
    assert due.low < due.time < due.high
    assert due.low < 200.0 < due.high
    late = session_drift.next_calibration(maps, d, after=0.6, limit=0.5, rng=rng)
    assert late.time == 0.0


def test_the_command_tells_the_drift_and_the_next_date(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = sample.changed(
        sample.STUDY,
        ("[[design.candidates]]", '[[design.reference]]\nname = "circles"'),
        ("[expect]", "[posterior]\nenabled = false\n[expect]"),
    )
    dates = {"2026-01-01": 0.10, "2026-01-31": 0.16, "2026-03-02": 0.22}
    for seed, (date, dq1) in enumerate(dates.items()):
        study = tmp_path / f"{date}.study.toml"
        simulated = f"[readings]\nsimulate = true\ntruth = {{ dq1_mm = {dq1} }}\n"
        study.write_text(f"{plan}{simulated}", encoding="utf-8")
        folder = tmp_path / "machine" / date
        call = ["run", study, "--out", folder, "--seed", seed, "--quiet"]
        assert cli.main([str(a) for a in call]) == 0
    capsys.readouterr()
    assert cli.main(["history", str(tmp_path / "machine"), "--limit", "z_um=100"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("3 sessions over 60 days.\nThe machine drifts")
    assert "100 um are reached after" in out
    assert "Calibrate again by 2026-" in out
    assert cli.main(["history", str(tmp_path / "machine"), "--limit", "z_um=-5"]) == 2
    assert "not a positive number" in capsys.readouterr().err
    assert cli.main(["history", str(tmp_path / "machine" / "2026-01-01")]) == 2
    assert "two sessions" in capsys.readouterr().err
