"""Oracle for the firmware of delta printers: what each version does with its own words.

Written from the firmwares' documentation and kinematics (Klipper klippy/kinematics/
delta.py and extras/delta_calibrate.py; RepRapFirmware LinearDeltaKinematics.cpp and
Move::GetProbeCoordinates; Marlin module/delta.cpp, M665, M666, M503, G30, G33). Lengths
in mm, angles in degrees. It must never import the toolkit.
"""

from __future__ import annotations

import configparser
import dataclasses
import re
from collections.abc import Callable, Sequence

import numpy as np
from scipy.optimize import brentq

FRONT_LEFT, FRONT_RIGHT, BACK = 210.0, 330.0, 90.0
BASE = np.array([FRONT_LEFT, FRONT_RIGHT, BACK])


@dataclasses.dataclass
class Delta:
    """Towers at a radius and an angle each; `endstop` is the tool's height at a switch."""

    radius: np.ndarray
    arm: np.ndarray
    angle: np.ndarray
    endstop: np.ndarray

    @property
    def feet(self) -> np.ndarray:
        a = np.radians(self.angle)
        return self.radius[:, None] * np.column_stack([np.cos(a), np.sin(a)])

    @property
    def tops(self) -> np.ndarray:
        return self.endstop + np.sqrt(self.arm**2 - self.radius**2)

    def travel(self, point: Sequence[float]) -> np.ndarray:
        """Travel (3,) of the carriages down from their switches, tool at a point (3,)."""
        x, y, z = point
        across = (self.feet[:, 0] - x) ** 2 + (self.feet[:, 1] - y) ** 2
        return self.tops - z - np.sqrt(self.arm**2 - across)

    def tool(self, travel: np.ndarray) -> np.ndarray:
        """The lower of the two points at the arms' lengths from the carriages."""
        centre = np.column_stack([self.feet, self.tops - travel])
        ex = centre[1] - centre[0]
        d = np.linalg.norm(ex)
        ex = ex / d
        to_third = centre[2] - centre[0]
        i = ex @ to_third
        ey = to_third - i * ex
        j = np.linalg.norm(ey)
        ey = ey / j
        ez = np.cross(ex, ey)
        x = (self.arm[0] ** 2 - self.arm[1] ** 2 + d**2) / (2 * d)
        y = (self.arm[0] ** 2 - self.arm[2] ** 2 + i**2 + j**2 - 2 * i * x) / (2 * j)
        z = np.sqrt(self.arm[0] ** 2 - x**2 - y**2)
        side = -1.0 if ez[2] > 0.0 else 1.0
        return centre[0] + x * ex + y * ey + side * z * ez


def delta(radius, arm, angle, endstop) -> Delta:
    """A delta from numbers, or from one for all towers."""
    return Delta(
        *(np.ones(3) * np.asarray(v, float) for v in (radius, arm, angle, endstop))
    )


#: carriage travel for a commanded point
Travel = Callable[[Sequence[float]], np.ndarray]


def touch(
    travel: Travel, printer: Delta, x: float, y: float, lean: Sequence[float] = (0, 0)
) -> float:
    """The height that a firmware believes in when the nozzle of the printer is on the bed.

    The bed is the plane z = lean_x x + lean_y y. A probe beside the nozzle touches a
    higher place of a leaning bed; its trigger height, taken where the nozzle touched,
    holds that.
    """

    def over_bed(z: float) -> float:
        tool = printer.tool(travel((x, y, z)))
        return tool[2] - lean[0] * tool[0] - lean[1] * tool[1]

    return brentq(over_bed, -30.0, 30.0, xtol=1e-10)


def words(text: str) -> dict[str, str]:
    return dict(re.findall(r"([A-Z])(-?[\d.]+(?::-?[\d.]+)*)", text))


def commands(text: str) -> list[tuple[str, dict[str, str]]]:
    """Commands of a file, without comments."""
    lines = (line.partition(";")[0].split(None, 1) for line in text.splitlines())
    return [(line[0], words(line[1] if line[1:] else "")) for line in lines if line]


# -- Klipper ---------------------------------------------------------------------------


@dataclasses.dataclass
class Klipper:
    """A delta from `printer.cfg`; positions are steps down from the endstops."""

    config: configparser.ConfigParser

    @classmethod
    def of(cls, text: str) -> Klipper:
        config = configparser.ConfigParser(strict=False, inline_comment_prefixes="#;")
        config.read_string(text)
        return cls(config)

    def update(self, text: str) -> None:
        """Put the options of another file into their sections."""
        self.config.read_string(text)

    def geometry(self) -> Delta:
        towers = [f"stepper_{t}" for t in "abc"]
        radius = self.config.getfloat("printer", "delta_radius")
        columns = [
            [self.config.getfloat(tower, key) for tower in towers]
            for key in ("arm_length", "angle", "position_endstop")
        ]
        return delta(radius, *columns)

    def travel(self, point: Sequence[float]) -> np.ndarray:
        return self.geometry().travel(point)

    def step(self) -> float:
        a = self.config["stepper_a"]
        return float(a["rotation_distance"]) / (200.0 * float(a["microsteps"]))


# -- RepRapFirmware --------------------------------------------------------------------


class RepRapFirmware:
    """Version 3: rods by tower, bed tilt in percent, probe beside the nozzle."""

    def __init__(self) -> None:
        self.rods, self.radius, self.homed, self.bed = [215.0], 105.6, 240.0, 80.0
        self.lean, self.adjust = np.zeros(3), np.zeros(3)
        self.tilt, self.probe = np.zeros(2), np.zeros(2)

    def execute(self, text: str) -> None:
        """A file. M665 and M666 change the words that they have, and no others."""
        for name, w in commands(text):
            if name == "M665":
                if "L" in w:
                    self.rods = [float(v) for v in w["L"].split(":")]
                self.radius = float(w.get("R", self.radius))
                self.homed = float(w.get("H", self.homed))
                self.bed = float(w.get("B", self.bed))
                self.lean = np.array(
                    [float(w.get(k, v)) for k, v in zip("XYZ", self.lean, strict=True)]
                )
            elif name == "M666":
                old = zip("XYZ", self.adjust, strict=True)
                self.adjust = np.array([float(w.get(k, v)) for k, v in old])
                old = zip("AB", 100.0 * self.tilt, strict=True)
                self.tilt = 0.01 * np.array([float(w.get(k, v)) for k, v in old])
            elif name == "G31":
                self.probe = np.array(
                    [float(w.get(k, v)) for k, v in zip("XY", self.probe, strict=True)]
                )

    def geometry(self) -> Delta:
        rods = np.array(self.rods * (3 if len(self.rods) == 1 else 1))
        return delta(self.radius, rods, BASE + self.lean, self.homed + self.adjust)

    def travel(self, point: Sequence[float]) -> np.ndarray:
        x, y, z = point
        return self.geometry().travel((x, y, z + self.tilt[0] * x + self.tilt[1] * y))

    def probe_all(self, printer: Delta, places, sigma: float, rng, lean=(0, 0)) -> str:
        """The answer of G30 S-1 after G30 P at places (n, 2) of the probe."""
        heights = [
            touch(self.travel, printer, *(place - self.probe), lean)
            + sigma * rng.normal()
            for place in places
        ]
        cells = " ".join(f"{h:.3f}" for h in heights)
        mean, deviation = np.mean(heights), np.std(heights)
        return (
            f"G32 bed probe heights: {cells}, mean {mean:.3f}, deviation from mean"
            f" {deviation:.3f}\n"
        )


# -- Marlin ----------------------------------------------------------------------------

HEADINGS = {
    "radius": (
        "Delta settings: L<diagonal_rod> R<radius> H<height> S<segments_per_s>"
        " B<calibration radius> XYZ<tower angle corrections>"
    ),
    "trim": (
        "Delta settings: L<diagonal rod> R<radius> H<height> S<segments per sec>"
        " XYZ<tower angle trim> ABC<rod trim>"
    ),
}


class Marlin:
    """B of M665 is the radius of calibration up to 2.0.5, and a rod's trim from 2.0.6."""

    def __init__(self, version: str) -> None:
        self.version = version
        numbers = tuple(int(v) for v in version.split("."))
        self.b = "radius" if numbers < (2, 0, 6) else "trim"
        self.m = {k: 0.0 for k in "LRHSBXYZAC"} | {"S": 100.0}
        self.adjust = dict.fromkeys("XYZ", 0.0)
        self.probe: dict[str, float] | None = None
        self.stored = False

    def execute(self, text: str) -> None:
        """A file. Letters that a version does not have change nothing."""
        known = "LRHSBXYZ" if self.b == "radius" else "LRHSXYZABC"
        for name, w in commands(text):
            if name == "M665":
                self.m |= {k: float(v) for k, v in w.items() if k in known}
            elif name == "M666":
                assert all(float(v) <= 0.0 for v in w.values())
                self.adjust |= {k: float(v) for k, v in w.items()}
            elif name == "M500":
                self.stored = True

    def geometry(self) -> Delta:
        trim = [self.m[k] if self.b == "trim" else 0.0 for k in "ABC"]
        lean = [self.m[k] for k in "XYZ"]
        # home ends `adjust` (zero or less) from the switch, and counts as height H there
        switch = self.m["H"] - np.array([self.adjust[k] for k in "XYZ"])
        return delta(self.m["R"], self.m["L"] + np.array(trim), BASE + lean, switch)

    def travel(self, point: Sequence[float]) -> np.ndarray:
        return self.geometry().travel(point)

    def settings(self) -> str:
        """The answers of M115 and M503, as a host logs them."""
        semicolon = "" if self.version.startswith("1.") else "; "
        order = "LRHSBXYZ" if self.b == "radius" else "LRHSXYZABC"
        adjust = " ".join(f"{k}{v:.2f}" for k, v in self.adjust.items())
        lines = [
            f"FIRMWARE_NAME:Marlin {self.version} (Github) PROTOCOL_VERSION:1.0",
            f"echo:{semicolon}Endstop adjustment:",
            f"echo:  M666 {adjust}",
            f"echo:{semicolon}{HEADINGS[self.b]}",
            "echo:  M665 " + " ".join(f"{k}{self.m[k]:.2f}" for k in order),
        ]
        if self.probe is not None:
            x, y = self.probe["X"], self.probe["Y"]
            lines.append(f"echo:  M851 X{x:.2f} Y{y:.2f} Z-1.25")
        return "".join(f"Recv: {line}\n" for line in lines)

    def probe_all(self, printer: Delta, places, sigma: float, rng) -> str:
        """The answers of G30 at places (n, 2) of the probe."""
        offset = np.zeros(2)
        if self.probe is not None:
            offset = np.array([self.probe["X"], self.probe["Y"]])
        lines = []
        for place in np.round(places, 2):
            z = touch(self.travel, printer, *(place - offset)) + sigma * rng.normal()
            lines.append(f"Recv: Bed X: {place[0]:.2f} Y: {place[1]:.2f} Z: {z:.2f}\n")
        return "".join(lines)
