"""Klipper: `printer.cfg` of a delta with the heights and distances of DELTA_CALIBRATE.

The saved positions are steps down from each endstop, whatever the geometry was then. The
noise gets the weights of Klipper's own fit: n distances weigh as much as n / 2 heights
(`MEASURE_WEIGHT` in klippy/extras/delta_calibrate.py).
"""

import math
import re
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy.optimize import brentq

from oed.base import Array
from pkm_printers import gcode, klipper_config, klipper_rotary
from pkm_printers.bed_mesh import distinct, explanations
from pkm_printers.delta_geometry import TOWER_ANGLES, DeltaGeometry
from pkm_printers.delta_probe import ASSUMED, tilt_sentences
from pkm_printers.delta_study import (
    OTHER_MACHINES,
    DeltaStudy,
    PrinterGeometry,
    free_tilts,
    noise_table,
)
from pkm_printers.klipper_account import WORDS, config_account
from pkm_printers.klipper_config import Entry, KlipperConfig
from pkm_printers.repeated import PooledSpread, pooled, repeated_in_log
from pkm_printers.rotary_delta import RotaryGeometry
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, ImportRequest, Row
from pkm_studies.tables import ControllerTable

#: distance from the bed, over the height of the lowest endstop, of a position that is wrong
WRONG_HEIGHT_SHARE = 0.2
#: factors of the steps between which one that fits is sought
STEP_FACTORS = (0.05, 20.0)
REMEDY = (
    "these steps were saved with other microsteps, rotation_distance or gear_ratio: give"
    " those of then, or remove these positions and measure them again"
)
STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
SAVED, PROBE, NOZZLE = "delta_calibrate", "probe", "nozzle"
#: what a tower of a fork's delta adds to the radius
RADIUS_OFFSET = "delta_radius_offset"
FULL_TURN = 360.0  #: turn of the last gear of a rotary delta, degrees
#: ends of the names of files of the console, in which each sample of the probe is a line
LOGS = (".log", ".txt")
#: weight of a height's square over that of a distance, times heights over distances
MEASURE_WEIGHT = 0.5
#: standard deviation, mm, of one probed height, with the bed's flatness
HEIGHT_SIGMA = 0.1
DISTANCE_SIGMA = 0.05  #: standard deviation, mm, of one calliper distance
FULL_STEPS = 200.0
#: a saved position, and what was measured there
POSITION = re.compile(r"((?:manual_)?height\d+|distance\d+)_pos[12]?")
#: heights (mm) at which the accuracy is predicted, above the probed ones
RISES = (0.0, 50.0)
GEOMETRY_WORDS = "delta_radius, arm_length, angle and position_endstop"


class KlipperImporter:
    """Reads `printer.cfg`, and the files that it includes where they are given too."""

    name = "klipper"
    about = "Klipper printer.cfg of a delta or rotary delta, with DELTA_CALIBRATE"
    unused = ("--machine", "--map")

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry, heights and distances. Raises InputError."""
        logs = [path for path in request.files if path.suffix.lower() in LOGS]
        config = klipper_config.read([p for p in request.files if p not in logs])
        spread = pooled(repeated_in_log(gcode.read(logs)))
        is_rotary = _is_rotary(config)
        turn = FULL_TURN if is_rotary else None
        steps = [_step_distance(config, stepper, turn) for stepper in STEPPERS]
        _check_partners(config)
        unit = RotaryGeometry.unit if is_rotary else DeltaGeometry.unit
        heights = list(_heights(config, steps, unit))
        distances = list(_distances(config, steps, unit))
        if not heights:
            remedy = "run DELTA_CALIBRATE and SAVE_CONFIG, then import the file again"
            raise config.missing(SAVED, "height0", remedy)
        words = klipper_rotary.ROTARY_WORDS if is_rotary else WORDS
        account = config_account(config, request.files, words)
        read_geometry = klipper_rotary.rotary_geometry if is_rotary else linear_geometry
        geometry: PrinterGeometry = read_geometry(config)
        check_positions(_positions(config, steps), geometry)
        count = len(distances) // 2
        height = float(heights[0]["height_mm"])
        meshes, mesh_notes = distinct(klipper_config.meshes(config))
        mesh_notes += [mesh.sentence(request.mesh) for mesh in meshes]
        mesh_notes += explanations(meshes, GEOMETRY_WORDS)
        mesh_rows = [row for mesh in meshes for row in mesh.rows_at(height)]
        noise_notes = [ASSUMED if spread is None else spread.sentence()]
        setups = {row["setup"] for row in heights}
        offsets = {PROBE: klipper_config.probe_offset(config), NOZZLE: (0.0, 0.0)}
        probes = {name: offsets[name] for name in offsets if name in setups}
        free = (*geometry.of_heights, *(geometry.lengths if distances else ()))
        tilts = free_tilts(probes.values(), free, len(heights) + count, geometry)
        noise_notes += tilt_sentences(probes.values(), tilts, geometry)
        study = DeltaStudy(
            name=request.name,
            controller=_controller(geometry),
            files=", ".join(path.name for path in request.files),
            geometry=geometry,
            free=(*free, *tilts),
            probes=probes,
            noise=_noise(len(heights), count, spread, config),
            calliper=bool(distances),
            probed_radius=config.positive(SAVED, "radius", geometry.radius / 2.0),
            heights=tuple(height + rise for rise in RISES),
            accounts=[*noise_notes, *mesh_notes, *account],
            mesh_setups="".join(mesh.setup_table() for mesh in meshes),
            mesh_radius=max((mesh.radius for mesh in meshes), default=0.0),
            predict=[m.setup for m in meshes] if request.mesh == "hold-out" else [],
        )
        return ImportedSession(
            study=study.text(),
            rows=[*heights, *distances, *mesh_rows],
            statements=[
                *_statements(config, geometry, steps, len(heights), count),
                *noise_notes,
                *mesh_notes,
                *account,
            ],
        )


importer = KlipperImporter()


def _controller(geometry: PrinterGeometry) -> ControllerTable:
    """The firmware; trims of the radii say that it is a fork which has them."""
    if not isinstance(geometry, DeltaGeometry):
        return ControllerTable(firmware="klipper")
    x, y, z = geometry.radius_trim.tolist()
    return ControllerTable(firmware="klipper", radius_trim_mm=(x, y, z))


def _is_rotary(config: KlipperConfig) -> bool:
    """Whether a delta is a rotary one. Raises InputError for other machines."""
    entry = config.find("printer", "kinematics")
    if entry is None or entry.text == "delta":
        return False
    if entry.text == klipper_rotary.KINEMATICS:
        return True
    raise entry.error("[printer] kinematics", "this is no delta", OTHER_MACHINES)


def _step_distance(
    config: KlipperConfig, stepper: str, rotation: float | None
) -> float:
    """Travel of one microstep, mm, or degrees. Raises InputError.

    rotation  of the last gear, degrees; None where the file states it, in mm
    """
    old = config.find(stepper, "step_distance")
    if old is not None and rotation is None:
        return config.positive(stepper, "step_distance")
    if rotation is None:
        rotation = config.positive(stepper, "rotation_distance")
    elif config.find(stepper, "gear_ratio") is None:
        remedy = "state the gear_ratio of the arm, as Klipper wants it"
        raise config.missing(stepper, "gear_ratio", remedy)
    microsteps = config.positive(stepper, "microsteps")
    full_steps = config.positive(stepper, "full_steps_per_rotation", FULL_STEPS)
    return rotation / (full_steps * microsteps * _gear_ratio(config, stepper))


def _gear_ratio(config: KlipperConfig, stepper: str) -> float:
    """Product of the ratios in `gear_ratio: 50:10, 2:1`; 1 without."""
    entry = config.find(stepper, "gear_ratio")
    if entry is None:
        return 1.0
    ratio = 1.0
    try:
        for pair in entry.text.split(","):
            driven, driver = pair.split(":")
            ratio *= float(driven) / float(driver)
    except (ValueError, ZeroDivisionError):
        option = f"[{stepper}] gear_ratio"
        raise entry.error(
            option, "this is no gear ratio", "write it as 50:10"
        ) from None
    return ratio


def linear_geometry(config: KlipperConfig) -> DeltaGeometry:
    """The geometry in use; towers b and c default to tower a. Raises InputError."""
    arm = config.positive(STEPPERS[0], "arm_length")
    stop = config.number(STEPPERS[0], "position_endstop")
    trim = config.number(STEPPERS[0], RADIUS_OFFSET, 0.0)
    angles = zip(STEPPERS, TOWER_ANGLES.tolist(), strict=True)
    geometry = DeltaGeometry(
        radius=config.positive("printer", "delta_radius"),
        arms=np.array([config.positive(s, "arm_length", arm) for s in STEPPERS]),
        angles=np.array([config.number(s, "angle", angle) for s, angle in angles]),
        endstops=np.array(
            [config.number(s, "position_endstop", stop) for s in STEPPERS]
        ),
        radius_trim=np.array([config.number(s, RADIUS_OFFSET, trim) for s in STEPPERS]),
    )
    if geometry.radius >= min(geometry.arms):
        raise InputError(
            "the arms are not longer than the delta's radius",
            "correct arm_length or delta_radius",
            file=config.file,
            field="[printer] delta_radius",
            value=f"{geometry.radius:g}",
        )
    return geometry


def _heights(config: KlipperConfig, steps: list[float], unit: str) -> Iterator[Row]:
    """Rows of probed heights, then of those typed by hand, which are of the nozzle."""
    order = 0
    is_beside = any(klipper_config.probe_offset(config))
    setups = {"height": PROBE, "manual_height": NOZZLE if is_beside else PROBE}
    for prefix, setup in setups.items():
        for i in config.indices(SAVED, rf"{prefix}(\d+)"):
            key, order = f"{prefix}{i}", order + 1
            height = config.number(SAVED, key)
            label = {"setup": setup, "run": "1", "order": str(order)}
            joints = _joints(config, f"{key}_pos", steps, unit)
            yield label | joints | {"height_mm": repr(height)}


def _distances(config: KlipperConfig, steps: list[float], unit: str) -> Iterator[Row]:
    """Two rows a distance, of which the first is the reference."""
    for i in config.indices(SAVED, r"distance(\d+)"):
        length = config.positive(SAVED, f"distance{i}")
        label = {"setup": "calliper", "run": f"distance {i}"}
        first = _joints(config, f"distance{i}_pos1", steps, unit)
        second = _joints(config, f"distance{i}_pos2", steps, unit)
        yield label | {"order": "1"} | first
        yield label | {"order": "2"} | second | {"length_mm": repr(length)}


def _check_partners(config: KlipperConfig) -> None:
    """Refuse positions without their height or distance. Raises InputError."""
    for section, key in config.entries:
        match = POSITION.fullmatch(key) if section == SAVED else None
        if match and config.find(SAVED, match[1]) is None:
            raise config.entries[section, key].error(
                f"[{SAVED}] {key}",
                f"there is no {match[1]} for it",
                "import the file as SAVE_CONFIG wrote it, or remove the position",
            )


def _positions(
    config: KlipperConfig, steps: list[float]
) -> dict[str, tuple[Entry, list[float], float]]:
    """Saved positions by option: travels (3,) and height over the bed, mm."""
    positions = {}
    for section, key in config.entries:
        match = POSITION.fullmatch(key) if section == SAVED else None
        if match is None:
            continue
        is_height = "height" in match[1]
        height = config.number(SAVED, match[1]) if is_height else 0.0
        travels = _travels(config, key, steps)
        positions[key] = (config.entries[section, key], travels, height)
    return positions


def _joints(
    config: KlipperConfig, key: str, steps: list[float], unit: str
) -> dict[str, str]:
    """Travels down from the endstops, in this unit."""
    travels = _travels(config, key, steps)
    return {f"q{k}_{unit}": repr(travel) for k, travel in enumerate(travels, start=1)}


def _travels(config: KlipperConfig, key: str, steps: list[float]) -> list[float]:
    """Travels (3,) from the endstops. Raises InputError."""
    entry = config.find(SAVED, key)
    if entry is None:
        raise config.missing(SAVED, key, "import the file as SAVE_CONFIG wrote it")
    counts = klipper_config.numbers(entry, f"[{SAVED}] {key}", len(STEPPERS))
    return [count * step for count, step in zip(counts, steps, strict=True)]


def _noise(
    heights: int, distances: int, spread: PooledSpread | None, config: KlipperConfig
) -> str:
    """The table [noise]: of repeated readings, or assumed with the weights of Klipper's fit.

    A saved height is the mean or median of the probe's samples.
    """
    if spread is not None and spread.is_known:
        touches = max(1.0, klipper_config.probe_number(config, "samples", 1.0))
        height = 1e3 * spread.sigma / math.sqrt(touches)
        distance = 1e3 * DISTANCE_SIGMA if distances else None
        return noise_table("", round(height, 3), distance, spread.freedom)
    if not distances:
        comment = "standard deviation of one reading, the bed's flatness included"
        return noise_table(comment, 1000.0 * HEIGHT_SIGMA)
    height = DISTANCE_SIGMA * math.sqrt(MEASURE_WEIGHT * heights / distances)
    comment = "standard deviation of one reading; Klipper's weights"
    return noise_table(comment, 1000.0 * height, 1000.0 * DISTANCE_SIGMA)


def _unused(config: KlipperConfig) -> list[str]:
    """Sentences on saved values that the printer does not use."""
    sections = ("printer", SAVED, *STEPPERS)
    return [
        f"[{section}] {key} is {config.entries[section, key].text}, as line"
        f" {config.entries[section, key].line} has it: Klipper does not use the saved"
        f" {saved.text} of line {saved.line}."
        for (section, key), saved in sorted(config.unused.items())
        if section in sections
    ]


def _statements(
    config: KlipperConfig,
    geometry: PrinterGeometry,
    steps: list[float],
    heights: int,
    distances: int,
) -> list[str]:
    scale, unit = (1000.0, "um") if geometry.unit == "mm" else (1.0, geometry.unit)
    travel = ", ".join(f"{scale * step:g}" for step in steps)
    statements = [
        geometry.sentence(),
        f"Positions: steps down from the endstops, of {travel} {unit}.",
        f"Readings: {heights} probed heights as set-up probe.",
    ]
    if distances:
        statements.append(
            f"Readings: {distances} distances of two positions as set-up calliper."
        )
    else:
        statements.append(
            "There are no distances, so the arm lengths are held as Klipper holds them."
        )
    return [*statements, *_unused(config)]


# -- saved positions against where the printer can be ----------------------------------
#
# Positions are steps. Where the steps of the configuration were changed since, they are
# those of another travel, and the tool would be far off the bed, or nowhere.
def check_positions(
    positions: Mapping[str, tuple[Entry, Sequence[float], float]],
    geometry: PrinterGeometry,
) -> None:
    """Refuse positions by option, travels (3,), that miss a height, mm. Raises InputError."""
    limit = WRONG_HEIGHT_SHARE * geometry.stop
    for option, (entry, travels, height) in positions.items():
        miss = _tool_height(np.asarray(travels), geometry) - height
        if abs(miss) <= limit:
            continue
        field = f"[delta_calibrate] {option}"
        raise entry.error(field, _problem(travels, height, miss, geometry), REMEDY)


def _problem(
    travels: Sequence[float], height: float, miss: float, geometry: PrinterGeometry
) -> str:
    if np.isnan(miss):
        where = "the arms cannot reach this position"
    else:
        side = "below" if miss < 0.0 else "above"
        where = f"the tool would be {abs(miss):.0f} mm {side} the bed there"
    factor = _factor(np.asarray(travels), height, geometry)
    if factor is None:
        return where
    return f"{where}; its steps are {1.0 / factor:.3g} times those that reach the bed"


def _factor(travels: Array, height: float, geometry: PrinterGeometry) -> float | None:
    """Factor of the travels that brings the tool to a height; None where none does."""

    def miss(factor: float) -> float:
        z = _tool_height(factor * travels, geometry)
        # travels too far apart to assemble are too long
        return -1e3 if np.isnan(z) else z - height

    low, high = STEP_FACTORS
    if miss(low) <= 0.0 or miss(high) >= 0.0:
        return None
    return float(brentq(miss, low, high, xtol=1e-6))


def _tool_height(travels: Array, geometry: PrinterGeometry) -> float:
    """Height, mm, of the tool at travels (3,); NaN where the arms cannot reach it."""
    return float(geometry.tool_heights(travels[None])[0])
