"""Rotary deltas of Klipper and RepRapFirmware 3 (M669 K10): kinematics, files, contacts.

After klippy/kinematics/rotary_delta.py and kin_rotary_delta.c, and
src/Movement/Kinematics/RotaryDeltaKinematics.cpp of 3.5.

- Klipper: the elbow is the outward one of two points at the upper arm's length from the
  shoulder and at the lower arm's from the effector, in the plane of the upper arm. A switch
  is where that arm has a tool on the middle axis at position_endstop. A step is 360 degrees
  over full steps, microsteps and gear_ratio; saved positions count down from the switch.
- RepRapFirmware: a cos t + b sin t = c, with the lower root of sin t. A switch is at the
  largest angle of M669 A plus M666. Limbs stand at -150, -30 and 90 degrees. One number of
  U, L or H stands for three.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy.optimize import least_squares

from oracles.firmware.klipper import HEADER, merge, parse, written
from oracles.firmware.rrf import gcode

GEAR = (107.0 / 16.0) * (60.0 / 16.0)
STEPS = 200.0 * 16.0 * GEAR


@dataclasses.dataclass
class Rotary:
    """A rotary delta: mm, and angles in degrees; switches at angles over the horizontal."""

    radius: float
    height: float
    upper: np.ndarray
    lower: np.ndarray
    limbs: np.ndarray
    switches: np.ndarray

    def elbows(self, turns: np.ndarray) -> np.ndarray:
        """Elbows (3, 3) at turns (3,) down from the switches."""
        t, limb = np.radians(self.switches - turns), np.radians(self.limbs)
        away = self.radius + self.upper * np.cos(t)
        rise = self.height + self.upper * np.sin(t)
        return np.column_stack([away * np.cos(limb), away * np.sin(limb), rise])

    def tool(self, turns: np.ndarray) -> np.ndarray:
        """The tool (3,) below the elbows."""
        elbows = self.elbows(turns)
        misses = lambda p: np.linalg.norm(elbows - p, axis=1) - self.lower  # noqa: E731
        start = elbows.mean(axis=0) - [0.0, 0.0, self.lower.mean()]
        return least_squares(misses, start, xtol=1e-15, ftol=1e-15, gtol=1e-15).x

    def klipper_angles(self, point: np.ndarray) -> np.ndarray:
        """Angles (3,) by the circles about shoulder and effector."""
        angles = []
        for limb, upper, lower in zip(self.limbs, self.upper, self.lower, strict=True):
            a = np.radians(limb)
            x = point[0] * np.cos(a) + point[1] * np.sin(a) - self.radius
            z, y = point[1] * np.cos(a) - point[0] * np.sin(a), point[2] - self.height
            away = np.hypot(x, y)
            along = (away**2 + upper**2 - (lower**2 - z**2)) / (2.0 * away)
            aside = np.sqrt(upper**2 - along**2)
            ways = np.array([x, y]) / away
            square = np.array([-ways[1], ways[0]])
            elbow = max((along * ways + s * aside * square for s in (1, -1)), key=tuple)
            angles.append(np.degrees(np.arctan2(elbow[1], elbow[0])))
        return np.array(angles)

    def rrf_angles(self, point: np.ndarray) -> np.ndarray:
        """Angles (3,) by a cos t + b sin t = c."""
        limb = np.radians(self.limbs)
        x = point[0] * np.cos(limb) + point[1] * np.sin(limb)
        y = point[1] * np.cos(limb) - point[0] * np.sin(limb)
        out, down = self.radius - x, self.height - point[2]
        a, b = 2.0 * self.upper * out, 2.0 * self.upper * down
        c = self.lower**2 - self.upper**2 - down**2 - out**2 - y**2
        root = np.sqrt(a**2 + b**2 - c**2)
        return np.degrees(np.arcsin((b * c - a * root) / (a**2 + b**2)))


class RotaryFirmware:
    """What both firmwares share: moves and contacts."""

    geometry: Rotary

    def angles(self, point: np.ndarray) -> np.ndarray:
        raise NotImplementedError

    def turns(self, point) -> np.ndarray:
        """Turns (3,) down from the switches."""
        return self.geometry.switches - self.angles(np.asarray(point, float))

    def contact(self, real: Rotary, place, trigger: float, noise: float) -> float:
        """Height that the firmware believes in where the nozzle is at the trigger's."""
        z = trigger
        for _ in range(40):
            gap = real.tool(self.turns([*place, z]))[2] - trigger - noise
            z -= gap
            if abs(gap) < 1e-10:
                break
        return z

    def errors(self, real: Rotary, points) -> np.ndarray:
        """Where the tool is (n, 3), less the commanded points."""
        return np.array([real.tool(self.turns(p)) - p for p in np.asarray(points)])


class KlipperRotary(RotaryFirmware):
    """By its printer.cfg."""

    def __init__(self, text: str) -> None:
        regular, _, block = text.partition(HEADER)
        saved = "\n".join(line[4:] for line in block.splitlines())
        self.regular, self.saved = parse(regular), parse(saved)

    @property
    def geometry(self) -> Rotary:
        options = merge(self.saved, self.regular)
        steppers = [options[f"stepper_{limb}"] for limb in "abc"]

        def read(key: str, defaults=(None,) * 3) -> np.ndarray:
            first = [steppers[0].get(key, d) if d is None else d for d in defaults]
            pairs = zip(steppers, first, strict=True)
            return np.array([float(s.get(key, value)) for s, value in pairs])

        printer = options["printer"]
        radius, height = (float(printer[f"shoulder_{k}"]) for k in ("radius", "height"))
        arms = read("upper_arm_length"), read("lower_arm_length")
        limbs = read("angle", (30.0, 150.0, 270.0))
        rotary = Rotary(radius, height, *arms, limbs, np.zeros(3))
        stops = [[0.0, 0.0, stop] for stop in read("position_endstop")]
        switches = [rotary.klipper_angles(np.array(s))[k] for k, s in enumerate(stops)]
        return dataclasses.replace(rotary, switches=np.array(switches))

    def angles(self, point: np.ndarray) -> np.ndarray:
        return self.geometry.klipper_angles(point)

    def apply(self, text: str) -> KlipperRotary:
        self.regular = merge(self.regular, parse(text))
        return self

    def position(self, turns: np.ndarray) -> str:
        return ",".join(f"{v:.3f}" for v in turns * STEPS / 360.0)

    def calibrate(self, real, places, trigger, sigma, rng) -> None:
        """DELTA_CALIBRATE without its fit."""
        section = self.saved.setdefault("delta_calibrate", {})
        for k, place in enumerate(places):
            z = self.contact(real, place, trigger, sigma * rng.normal())
            section[f"height{k}"] = f"{trigger:g}"
            section[f"height{k}_pos"] = self.position(self.turns([*place, z]))

    def analyze(self, real, pairs, sigma, rng) -> None:
        """Distances of pairs (n, 2, 3) of points."""
        section = self.saved.setdefault("delta_calibrate", {})
        for k, ends in enumerate(pairs):
            turns = [self.turns(end) for end in ends]
            length = np.linalg.norm(real.tool(turns[0]) - real.tool(turns[1]))
            section[f"distance{k}"] = f"{length + sigma * rng.normal():.3f}"
            section[f"distance{k}_pos1"] = self.position(turns[0])
            section[f"distance{k}_pos2"] = self.position(turns[1])

    def text(self) -> str:
        return written(self.regular) + "\n" + HEADER + written(self.saved, "#*# ")


class RrfRotary(RotaryFirmware):
    """By its config.g, without defaults of a real one."""

    def __init__(self, *texts: str) -> None:
        self.words: dict[str, dict[str, str]] = {"M669": {"A": "-45:45"}, "M666": {}}
        for text in texts:
            for name, words in gcode(text):
                if name in self.words:
                    self.words[name] |= words

    def _three(self, letter: str) -> np.ndarray:
        cells = [float(v) for v in self.words["M669"][letter].split(":")]
        return np.array(cells if len(cells) == 3 else cells * 3)

    @property
    def geometry(self) -> Rotary:
        delta, stops = self.words["M669"], self.words["M666"]
        lean = [float(delta.get(k, 0.0)) for k in "XYZ"]
        largest = float(delta["A"].split(":")[1])
        return Rotary(
            float(delta["R"]),
            float(self._three("H").mean()),
            self._three("U"),
            self._three("L"),
            np.array([-150.0, -30.0, 90.0]) + lean,
            largest + np.array([float(stops.get(k, 0.0)) for k in "XYZ"]),
        )

    def angles(self, point: np.ndarray) -> np.ndarray:
        return self.geometry.rrf_angles(point)

    def g32(self, real, places, trigger, sigma, rng) -> str:
        """The answer of G30 P S-1: believed heights less the trigger's."""
        heights = [
            self.contact(real, place, trigger, sigma * rng.normal()) - trigger
            for place in places
        ]
        cells = " ".join(f"{height:.3f}" for height in heights)
        return f"G32 bed probe heights: {cells}, mean 0.0, deviation from mean 0.0\n"
