"""Virtual delta printers with a saved calibration and a saved bed mesh.

An oracle of trilateration gives the readings: this module knows nothing of the toolkit's
machines.
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from oracles.delta_trilateration import nozzle, travel_to

import oed
from oed.result import StudyResult
from pkm_studies import stages
from pkm_studies.importers import import_files

STEP = 40.0 / (200.0 * 16.0)
TRIGGER = 12.5
#: the geometry of the firmware, in the arguments of the oracle; mm, rad
ARMS, ANGLES = np.full(3, 217.0), np.radians([210.0, 330.0, 90.0])
FIRMWARE = (98.0, ARMS, ANGLES, np.full(3, 251.0))
NODES = np.linspace(-80.0, 80.0, 9)  #: nodes of a round mesh, mm
ANGLES_OF_SIX = np.radians(np.arange(0.0, 360.0, 60.0))
HEADER = """\
#*# <---------------------- SAVE_CONFIG ---------------------->
#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.
#*#
"""


def drawn(rng: np.random.Generator) -> tuple:
    """An assembled printer, whose firmware has FIRMWARE."""
    turned = ANGLES + np.radians(np.r_[rng.normal(0.0, 0.3, 2), 0.0])
    stops = 251.0 + rng.normal(0.0, 0.5, 3)
    return 98.0 + rng.normal(0.0, 0.6), ARMS, turned, stops


def heights(true: tuple, rng: np.random.Generator, sigma: float) -> list[str]:
    """Seven saved heights of a bed that is flat within sigma, mm."""
    ring = 70.0 * np.stack([np.cos(ANGLES_OF_SIX), np.sin(ANGLES_OF_SIX)], axis=1)
    lines = []
    for k, (x, y) in enumerate([(0.0, 0.0), *ring]):
        at = travel_to((x, y, TRIGGER + sigma * rng.normal()), *true)
        lines += [f"height{k} = {TRIGGER}", f"height{k}_pos = {_steps(at)}"]
    return lines


def distances(true: tuple, rng: np.random.Generator, sigma: float) -> list[str]:
    """Twelve saved distances of a hexagon, read within sigma, mm."""
    corners = 65.0 * np.stack([np.cos(ANGLES_OF_SIX), np.sin(ANGLES_OF_SIX)], axis=1)
    pairs = [((0.0, 0.0), corner) for corner in corners]
    pairs += list(zip(corners, np.roll(corners, 1, axis=0), strict=True))
    lines = []
    for k, pair in enumerate(pairs):
        first, second = (np.array([*point, 0.3]) for point in pair)
        length = np.linalg.norm(first - second) + sigma * rng.normal()
        lines.append(f"distance{k} = {length:.4f}")
        for i, point in enumerate((first, second), start=1):
            lines.append(f"distance{k}_pos{i} = {_steps(travel_to(point, *true))}")
    return lines


def mesh_heights(
    true: tuple, firmware: tuple, rng: np.random.Generator, sigma: float
) -> NDArray:
    """Heights (9, 9) of a mesh, as a firmware with some geometry has them, mm.

    NaN outside the circle of the bed.
    """
    x, y = np.meshgrid(NODES, NODES)
    z = np.zeros_like(x)
    bed = sigma * rng.normal(size=x.shape)
    for _ in range(20):
        # the nozzle is as high as the bed where the firmware believes in z
        at = np.stack([x, y, z + TRIGGER], axis=-1)
        z = z + TRIGGER + bed - nozzle(travel_to(at, *firmware), *true)[..., 2]
    return np.where(np.hypot(x, y) > 80.01, np.nan, z)


def configuration(calibration: list[str], mesh: NDArray, extra: str = "") -> str:
    """A printer.cfg with a calibration and a profile, filled up as Klipper does."""
    rows = []
    for row in mesh:
        probed = np.isfinite(row)
        filled = np.interp(NODES, NODES[probed], row[probed])
        rows.append("\t" + ", ".join(f"{v:.6f}" for v in filled))
    saved = [
        "[printer]\ndelta_radius = 98.0\n[stepper_a]\narm_length = 217.0",
        "position_endstop = 251.0\n[delta_calibrate]",
        *calibration,
        "[bed_mesh default]\nversion = 1\npoints =",
        *rows,
        "x_count = 9\ny_count = 9\nmin_x = -80.0\nmax_x = 80.0",
        "min_y = -80.0\nmax_y = 80.0",
    ]
    block = "".join(f"#*# {line}\n" for part in saved for line in part.splitlines())
    steppers = "".join(
        f"[stepper_{tower}]\nmicrosteps: 16\nrotation_distance: 40\n" for tower in "abc"
    )
    start = f"[printer]\nkinematics: delta\n{steppers}{extra}"
    return f"{start}[delta_calibrate]\nradius: 70\n{HEADER}{block}"


def run(text: str, folder: Path, mesh: str = "hold-out") -> StudyResult:
    """The result of an imported configuration, without a posterior."""
    folder.mkdir()
    config = folder / "printer.cfg"
    config.write_text(text)
    path, _ = import_files("klipper", [config], folder, mesh=mesh)
    study = path.read_text()
    middle = study.index("[prediction]"), study.index("[controller]")
    plain = '[posterior]\nenabled = false\n[identify]\neffects = "none"\n'
    short = study[: middle[0]] + plain + study[middle[1] :]
    path.write_text(short)
    return stages.run_study(oed.load_study(path), folder / "out", report=False)


def _steps(travels: NDArray) -> str:
    return ",".join(f"{travel / STEP:.3f}" for travel in travels)
