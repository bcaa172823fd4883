"""RepRapFirmware 3: M665, M666, G31, M558, and the heights of G32 for a delta.

After src/Movement/Kinematics/LinearDeltaKinematics.cpp, src/GCodes/GCodes6.cpp and
src/Endstops/ZProbe.cpp of 3.5.

- A carriage homes to H + sqrt(L^2 - R^2) + M666; M666 A and B, in percent, raise z.
- G30 P puts the probe on its place, with the G31 of that moment; a height error is the
  believed height less G31 Z and H of G30. Z above -9999 is a height that was typed, at the
  place of the nozzle.
- M558 P makes the probe anew, with G31 X0 Y0 Z0.7. Letters may be small.
"""

from __future__ import annotations

import re

import numpy as np

from oracles.firmware.geometry import BASE, Probe, carriages, contact, towers

TYPED = -9999.0


def gcode(text: str) -> list[tuple[str, dict[str, str]]]:
    """Commands with their words; several may stand in a line."""
    commands = []
    for line in text.splitlines():
        code = re.sub(r'"[^"]*"', "0", line.split(";")[0]).upper()
        for part in re.split(r"(?=\b[GM]\d+\b)", code):
            head = re.match(r"[GM]\d+", part)
            if head:
                words = re.findall(r"([A-Z])\s*([-+\d.:]*)", part[head.end() :])
                commands.append((head[0], dict(words)))
    return commands


class RepRapFirmware:
    """Executes configuration files in their order, and bed.g."""

    def __init__(self, *texts: str) -> None:
        self.rods, self.radius, self.height, self.bed = (
            np.full(3, 215.0), 105.6, 240.0, 80.0,
        )  # fmt: skip
        self.lean, self.adjust, self.tilt = np.zeros(3), np.zeros(3), np.zeros(2)
        self.offset = np.array([0.0, 0.0, 0.7])
        for text in texts:
            self.apply(text)

    def apply(self, text: str) -> RepRapFirmware:
        for name, words in gcode(text):
            take = getattr(self, f"_{name.lower()}", None)
            if take is not None:
                take(words)
        return self

    def _m665(self, w: dict[str, str]) -> None:
        if "L" in w:
            rods = [float(v) for v in w["L"].split(":")]
            self.rods = np.array(rods if len(rods) == 3 else rods * 3)
        self.radius = float(w.get("R", self.radius))
        self.height, self.bed = (
            float(w.get("H", self.height)),
            float(w.get("B", self.bed)),
        )
        self.lean = np.array(
            [float(w.get(k, v)) for k, v in zip("XYZ", self.lean, strict=True)]
        )

    def _m666(self, w: dict[str, str]) -> None:
        self.adjust = np.array(
            [float(w.get(k, v)) for k, v in zip("XYZ", self.adjust, strict=True)]
        )
        percent = zip("AB", 100.0 * self.tilt, strict=True)
        self.tilt = 0.01 * np.array([float(w.get(k, v)) for k, v in percent])

    def _m558(self, w: dict[str, str]) -> None:
        if "P" in w:
            self.offset = np.array([0.0, 0.0, 0.7])

    def _g31(self, w: dict[str, str]) -> None:
        pairs = zip("XYZ", self.offset, strict=True)
        self.offset = np.array([float(w.get(k, v)) for k, v in pairs])

    # -- kinematics --------------------------------------------------------------------
    @property
    def endstops(self) -> np.ndarray:
        return self.height + self.adjust

    @property
    def angles(self) -> np.ndarray:
        return BASE + self.lean

    def travel(self, points) -> np.ndarray:
        points = np.atleast_2d(np.asarray(points, float)).copy()
        points[:, 2] += points[:, :2] @ self.tilt
        home = self.endstops + np.sqrt(self.rods**2 - self.radius**2)
        return home - carriages(points, towers(self.radius, self.angles), self.rods)

    # -- probing -----------------------------------------------------------------------
    def g32(self, bed: str, real, probe: Probe, rng=None) -> str:
        """The answer of G30 P S-1 at the end of bed.g."""
        errors: dict[int, float] = {}
        for name, words in gcode(bed):
            if name == "G30" and "P" in words:
                errors[int(words["P"])] = self._error(words, real, probe, rng)
            elif name != "G30":
                self.apply(f"{name} " + " ".join(k + v for k, v in words.items()))
        heights = [errors[k] for k in sorted(errors)]
        cells = " ".join(f"{h:.3f}" for h in heights)
        return (
            f"G32 bed probe heights: {cells}, mean {np.mean(heights):.3f}, deviation from"
            f" mean {np.std(heights):.3f}\n"
        )

    def _error(self, words: dict[str, str], real, probe: Probe, rng) -> float:
        if float(words["Z"]) > TYPED:
            return float(words["Z"])
        place = np.array([float(words["X"]), float(words["Y"])]) - self.offset[:2]
        z = contact(self, real, probe, place, rng)[0]
        return z - self.offset[2] - float(words.get("H", 0.0))

    # -- output ------------------------------------------------------------------------
    def answers(self) -> str:
        """The answers to M665 and M666 without words."""
        rods = ":".join(f"{rod:.3f}" for rod in self.rods)
        x, y, z = self.lean
        a = self.adjust
        tilt = 100.0 * self.tilt
        return (
            f"Diagonals {rods}, delta radius {self.radius:.3f}, homed height"
            f" {self.height:.3f}, bed radius {self.bed:.1f}, X {x:.3f}°, Y {y:.3f}°,"
            f" Z {z:.3f}°\nEndstop adjustments X{a[0]:.2f} Y{a[1]:.2f} Z{a[2]:.2f}, tilt"
            f" X{tilt[0]:.2f}% Y{tilt[1]:.2f}%\n"
        )


def bed_file(places, words="", before="") -> str:
    """bed.g with a point for each place (n, 2) of the probe."""
    rows = [
        f"G30 P{k} X{x:.2f} Y{y:.2f}{words} Z-99999" for k, (x, y) in enumerate(places)
    ]
    return "M561\nG28\n" + before + "\n".join(rows) + " S-1\n"
