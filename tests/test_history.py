"""Drift over sessions against one least-squares fit of all, and the command."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import sample

from oed.estimation import session_drift
from oed.estimation.session_change import Session
from pkm_studies.commands import cli

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
    # the median of 4000 draws
    assert due.time == pytest.approx(0.4 / d.rate[0], rel=2e-3)
    assert due.low < due.time < due.high
    assert due.low < 200.0 < due.high
    late = session_drift.next_calibration(maps, d, after=0.6, limit=0.5, rng=rng)
    assert late.time == 0.0


def run_sessions(tmp_path: Path, dates: dict[str, float]) -> list[str]:
    """Folders of a machine's sessions, by their dates, with an offset dq1 (mm) in each."""
    plan = sample.changed(
        sample.STUDY,
        ("[[design.candidates]]", '[[design.reference]]\nname = "circles"'),
        ("[expect]", "[posterior]\nenabled = false\n[expect]"),
    )
    folders = [str(tmp_path / "machine" / date) for date in dates]
    for seed, (date, dq1) in enumerate(dates.items()):
        study = tmp_path / f"{date}.study.toml"
        simulated = f"[readings]\nsimulate = true\ntruth = {{ dq1_mm = {dq1} }}\n"
        study.write_text(f"{plan}{simulated}", encoding="utf-8")
        call = ["run", study, "--out", folders[seed], "--seed", seed, "--quiet"]
        assert cli.main([str(a) for a in call]) == 0
    return folders


def test_the_command_tells_the_drift_and_the_next_date(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    dates = {"2026-01-01": 0.10, "2026-01-31": 0.16, "2026-03-02": 0.22}
    run_sessions(tmp_path, dates)
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
    twice = [str(tmp_path / "machine" / "2026-01-01")] * 2
    assert cli.main(["history", *twice]) == 2
    assert "the readings are equal" in capsys.readouterr().err


def test_two_sessions_have_one_test_and_no_date_where_nothing_drifts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of two seeds of one machine `compare` and `history` say the same."""
    folders = run_sessions(tmp_path, {"2026-01-01": 0.1, "2026-01-11": 0.1})
    capsys.readouterr()
    assert cli.main(["compare", *folders]) == 0
    compared = capsys.readouterr().out
    assert cli.main(["history", *folders]) == 0
    followed = capsys.readouterr().out
    test = re.compile(r"chi2 ([\d.]+) for (\d+) combinations.*p = ([\d.]+)")
    numbers = [test.search(out) for out in (compared, followed)]
    assert numbers[0] is not None
    assert numbers[1] is not None
    assert numbers[0].groups() == numbers[1].groups()
    assert "No drift is proven" in followed
    assert "Calibrate again" not in followed
    assert "one every 10 days, prove with probability 0.9" in followed
    sizes = re.findall(r"([\d.]+) um \((\d+) sessions\)", followed)
    assert [count for _, count in sizes[:3]] == ["3", "4", "8"]
    assert float(sizes[0][0]) > float(sizes[1][0]) > float(sizes[2][0]) > 0.0


def test_a_drift_of_the_provable_size_is_proven_as_often_as_said() -> None:
    """Sessions of the oracle, drifting in random directions by the size for 5 of them."""
    rng = np.random.default_rng(8)
    maps = rng.standard_normal((9, N)) / TOLERANCE
    _, _, sessions = history(rng, np.zeros(N))
    growth = session_drift.provable_growth(
        maps, sessions, NOMINAL, TOLERANCE, [5], 0.01, rng
    )
    times = np.arange(5.0)
    proven = 0
    for _ in range(200):
        direction = TOLERANCE * rng.standard_normal(N)
        rate = direction * growth[0] / np.sqrt(np.mean((maps @ direction) ** 2))
        start = TOLERANCE * rng.standard_normal(N)
        drifting = [measured(rng, start + t * rate)[2] for t in times]
        found = session_drift.drift(NAMES, NOMINAL, TOLERANCE, drifting, times)
        proven += found.p_value < 0.01
    assert 0.83 < proven / 200 < 0.96
