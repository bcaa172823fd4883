"""Klipper: `printer.cfg` of a delta with the heights and distances of DELTA_CALIBRATE.

The saved positions are steps down from each endstop, whatever the geometry was then. The
noise gets the weights of Klipper's own fit: n distances weigh as much as n / 2 heights
(`MEASURE_WEIGHT` in klippy/extras/delta_calibrate.py).
"""

from __future__ import annotations

import math
from collections.abc import Iterator

from pkm_studies.errors import InputError
from pkm_studies.importers import klipper_config
from pkm_studies.importers.base import ImportedSession, ImportRequest, Row
from pkm_studies.importers.delta_study import DeltaGeometry, delta_study
from pkm_studies.importers.klipper_config import Entry, KlipperConfig

STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
ANGLES = (210.0, 330.0, 90.0)
SAVED = "delta_calibrate"
#: weight of a height's square over that of a distance, times heights over distances
MEASURE_WEIGHT = 0.5
#: mm; one probed height, with the bed's flatness, and one calliper distance
HEIGHT_SIGMA, DISTANCE_SIGMA = 0.1, 0.05
FULL_STEPS = 200.0
#: heights (mm) at which the accuracy is predicted, above the probed ones
RISES = (0.0, 50.0)


class KlipperImporter:
    """Reads `printer.cfg`, and the files that it includes where they are given too."""

    name = "klipper"
    about = "Klipper printer.cfg of a delta, with the readings of DELTA_CALIBRATE"

    def read(self, request: ImportRequest) -> ImportedSession:
        """Geometry, heights and distances. Raises InputError."""
        config = klipper_config.read(request.files)
        _check_delta(config)
        steps = [_step_distance(config, stepper) for stepper in STEPPERS]
        heights = list(_heights(config, steps))
        distances = list(_distances(config, steps))
        if not heights:
            remedy = "run DELTA_CALIBRATE and SAVE_CONFIG, then import the file again"
            raise config.missing(SAVED, "height0", remedy)
        geometry = _geometry(config)
        count = len(distances) // 2
        study = delta_study(
            name=request.name,
            firmware="Klipper",
            files=", ".join(path.name for path in request.files),
            geometry=geometry,
            fixed=("angle3",) if distances else ("angle3", "arm1", "arm2", "arm3"),
            fixed_because=_fixed_because(bool(distances)),
            noise=_noise(len(heights), count),
            calliper=bool(distances),
            probed_radius=config.positive(SAVED, "radius", geometry.radius / 2.0),
            heights=tuple(float(heights[0]["height_mm"]) + rise for rise in RISES),
        )
        return ImportedSession(
            study=study,
            rows=[*heights, *distances],
            statements=_statements(config, geometry, steps, len(heights), count),
        )


importer = KlipperImporter()


def _check_delta(config: KlipperConfig) -> None:
    entry = config.find("printer", "kinematics")
    if entry is not None and entry.text != "delta":
        remedy = "this importer is for delta printers; for others take `columns`"
        raise entry.error("[printer] kinematics", "this is no delta", remedy)


def _step_distance(config: KlipperConfig, stepper: str) -> float:
    """Travel of one microstep, mm."""
    old = config.find(stepper, "step_distance")
    if old is not None:
        return config.positive(stepper, "step_distance")
    rotation = config.positive(stepper, "rotation_distance")
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
        place = f"[{stepper}] gear_ratio"
        raise entry.error(place, "this is no gear ratio", "write it as 50:10") from None
    return ratio


def _geometry(config: KlipperConfig) -> DeltaGeometry:
    """The geometry in use; towers b and c take what they do not say from tower a."""
    arm = config.positive(STEPPERS[0], "arm_length")
    endstop = config.number(STEPPERS[0], "position_endstop")
    geometry = DeltaGeometry(
        radius=config.positive("printer", "delta_radius"),
        arms=tuple(config.positive(s, "arm_length", arm) for s in STEPPERS),
        angles=tuple(
            config.number(stepper, "angle", angle)
            for stepper, angle in zip(STEPPERS, ANGLES, strict=True)
        ),
        endstops=tuple(config.number(s, "position_endstop", endstop) for s in STEPPERS),
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


def _heights(config: KlipperConfig, steps: list[float]) -> Iterator[Row]:
    """Rows of probed heights, then of those typed by hand."""
    order = 0
    for prefix in ("height", "manual_height"):
        for i in config.indices(SAVED, rf"{prefix}(\d+)"):
            key, order = f"{prefix}{i}", order + 1
            height = config.number(SAVED, key)
            label = {"setup": "probe", "run": "1", "order": str(order)}
            joints = _joints(config, f"{key}_pos", steps)
            yield label | joints | {"height_mm": repr(height)}


def _distances(config: KlipperConfig, steps: list[float]) -> Iterator[Row]:
    """Two rows a distance, of which the first is the reference."""
    for i in config.indices(SAVED, r"distance(\d+)"):
        length = config.positive(SAVED, f"distance{i}")
        label = {"setup": "calliper", "run": f"distance {i}"}
        first = _joints(config, f"distance{i}_pos1", steps)
        second = _joints(config, f"distance{i}_pos2", steps)
        yield label | {"order": "1"} | first
        yield label | {"order": "2"} | second | {"length_mm": repr(length)}


def _joints(config: KlipperConfig, key: str, steps: list[float]) -> dict[str, str]:
    """Carriage travels down from the endstops, q1_mm to q3_mm."""
    entry: Entry | None = config.find(SAVED, key)
    if entry is None:
        raise config.missing(SAVED, key, "import the file as SAVE_CONFIG wrote it")
    counts = klipper_config.numbers(entry, f"[{SAVED}] {key}", len(STEPPERS))
    travels = [count * step for count, step in zip(counts, steps, strict=True)]
    return {f"q{k}_mm": repr(travel) for k, travel in enumerate(travels, start=1)}


def _noise(heights: int, distances: int) -> str:
    """The table [noise], with the weights of Klipper's fit."""
    height, distance = HEIGHT_SIGMA, DISTANCE_SIGMA
    lines = [
        "[noise]  # standard deviation of one reading, the bed's flatness included"
    ]
    if distances:
        height = distance * math.sqrt(MEASURE_WEIGHT * heights / distances)
        lines[0] = "[noise]  # standard deviation of one reading; Klipper's weights"
    lines.append(f"height_um = {1000.0 * height:.9g}")
    if distances:
        lines.append(f"length_um = {1000.0 * distance:.9g}")
    return "\n".join(lines) + "\n"


def _unused(config: KlipperConfig) -> list[str]:
    """Sentences on saved values of the geometry that the printer does not use."""
    sections = ("printer", *STEPPERS)
    return [
        f"[{section}] {key} is {config.entries[section, key].text}, as line"
        f" {config.entries[section, key].line} has it: Klipper does not use the saved"
        f" {saved.text} of line {saved.line}."
        for (section, key), saved in sorted(config.unused.items())
        if section in sections
    ]


def _fixed_because(distances: bool) -> str:
    if distances:
        return "turning all towers together only turns the printer"
    return "as Klipper does: heights alone do not give the arms"


def _statements(
    config: KlipperConfig,
    geometry: DeltaGeometry,
    steps: list[float],
    heights: int,
    distances: int,
) -> list[str]:
    arms = ", ".join(f"{arm:g}" for arm in geometry.arms)
    travel = ", ".join(f"{1000.0 * step:g}" for step in steps)
    angles = ", ".join(f"{angle:g}" for angle in geometry.angles)
    statements = [
        f"Machine: delta, radius {geometry.radius:g} mm, arms {arms} mm, towers at"
        f" {angles} deg.",
        f"Positions: steps down from the endstops, of {travel} um.",
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
    statements += _unused(config)
    probe = config.find("probe", "z_offset")
    if probe is not None:
        statements.append(
            f"The probe's z_offset {probe.text} mm is in the heights already."
        )
    return statements
