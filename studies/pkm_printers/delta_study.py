"""The study of a delta printer: its geometry in the file's numbers, its set-ups."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Mapping, Sequence

from pkm_printers import words
from pkm_studies.importers import readings_name

#: model of a delta with one radius, and of one with a radius for each tower
MODEL, FAMILY = "linear_delta", "delta"
TOWERS = (1, 2, 3)
#: share of the probed radius that the accuracy is predicted on
SHARE = 0.7
#: half the workspace's width over the delta's radius, at least
WIDTH_SHARE = 0.8
#: correlation of the errors of the three radii: their differences are held within 10 um
COMMON = 0.999998
#: standard deviations of an assembled printer's numbers about those of its firmware
TOLERANCES = """\
# How far the true numbers may be from those of the firmware (standard deviations).
[[prior.tolerance]]
parameters = ["radius*", "endstop*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["arm*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["angle*"]
sigma_deg = 2.0
"""
COMMON_RADIUS = f"""
# The firmware has one radius; its trims by tower are taken as right.
[[prior.correlated]]
parameters = ["radius*"]
correlation = {COMMON}
"""
CALLIPER = """
[[setup]]
name = "calliper"
instrument = "calliper"
tolerance = { scale = 0.0 }  # the firmware takes the object's size as exact
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeltaGeometry:
    """A delta as its firmware knows it; mm and deg, as in the firmware's files.

    radius       from the middle to a carriage, less the platform's radius
    arms         arm lengths (3,)
    angles       of the towers (3,), counter-clockwise from x
    endstops     height (3,) of the tool over the bed at each endstop
    radius_trim  (3,) what each tower adds to the radius
    """

    radius: float
    arms: tuple[float, ...]
    angles: tuple[float, ...]
    endstops: tuple[float, ...]
    radius_trim: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def radii(self) -> tuple[float, ...]:
        """Radius (3,) of each tower."""
        return tuple(self.radius + trim for trim in self.radius_trim)

    @property
    def has_radii(self) -> bool:
        """Whether the towers have radii of their own."""
        return any(self.radius_trim)

    @property
    def model(self) -> str:
        """The model of the study."""
        return FAMILY if self.has_radii else MODEL

    @property
    def further_fixed(self) -> tuple[str, ...]:
        """Parameters of the model that no firmware has."""
        stems = ("lean", "tip") if self.has_radii else ()
        return tuple(f"{stem}{i}" for stem in stems for i in TOWERS)

    def table(self) -> str:
        """The table [machine.nominal] of a study."""
        radii = {"radius": self.radius}
        if self.has_radii:
            radii = _tower_values("radius", self.radii)
        lines = [f"{name}_mm = {value!r}" for name, value in radii.items()]
        for stem, values, unit in (
            ("arm", self.arms, "mm"),
            ("angle", self.angles, "deg"),
            ("endstop", self.endstops, "mm"),
        ):
            numbers = _tower_values(stem, values)
            lines += [f"{name}_{unit} = {value!r}" for name, value in numbers.items()]
        return "\n".join(["[machine.nominal]", *lines, ""])

    def sentence(self) -> str:
        """The geometry in words."""
        radius = f"radius {self.radius:g} mm"
        if self.has_radii:
            radius = f"radii {_listed(self.radii)} mm"
        return (
            f"Machine: delta, {radius}, arms {_listed(self.arms)} mm, towers at"
            f" {_listed(self.angles)} deg, endstops at {_listed(self.endstops)} mm."
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Firmware:
    """The firmware of a printer, for the table [controller].

    name, title     as in `oed compensate --to`, and as people write it
    version         where the files show it
    m665_b          what M665 B is, for Marlin
    keep            words that are written back as they are, by command
    radius_trim_mm  and
    rod_trim_mm     trims (3,) of the towers that stay in the firmware
    """

    name: str
    title: str
    version: str | None = None
    m665_b: str | None = None
    file: str | None = None
    home_offset_mm: float | str | None = None
    probe_z_mm: float | None = None
    steps_per_mm: float | None = None
    keep: Mapping[str, str] = dataclasses.field(default_factory=dict)
    radius_trim_mm: tuple[float, ...] = ()
    rod_trim_mm: tuple[float, ...] = ()

    def table(self) -> str:
        """The table [controller] of a study."""
        lines = ["[controller]  # for `oed compensate`", f'firmware = "{self.name}"']
        if self.version is not None:
            lines.append(f"version = {json.dumps(self.version)}")
        for name in ("m665_b", "file"):
            text = getattr(self, name)
            if text is not None:
                lines.append(f"{name} = {json.dumps(text)}")
        for name in ("home_offset_mm", "probe_z_mm", "steps_per_mm"):
            value = getattr(self, name)
            if value is not None:
                text = json.dumps(value) if isinstance(value, str) else f"{value:.9g}"
                lines.append(f"{name} = {text}")
        for name in ("radius_trim_mm", "rod_trim_mm"):
            trims = getattr(self, name)
            if any(trims):
                lines.append(f"{name} = {list(trims)}  # stays in the firmware")
        texts = [f"{name} = {json.dumps(w)}" for name, w in self.keep.items() if w]
        if texts:
            lines.append(f"keep = {{ {', '.join(texts)} }}  # written back as it is")
        return "\n".join([*lines, ""])


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeltaStudy:
    """What the study of a delta printer says.

    fixed          parameters that are not identified, and why in `fixed_because`
    noise          the lines of [noise]
    calliper       whether distances were read as well
    probed_radius  mm, of the bed
    heights        mm, at which the accuracy is predicted
    bed_slope_ppm  rise (2,) of the bed along x and y
    accounts       sentences on what became of the words of the files
    mesh_setups    tables [[setup]] of bed meshes
    mesh_radius    mm, of their places
    predict        set-ups that are predicted, not fitted
    has_probe      whether there are readings of the set-up `probe`
    """

    name: str
    firmware: Firmware
    files: str
    geometry: DeltaGeometry
    fixed: tuple[str, ...]
    fixed_because: str
    noise: str
    calliper: bool
    probed_radius: float
    heights: tuple[float, ...]
    bed_slope_ppm: tuple[float, float] = (0.0, 0.0)
    accounts: Sequence[str] = ()
    mesh_setups: str = ""
    mesh_radius: float = 0.0
    predict: Sequence[str] = ()
    has_probe: bool = True

    @property
    def title(self) -> str:
        """The title of the report; Klipper's printer.cfg names nothing."""
        return (
            "Delta printer" if self.name == "printer" else f"Delta printer {self.name}"
        )

    def text(self) -> str:
        """The text of the study."""
        fixed = (*self.fixed, *self.geometry.further_fixed)
        listed = ", ".join(f'"{parameter}"' for parameter in fixed)
        reach = round(SHARE * self.probed_radius, 1)
        tolerances = TOLERANCES
        if self.geometry.has_radii:
            tolerances += COMMON_RADIUS
        return f"""\
# A delta printer, imported from {self.files}: geometry and readings of {self.firmware.title}.
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
fixed = [{listed}]  # {self.fixed_because}

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

{self.firmware.table()}"""

    def _workspace(self) -> str:
        """The tables of workspace, home and travel, after the printer's size; mm."""
        geometry = self.geometry
        probed = max(self.probed_radius, self.mesh_radius)
        width = max(1.05 * probed, WIDTH_SHARE * geometry.radius)
        width = round(width, 1)
        stop = min(geometry.endstops)
        low, high = round(-0.1 * stop, 1), round(0.9 * stop, 1)
        travel = round(max(geometry.endstops) + max(geometry.arms), 1)
        joints = "\n".join(f"q{i}_mm = [{-travel}, {travel}]" for i in TOWERS)
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
        """The probe, and the calliper where distances were read."""
        if not self.has_probe:
            return self.mesh_setups
        lines = [
            "[[setup]]",
            'name = "probe"',
            'instrument = "contact_probe"',
            "tolerance = { offset_mm = 0.0 }  # the firmware takes the trigger height as"
            " exact",
        ]
        text = "\n".join([*lines, slope_lines(self.bed_slope_ppm)])
        calliper = CALLIPER if self.calliper else ""
        return text + calliper + self.mesh_setups

    def _predict(self) -> str:
        """Which set-ups are held out of the fit."""
        if not self.predict:
            return ""
        listed = ", ".join(json.dumps(name) for name in self.predict)
        return f"predict = [{listed}]  # held out of the fit, to see whether it holds\n"


def slope_lines(slope_ppm: tuple[float, float]) -> str:
    """The lines of a set-up on how the bed rises; none for a level one."""
    lines = [
        f"bed_slope_{axis}_ppm = {slope!r}  # the firmware raises z by it\n"
        for axis, slope in zip("xy", slope_ppm, strict=True)
        if slope
    ]
    return "".join(lines)


def noise_table(comment: str, height: float, distance: float | None = None) -> str:
    """The table [noise] of an assumed noise; um."""
    lines = [
        f"[noise]  # {comment}",
        "assumed = true  # nobody measured it: give your probe's standard deviation",
        f"height_um = {height:.9g}",
    ]
    if distance is not None:
        lines.append(f"length_um = {distance:.9g}")
    return "\n".join([*lines, ""])


def _tower_values(stem: str, values: Sequence[float]) -> dict[str, float]:
    return {f"{stem}{i}": value for i, value in zip(TOWERS, values, strict=True)}


def _listed(values: Sequence[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)
