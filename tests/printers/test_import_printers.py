"""`oed import rrf` and `oed import marlin`: logs of printers that an oracle probed."""

from pathlib import Path

import numpy as np
import pytest
from oracles.delta_trilateration import nozzle, travel_to

import oed
from oed import units
from pkm_studies.base import InputError
from pkm_studies.importers import import_files

#: what the firmware believes, and the true printer: mm and rad
ADJUST = (0.3, -0.2, 0.0)
BELIEVED = (
    105.0,
    [215.0] * 3,
    np.radians([210.0, 330.0, 90.0]),
    [240.0 + adjustment for adjustment in ADJUST],
)
TRUE = (105.4, [215.0] * 3, np.radians([210.2, 329.9, 90.0]), [240.5, 239.9, 240.1])
PLACES = [(0.0, 0.0)] + [
    (80.0 * np.cos(a), 80.0 * np.sin(a)) for a in np.radians(np.arange(30, 390, 60))
]


def believed_heights() -> list[float]:
    """z, mm, that the firmware believes in at contact with the bed of the true printer.

    The tool comes down at the believed x, y until the true z is 0.
    """
    heights = []
    for x, y in PLACES:
        low, high = -5.0, 5.0
        for _ in range(60):
            middle = (low + high) / 2.0
            travels = travel_to((x, y, middle), *BELIEVED)
            low, high = (
                (middle, high) if nozzle(travels, *TRUE)[2] < 0.0 else (low, middle)
            )
        heights.append(low)
    return heights


def check_estimate(study: Path) -> None:
    estimate = oed.identify(oed.read_readings(oed.load_study(study))).section.parameters
    value = {n: float(units.to_si(e.value, e.unit)) for n, e in estimate.items()}
    assert value["radius"] == pytest.approx(units.MM * TRUE[0], abs=5e-5)
    assert value["angle1"] == pytest.approx(TRUE[2][0], abs=3e-4)
    for i in range(3):
        wanted = units.MM * TRUE[3][i]
        assert value[f"endstop{i + 1}"] == pytest.approx(wanted, abs=5e-5)


def test_reprapfirmware(tmp_path):
    config = tmp_path / "config.g"
    config.write_text(
        "M665 R105 L215:215:215 B85 H240 X0 Y0 Z0 ; geometry\n"
        f"M666 X{ADJUST[0]} Y{ADJUST[1]} Z{ADJUST[2]}\n"
    )
    bed = tmp_path / "bed.g"
    lines = [f"G30 P{k} X{x:.9f} Y{y:.9f} Z-99999" for k, (x, y) in enumerate(PLACES)]
    bed.write_text("M561\nG28\n" + "\n".join(lines) + " S-1\n")
    log = tmp_path / "log.txt"
    heights = " ".join(f"{z:.9f}" for z in believed_heights())
    log.write_text(
        f"12:01 G32 bed probe heights: {heights}, mean 0.1, deviation from mean 0.2\n"
    )
    study, _ = import_files("rrf", [config, bed, log], tmp_path / "out")
    check_estimate(study)
    with pytest.raises(InputError, match=r"give the bed\.g"):
        import_files("rrf", [config, log], tmp_path / "b")
    with pytest.raises(InputError, match="has the answer of a last G30"):
        import_files("rrf", [config, bed], tmp_path / "b")
    points = bed.read_text()
    bed.write_text(points.replace("G30 P1 ", "G30 P1e999 "))
    with pytest.raises(InputError, match=r"bed\.g: line \d+.*not a finite number"):
        import_files("rrf", [config, bed, log], tmp_path / "b")
    bed.write_text(points)
    log.write_text("G32 bed probe heights: 0.1 0.2, mean 0\n")
    with pytest.raises(InputError, match=r"line 1.*2 heights for 7 probe points"):
        import_files("rrf", [config, bed, log], tmp_path / "b")


def test_marlin(tmp_path):
    """Marlin's adjustments lower a tower: the switch is higher by as much."""
    log = tmp_path / "log.txt"
    settings = (
        "echo:; Delta settings (L<diagonal rod> R<radius> H<height>)\n"
        "echo:  M665 L215.00 R105.00 H239.80 S80.00 X0.00 Y0.00 Z0.00 A0.00\n"
        "echo:  M666 X-0.50 Y0.00 Z-0.20\n"
    )
    points = [
        f"Bed X: {x:.9f} Y: {y:.9f} Z: {z:.9f}"
        for (x, y), z in zip(PLACES, believed_heights(), strict=True)
    ]
    log.write_text(settings + "\n".join(points) + "\nok\n")
    study, _ = import_files("marlin", [log], tmp_path / "out")
    check_estimate(study)
    log.write_text("\n".join(points))
    with pytest.raises(InputError, match="answer of M503"):
        import_files("marlin", [log], tmp_path / "b")


def test_marlin_calibration_report(tmp_path):
    """The points of G33 stand every 60 degrees from tower x, at 210 degrees."""
    log = tmp_path / "log.txt"
    text = (
        "M665 L215.00 R105.00 H240.00\nM666 X0 Y0 Z0\nG33 P3\nG33 Auto Calibrate\n"
        ".      c:+9.00     x:+9.20   y:+9.10   z:+9.05\n"
        ".      c:+0.01     x:+0.20   y:-0.10   z:+0.05\n"
        ".             yz:+0.03  zx:-0.04  xy:+0.11\n"
    )
    log.write_text(text)
    with pytest.raises(InputError, match=r"line 7.*probe_radius_mm"):
        import_files("marlin", [log], tmp_path / "b")
    prefixed = "".join(f"Recv: {line}\n" for line in text.splitlines())
    printed = prefixed.replace(
        "G33 Auto", "Checking... AC at radius:60.00\nRecv: G33 Auto"
    )
    log.write_text(printed)
    _, imported = import_files("marlin", [log], tmp_path / "host")
    assert {round(float(row["y_mm"]), 6) for row in imported.rows} >= {60.0, -60.0}
    log.write_text(
        printed + "Recv: M665 L215.00 R106.50 H239.00\nRecv: M666 X0 Y0 Z0\n"
    )
    path, _ = import_files("marlin", [log], tmp_path / "after")
    assert oed.load_study(path).machine.nominal["radius_mm"] == 105.0  # while it probed
    log.write_text(text + "probe_radius_mm = 80\n")
    _, imported = import_files("marlin", [log], tmp_path / "out")
    points = {float(row["z_mm"]): row for row in imported.rows}
    assert set(points) > {0.20, -0.10, 0.05, 0.03, -0.04, 0.11}
    # the middle is a mean over three places near it
    assert float(imported.rows[0]["z_mm"]) == pytest.approx(0.01, abs=1e-3)
    assert float(points[0.05]["y_mm"]) == pytest.approx(80.0)
    assert float(points[0.11]["y_mm"]) == pytest.approx(-80.0)
    assert float(points[0.2]["x_mm"]) == pytest.approx(-80.0 * np.cos(np.radians(30)))
