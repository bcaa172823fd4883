"""The study of a delta printer: its geometry in the file's numbers, its set-ups."""

import dataclasses
import json
from collections.abc import Iterable, Mapping, Sequence

import msgspec
import tomli_w

from pkm_printers import words
from pkm_printers.delta_geometry import TOWERS, DeltaGeometry
from pkm_printers.rotary_delta import RotaryGeometry
from pkm_studies.importers import readings_name
from pkm_studies.tables import ControllerTable

#: what to do with other machines
OTHER_MACHINES = (
    "this importer is for deltas and rotary deltas; take `columns` with a map that states the"
    " machine, or for a Hangprinter `hangprinter`"
)
PrinterGeometry = DeltaGeometry | RotaryGeometry
#: firmwares as people write them
TITLES = {
    "klipper": "Klipper",
    "marlin": "Marlin",
    "rrf": "RepRapFirmware",
    "smoothie": "Smoothieware",
}
Offset = tuple[float, float]  #: place (2,) of a probe from the nozzle, mm
#: share of the probed radius that the accuracy is predicted on
PREDICTED_RADIUS_SHARE = 0.7
#: correlation of the errors of the three arms: their differences are held within 10 um
ARM_ERROR_CORRELATION = 0.999998
SPARE_HEIGHTS = 4  #: further heights that estimate how far they scatter
FIXED_BECAUSE = "not among what is fitted; heights alone give the arms badly"
EXACT_TRIGGER = "the firmware takes the trigger height as exact"
COMMON_ARM = f"""
# The firmware has one length of the rods.
[[prior.correlated]]
parameters = ["arm*"]
correlation = {ARM_ERROR_CORRELATION}
"""
CALLIPER = """
[[setup]]
name = "calliper"
instrument = "calliper"
tolerance = { scale = 0.0 }  # the firmware takes the object's size as exact
"""


def controller_text(controller: ControllerTable) -> str:
    """The table [controller] of a study, for `oed compensate`."""
    plain = msgspec.to_builtins(controller)
    defaults = msgspec.to_builtins(ControllerTable(firmware=""))
    stated = {name: value for name, value in plain.items() if value != defaults[name]}
    return tomli_w.dumps({"controller": stated})


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeltaStudy:
    """What the study of a delta printer says."""

    name: str
    controller: ControllerTable  #: the firmware
    files: str
    geometry: PrinterGeometry
    free: tuple[str, ...]  #: parameters that are identified
    noise: str  #: the lines of [noise]
    calliper: bool  #: whether distances were read as well
    probed_radius: float  #: mm, of the bed
    heights: tuple[float, ...]  #: mm, at which the accuracy is predicted
    #: places (2,) from the nozzle, mm, of the probes that read, by set-up
    probes: Mapping[str, Offset]
    accounts: Sequence[str] = ()  #: sentences on what became of the words of the files
    mesh_setups: str = ""  #: tables [[setup]] of bed meshes
    mesh_radius: float = 0.0  #: mm, of their places
    predict: Sequence[str] = ()  #: set-ups that are predicted, not fitted

    @property
    def title(self) -> str:
        """The title of the report; printer.cfg and config.g name nothing."""
        is_unnamed = self.name in ("printer", "config")
        about = self.geometry.about.capitalize()
        return about if is_unnamed else f"{about} {self.name}"

    def text(self) -> str:
        """The text of the study."""
        fixed = (p for p in self.geometry.parameters if p not in self.free)
        listed = ", ".join(f'"{parameter}"' for parameter in fixed)
        reach = round(PREDICTED_RADIUS_SHARE * self.probed_radius, 1)
        tolerances = self.geometry.tolerances
        if "arm1" in self.free and not self.calliper:
            tolerances += COMMON_ARM
        return f"""\
# A {self.geometry.about}, imported from {self.files}: geometry and readings of {TITLES[self.controller.firmware]}.
# `oed run` calibrates it; every number has its unit in the name of its field.
#
{words.comments(self.accounts)}
schema = 1
name = "{self.name}"
title = "{self.title}"
question = "What do the readings say about the geometry, and how accurate is it then?"
seed = 1

[machine]
model = "{self.geometry.model}"
fixed = [{listed}]  # {FIXED_BECAUSE}

# The geometry that the firmware has now.
{self.geometry.table()}
{self._workspace()}
{self._setups()}
{self.noise}
{tolerances}
[readings]
files = ["{readings_name(self.name)}"]
{self._predict()}
[prediction]
reference = "home"
x_mm = [{-reach}, 0.0, {reach}]
y_mm = [{-reach}, 0.0, {reach}]
z_mm = {[float(h) for h in self.heights]}

{controller_text(self.controller)}"""

    def _workspace(self) -> str:
        """The tables of workspace, home and travel, after the printer's size; mm."""
        geometry = self.geometry
        probed = max(self.probed_radius, self.mesh_radius)
        # ranges move with the tool of a set-up; a command is that of the nozzle
        offsets = [abs(v) for probe in self.probes.values() for v in probe]
        width = max(1.05 * probed, geometry.half_width)
        width += max(offsets, default=0.0)
        width = round(width, 1)
        stop = geometry.stop
        low, high = round(-0.1 * stop, 1), round(0.9 * stop, 1)
        travel, unit = geometry.travel, geometry.unit
        joints = "\n".join(f"q{i}_{unit} = [{-travel}, {travel}]" for i in TOWERS)
        return f"""\
[machine.workspace]
x_mm = [{-width}, {width}]
y_mm = [{-width}, {width}]
z_mm = [{low}, {high}]

[machine.home]
z_mm = {round(0.05 * stop, 1)}

[machine.travel]
{joints}
"""

    def _setups(self) -> str:
        """The probes, and the calliper where distances were read."""
        probes = [
            setup_table(name, offset, 0.0, EXACT_TRIGGER)
            for name, offset in self.probes.items()
        ]
        calliper = CALLIPER if self.calliper else ""
        return "".join(probes) + calliper + self.mesh_setups

    def _predict(self) -> str:
        """Which set-ups are held out of the fit."""
        if not self.predict:
            return ""
        listed = ", ".join(json.dumps(name) for name in self.predict)
        return f"predict = [{listed}]  # held out of the fit, to see whether it holds\n"


def setup_table(name: str, offset: Offset, level_mm: float, why: str) -> str:
    """The table [[setup]] of a probe at an offset (2,), mm, from the nozzle.

    level_mm  standard deviation of the height at which it triggers, and why
    """
    tool = ""
    if any(offset):
        x, y = offset
        tool = f"tool_mm = [{x!r}, {y!r}, 0.0]  # the probe, from the nozzle\n"
    return f"""
[[setup]]
name = "{name}"
instrument = "contact_probe"
tolerance = {{ offset_mm = {level_mm} }}  # {why}
{tool}"""


def free_tilts(
    probes: Iterable[Offset], free: Sequence[str], count: int, geometry: PrinterGeometry
) -> tuple[str, ...]:
    """Tilts that are fitted beside what is free: of probes beside the nozzle, many heights."""
    tilting = geometry.tilting
    is_many = count >= len(free) + len(tilting) + SPARE_HEIGHTS
    return tilting if is_many and any(map(any, probes)) else ()


def noise_table(
    comment: str,
    height: float,
    distance: float | None = None,
    freedom: int | None = None,
) -> str:
    """The table [noise], um, of repeated readings with degrees of freedom, or assumed."""
    origin = (
        "assumed = true  # nobody measured it: give your probe's standard deviation"
    )
    if freedom is not None:
        comment = f"repeated readings, {freedom} degrees of freedom"
        origin = (
            "estimate = true  # they do not show how flat the bed is\ncarried = 0.0"
        )
    lines = [f"[noise]  # {comment}", origin, f"height_um = {height:.9g}"]
    if distance is not None:
        lines.append(f"length_um = {distance:.9g}")
    return "\n".join([*lines, ""])
