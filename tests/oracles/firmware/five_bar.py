"""A five-bar of RepRapFirmware 3 (M669 K9): its two circles, and its words.

After src/Movement/Kinematics/FiveBarScaraKinematics.cpp of 3.5: places are complex numbers,
mm. A knee is where two circles meet on the side of the mode: the line from the crank's centre
to the destination lies to the left of the crank (1), on the left arm to the right of it (2),
or on both (4). Struts meet where the turn from left knee over the tool to the right one is
clockwise. Without B, switches are at the mode's usual angles.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oracles.firmware.rrf import gcode

SIDES = {1: (1, 1), 2: (-1, 1), 4: (-1, -1)}
SWITCHES = {1: "20:10", 2: "110:20", 4: "110:100"}


def cross(a: complex, b: complex) -> float:
    return (a.conjugate() * b).imag


def meetings(centres: tuple[complex, complex], radii: tuple[float, float]) -> list:
    """Points of two circles."""
    line = centres[1] - centres[0]
    distance = abs(line)
    along = (distance**2 + radii[0] ** 2 - radii[1] ** 2) / (2.0 * distance)
    aside = np.sqrt(radii[0] ** 2 - along**2)
    way = line / distance
    return [complex(centres[0] + way * (along + 1j * s * aside)) for s in (1, -1)]


@dataclasses.dataclass
class FiveBar:
    """Centres, cranks, struts and switches (degrees) of the left and the right arm."""

    centres: list[complex]
    cranks: list[float]
    struts: list[float]
    switches: list[float]
    mode: int

    def turns(self, place: complex) -> np.ndarray:
        """Degrees (2,) from the switches."""
        angles = []
        for k, sign in enumerate(SIDES[self.mode]):
            centre = self.centres[k]
            knees = meetings((centre, place), (self.cranks[k], self.struts[k]))
            (knee,) = [
                one for one in knees if sign * cross(one - centre, place - centre) > 0.0
            ]
            angles.append(np.degrees(np.angle(knee - centre)) % 360.0)
        return np.array(angles) - self.switches

    def tool(self, turns: np.ndarray) -> complex:
        angles = np.radians(turns + self.switches)
        left, right = self.centres + self.cranks * np.exp(1j * angles)
        both = meetings((left, right), tuple(self.struts))
        (tool,) = [one for one in both if cross(one - left, right - left) < 0.0]
        return tool


def five_bar(text: str) -> FiveBar:
    """The linkage of a config.g."""
    words: dict[str, str] = {}
    for name, new in gcode(text):
        if name == "M669":
            words = new
    mode = int(words.get("L", 1))
    x, y, cranks, struts, switches = (
        [float(v) for v in text.split(":")]
        for text in (*(words[k] for k in "XYPD"), words.get("B", SWITCHES[mode]))
    )
    centres = [complex(*pair) for pair in zip(x, y, strict=True)]
    assert not any(struts[2:])
    return FiveBar(centres, cranks, struts[:2], switches, mode)
