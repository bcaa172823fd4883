"""Readings along circles before and after compensation, against the oracle's heads."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from oracles import a3_geometry as a3
from report_fixture import check_inside, result_of, sample

from kernel import a3_plans
from kernel.a3_machines import exact, measured
from oed import compensate
from oed.estimation import Estimate, identify
from oed.measurement import Measurement, Series
from oed.result import RunCurve, breaches
from oed.units import to_si
from pkm_reports import style
from pkm_reports.page import Document
from pkm_reports.sections import identification
from pkm_studies.commands import main
from pkm_studies.results import load_result
from pkm_studies.stages.fit import run_curves

STROKES = (0.0, 0.1, 0.2)  # Fig. 8 of Tian et al. (2016)
POINTS = 24
TRUTH = np.r_[
    a3.errors(**{k: v for k, v in a3.TABLE3.items() if k != "ds"}), a3.TABLE3["ds"]
]


@pytest.fixture(scope="module")
def fitted() -> tuple[Measurement, list[Series], Estimate]:
    m = a3_plans.measurement()
    stroke = np.repeat(STROKES, POINTS)
    psi = np.tile(2.0 * np.pi * np.arange(POINTS) / POINTS, len(STROKES))
    command = a3_plans.bar_commands(m, stroke, psi)
    labels = [f"{1e3 * s:.0f} mm" for s in stroke]
    series = m.series("cup", command, labels)
    y = measured(series, TRUTH, np.random.default_rng(4))
    return m, [series], identify(m, [series], y)


@pytest.fixture(scope="module")
def curves(fitted: tuple[Measurement, list[Series], Estimate]) -> list[RunCurve]:
    return run_curves.fitted_curves(*fitted)


def test_a_curve_for_each_circle(curves):
    assert [c.run for c in curves] == ["0 mm", "100 mm", "200 mm"]
    assert {c.kind for c in curves} == {"circle"}
    assert all(np.all(np.diff(c.at) > 0.0) and len(c.at) == POINTS for c in curves)


def test_measured_departures_are_the_oracles(fitted, curves):
    """Bar length less 300 mm, along the circle."""
    y = 1e6 * (exact(fitted[1][0], TRUTH) - 0.300)
    for k, curve in enumerate(curves):
        of_run = np.sort(y[k * POINTS : (k + 1) * POINTS])
        assert np.sort(curve.measured) == pytest.approx(of_run, abs=2.5)
        assert np.sort(curve.predicted) == pytest.approx(of_run, abs=1.5)


def test_the_compensated_head_reads_what_is_predicted(fitted, curves):
    """Figs. 8 and 9: the oracle's head, moved at the compensated joints, with a cup that
    it teaches anew, reads within the interval. x and y stay in the readings.
    """
    m, (series,), estimate = fitted
    joints = compensate.compensated_joints(
        m.kinematics, series.command, estimate.theta[:24]
    )
    read = series.index[:, 0]
    cup = a3.forward(TRUTH[:24], joints[series.index[:, 1]]).tip + TRUTH[24:]
    y = 1e6 * (a3.ball_bar_reading(TRUTH[:24], joints[read], cup) - 0.300)
    noise = 0.5 * np.random.default_rng(5).standard_normal(len(y))
    inside = 0
    for k, curve in enumerate(curves):
        of_run = slice(k * POINTS, (k + 1) * POINTS)
        phase = run_curves._run_phase(m, series)[1]
        order = np.argsort(phase[of_run], kind="stable")
        error = (y + noise)[of_run][order] - curve.compensated
        inside += int((np.abs(error) <= curve.compensated_half_widths).sum())
        assert np.abs(error).max() < 3.0
        assert np.abs(curve.compensated).max() > 100.0
    assert inside >= 0.87 * len(y)


def test_joints_alone_have_no_compensated_reading(fitted):
    m, (series,), estimate = fitted
    recorded = m.series_from_joints("cup", series.q[:-1], list(series.run))
    curve = run_curves.fitted_curves(m, [recorded], estimate)[0]
    assert curve.compensated == []
    assert len(curve.measured) == POINTS


def test_the_report_draws_the_runs(curves):
    raw = sample()
    raw["estimate"]["runs"] = msgspec.to_builtins(curves)
    result = result_of(raw)
    assert not list(breaches(result))
    contradicting = [
        msgspec.structs.replace(curves[0], predicted=[]),
        msgspec.structs.replace(curves[0], compensated=[1.0]),
    ]
    for curve in contradicting:
        raw["estimate"]["runs"] = msgspec.to_builtins([curve])
        assert list(breaches(result_of(raw)))
    unknown = msgspec.structs.replace(curves[0], kind="spiral")
    raw["estimate"]["runs"] = msgspec.to_builtins([unknown])
    with pytest.raises(msgspec.ValidationError, match="kind"):
        result_of(raw)
    report = Document.from_result(result)
    assert report.page["sections"]  # draws
    assert "run_curves" in report.images
    with style.applied():
        drawn = identification.draw_run_curves(curves)
        check_inside(drawn)
        assert len(drawn.axes) == 9
        after = [msgspec.structs.replace(c, compensated=[]) for c in curves]
        assert len(identification.draw_run_curves(after, after=True).axes) == 6
    inside, count = identification.curve_coverage(curves)
    assert count == 3 * POINTS
    assert inside >= 0.87 * count
    assert "95 % interval" in identification.curves_caption(curves)


# -- `oed verify` with readings after compensation -------------------------------------
@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("round") / "out"
    assert main(["run", "a3_test_circles", "--out", str(path), "--quiet"]) == 0
    return path


def write_readings(folder: Path, path: Path, error_um: float) -> None:
    """Readings of the oracle's head at the compensated joints, with 0.5 um noise."""
    result = load_result(folder)
    m = a3_plans.measurement()
    believed = m.nominal.copy()
    for k, name in enumerate(m.names):
        stored = result.estimate.parameters.get(name)
        if stored is not None:
            believed[k] = to_si(stored.value, stored.unit)
    stroke = np.repeat(STROKES, POINTS)
    psi = np.tile(2.0 * np.pi * np.arange(POINTS) / POINTS, len(STROKES))
    command = a3_plans.bar_commands(m, stroke, psi)
    series = m.series("cup", command, controller=believed[:24])
    y = 1e3 * measured(series, TRUTH, np.random.default_rng(6))
    y = y + 1e-3 * error_um * np.cos(4.0 * psi)
    lines = ["setup,run,order,z_mm,psi_deg,theta_deg,length_mm"]
    for k, (z, psi_k, theta) in enumerate(command):
        pose = f"{1e3 * z:.6f},{np.degrees(psi_k):.8f},{np.degrees(theta):.8f}"
        lines.append(f"cup,c{k // POINTS},{k % POINTS + 1},{pose},{y[k]:.6f}")
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


@pytest.mark.parametrize(("error_um", "code"), [(0.0, 0), (28.6, 1)])
def test_verify_compares_the_compensated_head_with_its_prediction(
    folder, tmp_path, capsys, error_um, code
):
    """Fig. 9: an error that the model lacks, of the paper's 28.6 um, contradicts it."""
    readings = tmp_path / "after.readings.csv"
    write_readings(folder, readings, error_um)
    assert main(["verify", str(folder), "--readings", str(readings)]) == code
    printed = capsys.readouterr().out
    assert ("contradict" if code else "agree with") in printed
    curves = load_result(folder).after_compensation
    assert len(curves) == 3
    assert not curves[0].compensated
    error = np.abs(np.subtract(curves[1].measured, curves[1].predicted))
    assert error.max() == pytest.approx(error_um, abs=4.0)


def test_verify_refuses_readings_of_a_result_without_estimate(folder, tmp_path, capsys):
    readings = tmp_path / "after.readings.csv"
    write_readings(folder, readings, 0.0)
    bare = tmp_path / "bare"
    bare.mkdir()
    result = msgspec.structs.replace(load_result(folder), estimate=None)
    (bare / "result.json").write_bytes(msgspec.json.encode(result))
    assert main(["verify", str(bare), "--readings", str(readings)]) == 2
    assert "no estimate" in capsys.readouterr().err
