"""What became of the options of a Klipper configuration.

Words after Klipper's configuration reference, with the options of older versions.
"""

import functools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final

from pkm_printers.klipper_config import PREFIX, PROBES, KlipperConfig, other_probes
from pkm_printers.words import (
    HARMLESS,
    OTHERS,
    READ,
    Word,
    WordTable,
    WrittenWord,
    account,
    cost_sentence,
    costs,
    options,
    refused,
    same,
)

IN_HEIGHTS: Final = costs(
    "the saved heights have it already; an error of it moves all of z"
)
BESIDE: Final = costs(
    "the saved positions are those of the carriages at contact, so that only the places of"
    " meshes take it; a probe beside the nozzle also reads how the platform tilts"
)
NOT_THE_CALIBRATION: Final = (
    "it moves the tool after calibration, and is not in the saved positions: clear it,"
    " or compensate without it"
)

#: of the firmware of FLSun's printers
SIZE_OFFSETS: Final = ("x_size_offset", "y_size_offset")
PRINTER: Final[dict[str, Word]] = {
    **same(
        refused(
            "a fork of the firmware changes the size of prints by it",
            "set it to 0 in the printer, and calibrate again",
        ),
        SIZE_OFFSETS,
    ),
    **same(READ, ("kinematics", "delta_radius")),
    **same(
        HARMLESS,
        options(
            "max_velocity max_accel max_accel_to_decel minimum_cruise_ratio"
            " square_corner_velocity max_z_velocity max_z_accel minimum_z_position"
            " print_radius"
        ),
    ),
}
STEPPER: Final[dict[str, Word]] = {
    **same(
        READ,
        options(
            "arm_length angle position_endstop rotation_distance microsteps"
            " full_steps_per_rotation gear_ratio step_distance"
            " delta_radius_offset"  # of the fork thhdragon/klipper
        ),
    ),
    **same(
        HARMLESS,
        options(
            "step_pin dir_pin enable_pin step_pulse_duration endstop_pin position_min"
            " position_max homing_speed homing_retract_dist homing_retract_speed"
            " second_homing_speed homing_positive_dir homing_accel"
            " homing_stepper_phases homing_endstop_accuracy homing_endstop_phase"
            " homing_endstop_align_zero min_home_dist use_sensorless_homing"
        ),
    ),
}
PLACE: Final[dict[str, Word]] = {
    "z_offset": IN_HEIGHTS,
    **same(BESIDE, ("x_offset", "y_offset")),
}
PROBE: Final[dict[str, Word]] = {
    **PLACE,
    **same(
        HARMLESS,
        options(
            "pin deactivate_on_each_sample speed samples sample_retract_dist"
            " lift_speed samples_result samples_tolerance samples_tolerance_retries"
            " drop_first_result activate_gcode deactivate_gcode recovery_time"
            " sensor_pin control_pin pin_move_time stow_on_each_sample"
            " probe_with_touch_mode pin_up_reports_not_triggered"
            " pin_up_touch_mode_reports_triggered set_output_mode probe_accel"
        ),
    ),
}
CALIBRATE: Final[dict[str, Word]] = {
    **same(
        READ,
        options(
            "radius height<n> height<n>_pos manual_height<n> manual_height<n>_pos"
            " distance<n> distance<n>_pos1 distance<n>_pos2"
        ),
    ),
    **same(
        HARMLESS,
        options(
            "points speed horizontal_move_z samples sample_retract_dist manual_probe"
            " use_probe_xy_offsets"
        ),
    ),
}
PROFILES: Final = "[bed_mesh <profile>]"  #: all saved profiles of meshes
LEVEL_OF_MESH: Final = costs(
    "it sets the level of a mesh, which counts for nothing here"
)
PROFILE: Final[dict[str, Word]] = {
    **same(READ, ("points", "x_count", "y_count", "min_x", "max_x", "min_y", "max_y")),
    **same(HARMLESS, ("version", "mesh_x_pps", "mesh_y_pps", "algo", "tension")),
}
BED_MESH: Final[dict[str, Word]] = {
    **same(READ, ("faulty_region_<n>_min", "faulty_region_<n>_max")),
    **same(LEVEL_OF_MESH, ("zero_reference_position", "relative_reference_index")),
    **same(
        HARMLESS,
        options(
            "speed horizontal_move_z mesh_radius mesh_origin mesh_min mesh_max"
            " probe_count round_probe_count mesh_pps algorithm bicubic_tension"
            " fade_start fade_end fade_target split_delta_z move_check_distance"
            " adaptive_margin scan_overshoot"
        ),
    ),
    OTHERS: costs(
        "this importer does not know it; a mesh may mean other heights by it"
    ),
}
WORDS: Final[WordTable] = {
    "[bed_mesh]": BED_MESH,
    PROFILES: PROFILE,
    "[printer]": PRINTER,
    **{f"[stepper_{tower}]": STEPPER for tower in "abc"},
    "[delta_calibrate]": CALIBRATE,
    **{f"[{name}]": PROBE for name in PROBES},
}
#: sections that move the tool in other ways than by the delta's geometry
COSTLY_SECTIONS: Final[dict[str, str]] = {
    "bed_mesh": (
        "the mesh in use moves the tool after calibration: probe it again once the printer"
        " has new numbers"
    ),
    "bed_tilt": NOT_THE_CALIBRATION,
    "skew_correction": NOT_THE_CALIBRATION,
    "axis_twist_compensation": (
        "heights probed since it was calibrated have it in them, earlier ones do not; an"
        " error of it bends all heights along its axis"
    ),
    **dict.fromkeys(
        ("z_tilt", "z_tilt_ng"),
        "it moves single towers until the printer homes again: heights that were probed in"
        " between have that in them",
    ),
    "z_thermal_adjust": NOT_THE_CALIBRATION,
}
INCLUDE = "include "
INCLUDED = (
    "their options win over those above them; give these files too where they have any of"
    " [printer], [stepper_*] or [delta_calibrate]"
)


def config_account(
    config: KlipperConfig, files: Sequence[Path], table: WordTable
) -> list[str]:
    """Sentences on the options read and not read. Raises InputError.

    files  that were given
    table  words of the kinematics
    """
    other = {**PLACE, OTHERS: HARMLESS}
    words = {**table, **{f"[{name}]": other for name in other_probes(config)}}
    zeros = [key for key in SIZE_OFFSETS if config.number("printer", key, 0.0) == 0.0]
    words["[printer]"] = {**table["[printer]"], **same(HARMLESS, zeros)}
    plain = [
        _group(name, words)
        for name in config.sections
        if _kind(name) not in COSTLY_SECTIONS and not name.startswith(INCLUDE)
    ]
    accounts = account(_written(config, words), plain, words)
    return [*accounts, *_costly(config), *_included(config, files)]


def _group(name: str, words: WordTable) -> str:
    """A section in brackets; all of one kind alike where none of them is read."""
    group = _section_group(name.lower())
    return group if group in words else f"[{_kind(name)}]"


def _section_group(section: str) -> str:
    """The group of a section's words: all profiles of meshes alike."""
    return PROFILES if section.startswith(PREFIX) else f"[{section}]"


def _kind(name: str) -> str:
    """The kind of a section: `bed_mesh` of `bed_mesh default`."""
    return name.lower().partition(" ")[0]


def _written(config: KlipperConfig, words: WordTable) -> Iterator[WrittenWord]:
    """The options of the sections that bear on the delta and its probe."""
    for (section, key), entry in config.entries.items():
        group = _section_group(section)
        if group in words:
            error = functools.partial(entry.error, f"[{section}] {key}")
            yield WrittenWord(group, key, entry.text, entry.line, error)


def _costly(config: KlipperConfig) -> list[str]:
    """Sentences on sections that move the tool in other ways than the geometry."""
    alike: dict[str, dict[str, int]] = {}
    for section, line in config.sections.items():
        about = COSTLY_SECTIONS.get(_kind(section))
        if about is not None:
            alike.setdefault(about, {}).setdefault(f"[{_kind(section)}]", line)
    return [cost_sentence(places, about) for about, places in alike.items()]


def _included(config: KlipperConfig, files: Sequence[Path]) -> list[str]:
    file_names = {path.name for path in files}
    places = {
        f"[{section}]": line
        for section, line in config.sections.items()
        if section.startswith(INCLUDE)
        and Path(section.removeprefix(INCLUDE).strip()).name not in file_names
    }
    return [cost_sentence(places, INCLUDED)] if places else []
