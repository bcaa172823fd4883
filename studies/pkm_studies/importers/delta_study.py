"""The study of a delta printer: its geometry in the file's numbers, its set-ups."""

from __future__ import annotations

import dataclasses

from pkm_studies.importers.base import readings_name

MODEL = "linear_delta"
TOWERS = (1, 2, 3)
#: share of the probed radius that the accuracy is predicted on
SHARE = 0.7
#: half the workspace's width over the delta's radius, at least
WIDTH_SHARE = 0.8
#: standard deviations of an assembled printer's numbers about those of its firmware
TOLERANCES = """\
# How far the true numbers may be from those of the firmware (standard deviations).
[[prior.tolerance]]
parameters = ["radius", "endstop*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["arm*"]
sigma_mm = 5.0

[[prior.tolerance]]
parameters = ["angle*"]
sigma_deg = 2.0
"""
PROBE = """\
[[setup]]
name = "probe"
instrument = "height_probe"
tolerance = { offset_mm = 0.0 }  # the firmware takes the trigger height as exact
"""
CALLIPER = """\
[[setup]]
name = "calliper"
instrument = "calliper"
tolerance = { scale = 0.0 }  # the firmware takes the object's size as exact
"""


@dataclasses.dataclass(frozen=True, kw_only=True)
class DeltaGeometry:
    """A delta as its firmware knows it; mm and deg, as in the firmware's files.

    radius    from the middle to a carriage, less the platform's radius
    arms      arm lengths (3,)
    angles    of the towers (3,), counter-clockwise from x
    endstops  height (3,) of the tool over the bed at each endstop
    """

    radius: float
    arms: tuple[float, ...]
    angles: tuple[float, ...]
    endstops: tuple[float, ...]

    def table(self) -> str:
        """The table [machine.nominal] of a study."""
        lines = ["[machine.nominal]", f"radius_mm = {self.radius!r}"]
        lines += [f"arm{i}_mm = {v!r}" for i, v in zip(TOWERS, self.arms, strict=True)]
        pairs = zip(TOWERS, self.angles, strict=True)
        lines += [f"angle{i}_deg = {v!r}" for i, v in pairs]
        stops = zip(TOWERS, self.endstops, strict=True)
        lines += [f"endstop{i}_mm = {v!r}" for i, v in stops]
        return "\n".join(lines) + "\n"


def delta_study(
    *,
    name: str,
    firmware: str,
    files: str,
    geometry: DeltaGeometry,
    fixed: tuple[str, ...],
    fixed_because: str,
    noise: str,
    calliper: bool,
    probed_radius: float,
    heights: tuple[float, ...],
) -> str:
    """The text of the study.

    fixed          parameters that are not identified, and why in `fixed_because`
    noise          the lines of [noise]
    calliper       whether distances were read as well
    probed_radius  mm, of the bed
    heights        mm, at which the accuracy is predicted
    """
    listed = ", ".join(f'"{parameter}"' for parameter in fixed)
    reach = round(SHARE * probed_radius, 1)
    setups = PROBE + "\n" + CALLIPER if calliper else PROBE
    return f"""\
# A delta printer, imported from {files}: geometry and readings of {firmware}.
# `oed run` calibrates it; every number has its unit in the name of its field.

schema = 1
name = "{name}"
title = "Delta printer {name}"
question = "What do the readings say about the geometry, and how accurate is it then?"
seed = 1

[machine]
model = "{MODEL}"
fixed = [{listed}]  # {fixed_because}

# The geometry that the firmware has now.
{geometry.table()}
{_workspace(geometry, probed_radius)}
{setups}
{noise}
{TOLERANCES}
[readings]
files = ["{readings_name(name)}"]

[prediction]
reference = "home"
x_mm = [{-reach}, 0.0, {reach}]
y_mm = [{-reach}, 0.0, {reach}]
z_mm = {[float(h) for h in heights]}
"""


def _workspace(geometry: DeltaGeometry, probed_radius: float) -> str:
    """The tables of workspace, home and travel, after the printer's size; mm."""
    width = round(max(1.05 * probed_radius, WIDTH_SHARE * geometry.radius), 1)
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
