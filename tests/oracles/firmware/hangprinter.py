"""A Hangprinter of RepRapFirmware 3 (M669 K6, M666): motor angles, and the mover's place.

After src/Movement/Kinematics/HangprinterKinematics.cpp of 3.5: lines of three to five anchors
wind up on spools whose radius grows; a force F in the direction of an anchor makes its line
F (U d + Y) / (S U) longer, d from the mover to the anchor. Y is the distance to the last
anchor, where all spools are.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import least_squares

from oracles.firmware.rrf import gcode


@dataclasses.dataclass
class Hangprinter:
    """Anchors (n, 3), spools (n,), folds (n,), gears (n,), build-up; mm."""

    anchors: np.ndarray
    spools: np.ndarray
    folds: np.ndarray
    gears: np.ndarray
    buildup: float
    stiffness: float = np.inf

    def motors(self, place, forces=0.0) -> np.ndarray:
        """Degrees (n,) since the origin at a place, under forces (n,) in the lines, N."""
        distance = np.linalg.norm(self.anchors - place, axis=1)
        wires = np.linalg.norm(self.anchors - self.anchors[-1], axis=1)
        flex = forces * (distance * self.folds + wires) / (self.stiffness * self.folds)
        change = distance - flex - np.linalg.norm(self.anchors, axis=1)
        k2 = -self.folds * self.buildup
        radius = np.sqrt(self.spools**2 + k2 * change)
        spool_turns = 2.0 * self.folds * (radius - self.spools) / k2
        return np.degrees(spool_turns * self.gears)

    def place(self, motors: np.ndarray) -> np.ndarray:
        """Where taut lines hold the mover (3,)."""

        def misses(place: np.ndarray) -> np.ndarray:
            return (self.motors(place) - motors) / 10.0

        return least_squares(misses, [0.0, 0.0, 300.0], xtol=1e-14, ftol=1e-14).x


def hangprinter(text: str) -> Hangprinter:
    """The printer of a config.g."""
    words: dict[str, dict[str, str]] = {"M669": {}, "M666": {}}
    for name, new in gcode(text):
        if name in words:
            words[name] |= new
    count = int(words["M669"]["N"])

    def read(name: str, letter: str) -> np.ndarray:
        return np.array([float(v) for v in words[name][letter].split(":")])

    anchors = np.array([read("M669", letter) for letter in "ABCDI"[:count]])
    lines = read("M666", "O")[0]
    gears = read("M666", "H") / read("M666", "L")
    spools, folds = read("M666", "R"), read("M666", "U")
    buildup = float(read("M666", "Q")[0] * lines)
    stiffness = float(words["M666"].get("S", "inf"))
    return Hangprinter(anchors, spools, folds, gears, buildup, stiffness)
