"""Marlin: M665, M666, M851, M206, homing, G30, G29 and M503 of a delta by version.

After the tags 1.1.0-RC8 to 2.1.x: Marlin_main.cpp or src/module/delta.cpp, motion.cpp
(homeaxis, set_axis_is_at_home), probe.cpp, src/gcode/calibrate/M665.cpp and M666.cpp.

- M665 B is the trim of a rod in 1.1.0-RC and since 2.0.6, the radius of G33 in 1.1.0 to
  1.1.9.1, and not read in 2.0.0 to 2.0.5.
- M666 moves a carriage down after its switch; versions go 0.1 mm or 7 steps further, and
  since 2.0.6 not at all for a value of up to 6 steps. Above 0 it has no effect, or moves H.
- The nozzle is at H at home; since 1.1.9.1 and 2.0.0 at H - M851 Z.
- A printed height has M851 Z added, but in 1.1.0-RC.
"""

from __future__ import annotations

import re

import numpy as np

from oracles.firmware.geometry import BASE, Probe, carriages, contact, towers

MIN_STEPS = 6


def words_of(text: str, command: str) -> list[dict[str, float]]:
    """Words of every such command of a log or file, with or without `echo:` before it."""
    lines = (line.split(";")[0] for line in text.splitlines())
    matches = (re.search(rf"(?:^|[\s:>]){command}\b(.*)$", line) for line in lines)
    return [
        {k: float(v) for k, v in re.findall(r"([A-Z])\s*([-+]?[\d.]+)", match[1])}
        for match in matches
        if match
    ]


class Marlin:
    """The rules of the newest version; those below change them.

    Compiled in are the keywords: `home_height` of versions without M665 H, `trim` of the
    towers' radii, `probe_xy` where M851 has Z alone.
    """

    version = "2.1.2"
    b_word = "rod"
    has_height = True
    turns_by_z = False
    counts_to_probe = True
    probe_has_xy = True
    reads_to_bed = True
    retreat = "dead band"
    positive = "ignored"
    heading = "; Delta (L<diagonal-rod> R<radius> H<height> S<seg-per-sec> XYZ<tower-angle-trim> ABC<rod-trim>):"

    def __init__(
        self,
        text="",
        *,
        has_probe=True,
        probe_xy=(0.0, 0.0),
        home_height=None,
        trim=(0.0, 0.0, 0.0),
        steps_per_mm=80.0,
        printable_radius=100.0,
    ) -> None:
        radius = 80.0 if self.b_word == "radius" else 0.0
        self.words = dict.fromkeys("LRHSBXYZAC", 0.0) | {"S": 100.0, "B": radius}
        self.adjust = np.zeros(3)
        self.probe = np.array([*probe_xy, 0.0])
        self.shift = np.zeros(3)
        self.has_probe, self.home_height = has_probe, home_height
        self.trim, self.steps_per_mm = np.asarray(trim, float), steps_per_mm
        self.printable_radius = printable_radius
        self.stored = False
        self.apply(text)

    # -- words -------------------------------------------------------------------------
    def apply(self, text: str) -> Marlin:
        """Execute a log of M503, or an export."""
        for words in words_of(text, "M665"):
            self._take_geometry(words)
        for words in words_of(text, "M666"):
            self._take_adjustments(words)
        for words in words_of(text, "M851"):
            for k, letter in enumerate("XYZ"):
                if letter in words and (letter == "Z" or self.probe_has_xy):
                    self.probe[k] = words[letter]
        for words in words_of(text, "M206") if not self.has_height else ():
            self.shift = np.array([words.get(k, 0.0) for k in "XYZ"])
        self.stored |= bool(words_of(text, "M500"))
        return self

    @property
    def letters(self) -> str:
        """Letters of M665, in the order of M503."""
        letters = "LRHS" if self.has_height else "LRS"
        letters += "B" if self.b_word == "radius" else ""
        letters += "XYZ" if self.has_height else ""
        return letters + ("ABC" if self.b_word == "rod" else "")

    def _take_geometry(self, words: dict[str, float]) -> None:
        known = {k: v for k, v in words.items() if k in self.letters}
        turn = known.pop("Z", 0.0) if self.turns_by_z else 0.0
        self.words |= known
        self.words["X"] -= turn
        self.words["Y"] -= turn

    def _take_adjustments(self, words: dict[str, float]) -> None:
        for k, letter in enumerate("XYZ"):
            value = words.get(letter)
            if value is not None and not (value > 0 and self.positive == "ignored"):
                self.adjust[k] = value
        if self.positive == "normalised":
            self.words["H"] -= self.adjust.max()
            self.adjust = self.adjust - self.adjust.max()

    # -- kinematics --------------------------------------------------------------------
    @property
    def feet(self) -> np.ndarray:
        return towers(self.words["R"] + self.trim, self.angles)

    @property
    def angles(self) -> np.ndarray:
        return BASE + [self.words[k] for k in "XYZ"]

    @property
    def arms(self) -> np.ndarray:
        trims = [self.words[k] for k in "ABC"] if self.b_word == "rod" else np.zeros(3)
        return self.words["L"] + np.asarray(trims)

    @property
    def probe_z(self) -> float:
        return float(self.probe[2]) if self.has_probe else 0.0

    def home_z(self) -> float:
        """Believed height of the nozzle at home."""
        if not self.has_height:
            return self.home_height + self.shift[2]
        return self.words["H"] - (self.probe_z if self.counts_to_probe else 0.0)

    def retreats(self) -> np.ndarray:
        """Way (3,) of each carriage down from its switch at the end of homing."""
        down = -self.adjust
        if self.retreat == "dead band":
            return np.where(down > MIN_STEPS / self.steps_per_mm, down, 0.0)
        further = {
            "exact": 0.0,
            "tenth": 0.1,
            "steps": (MIN_STEPS + 1) / self.steps_per_mm,
        }
        return np.where(down >= 0, down + further[self.retreat], 0.0)

    def home(self) -> np.ndarray:
        """Believed heights (3,) of the carriages at their switches."""
        at_home = carriages([[0.0, 0.0, self.home_z()]], self.feet, self.arms)[0]
        return at_home + self.retreats()

    def travel(self, points) -> np.ndarray:
        return self.home() - carriages(points, self.feet, self.arms)

    # -- probing -----------------------------------------------------------------------
    def readings(self, real, probe: Probe, places, rng=None) -> np.ndarray:
        """Printed heights (n,) for places (n, 2) of the nozzle."""
        z = contact(self, real, probe, places, rng)
        return z + (self.probe_z if self.reads_to_bed else 0.0)

    def g30(self, real, probe: Probe, places, rng=None, digits=2) -> str:
        """Answers of G30 at places (n, 2) of the probe."""
        z = self.readings(real, probe, places - self.probe[:2], rng)
        form = f"Bed X: %.{digits}f Y: %.{digits}f Z: %.{digits}f\n"
        return "".join(form % (*xy, h) for xy, h in zip(places, z, strict=True))

    # -- output ------------------------------------------------------------------------
    def m115(self) -> str:
        return f"FIRMWARE_NAME:Marlin {self.version} (Github) PROTOCOL_VERSION:1.0\n"

    def m503(self) -> str:
        """The lines of M503 that bear on a delta, two decimals."""

        def row(name: str, letters: str, values) -> str:
            pairs = zip(letters, values, strict=True)
            return f"  {name}" + "".join(f" {k}{v:.2f}" for k, v in pairs)

        rows = [
            row("M92", "XYZE", [*[self.steps_per_mm] * 3, 97.0]),
            self.heading,
            row("M665", self.letters, [self.words[k] for k in self.letters]),
            row("M666", "XYZ", self.adjust),
        ]
        if not self.has_height:
            rows.append(row("M206", "XYZ", self.shift))
        if self.has_probe:
            letters = "XYZ" if self.probe_has_xy else "Z"
            rows.append(row("M851", letters, self.probe[-len(letters) :]))
        return "".join(f"echo:{line}\n" for line in rows)


class Marlin206(Marlin):
    version = "2.0.6"
    heading = (
        "Delta settings: L<diagonal rod> R<radius> H<height> S<segments per sec>"
        " XYZ<tower angle trim> ABC<rod trim>"
    )


class Marlin205(Marlin206):
    version = "2.0.5.3"
    b_word, retreat = "none", "steps"
    heading = "Delta settings: L<diagonal_rod> R<radius> H<height> S<segments_per_s> XYZ<tower angle corrections>"


class Marlin1191(Marlin205):
    version = "1.1.9.1"
    b_word, probe_has_xy = "radius", False
    heading = (
        "Delta settings: L<diagonal_rod> R<radius> H<height> S<segments_per_s>"
        " B<calibration radius> XYZ<tower angle corrections>"
    )


class Marlin119(Marlin1191):
    version, counts_to_probe = "1.1.9", False


class Marlin118(Marlin119):
    version, retreat = "1.1.8", "tenth"


class Marlin115(Marlin118):
    version, positive, turns_by_z = "1.1.5", "normalised", True


class Marlin110(Marlin115):
    version, retreat = "1.1.0", "exact"


class MarlinRC8(Marlin):
    version = "1.1.0-RC8"
    has_height = counts_to_probe = probe_has_xy = reads_to_bed = False
    retreat, positive = "exact", "no move"
    heading = "Delta settings: L=diagonal_rod, R=radius, S=segments_per_second, ABC=diagonal_rod_trim_tower_[123]"


VERSIONS = (
    MarlinRC8, Marlin110, Marlin115, Marlin118, Marlin119, Marlin1191, Marlin205,
    Marlin206, Marlin,
)  # fmt: skip
