"""Klipper: options, kinematics, DELTA_CALIBRATE, DELTA_ANALYZE and SAVE_CONFIG of a delta.

After klippy/kinematics/delta.py, klippy/extras/delta_calibrate.py and klippy/configfile.py.

- A position is the steps of each tower down from its switch, three decimals.
- DELTA_CALIBRATE puts the nozzle on its places; x_offset and y_offset are not used. A
  saved height is that of the nozzle: z_offset of the probe.
- A value above the block of SAVE_CONFIG wins over the saved one; a block in which a line
  does not begin with #*# is dropped.
"""

from __future__ import annotations

import re

import numpy as np
from scipy.optimize import least_squares

from oracles.firmware.geometry import BASE, Delta, Probe, contact, delta

HEADER = (
    "#*# <---------------------- SAVE_CONFIG ---------------------->\n"
    "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.\n#*#\n"
)
STEPPERS = ("stepper_a", "stepper_b", "stepper_c")
#: two ridges of the test object on one line from a pillar, mm from it
RIDGES, PILLAR = (4.5, 69.5), 65.0

Options = dict[str, dict[str, str]]


def parse(text: str) -> Options:
    """Options by section."""
    options: Options = {}
    section, last = "", None
    for line in text.splitlines():
        bare = re.sub(r"(^|\s);.*$", "", line.split("#")[0])
        if not bare.strip():
            continue
        head = re.match(r"\[(.+?)\]\s*$", bare)
        if head:
            section, last = head[1].strip(), None
            options.setdefault(section, {})
        elif bare[0].isspace() and last is not None:
            options[section][last] += "\n" + bare.strip()
        else:
            key, value = re.match(r"([^:=]+?)\s*[:=]\s*(.*)$", bare).groups()
            last = key.strip().lower()
            options[section][last] = value.strip()
    return options


def merge(*configs: Options) -> Options:
    """Options of several files; later ones win."""
    merged: Options = {}
    for config in configs:
        for section, options in config.items():
            merged[section] = merged.get(section, {}) | options
    return merged


def written(config: Options, prefix="") -> str:
    lines = []
    for section, options in config.items():
        lines += [f"[{section}]"]
        lines += [f"{k} = {v}".replace("\n", "\n ") for k, v in options.items()]
    return "".join(f"{prefix}{line}\n" for text in lines for line in text.split("\n"))


class Klipper:
    """A printer by its printer.cfg."""

    def __init__(self, text: str) -> None:
        regular, _, block = text.partition(HEADER)
        lines = block.splitlines()
        whole = all(re.match(r"#\*#( |$)", line) for line in lines)
        saved = "\n".join(line[4:] for line in lines) if whole else ""
        self.regular, self.saved = parse(regular), parse(saved)

    def apply(self, text: str) -> Klipper:
        """Put the options of another file into the sections above the block."""
        self.regular = merge(self.regular, parse(text))
        return self

    @property
    def options(self) -> Options:
        return merge(self.saved, self.regular)

    @property
    def geometry(self) -> Delta:
        options = self.options
        a = options["stepper_a"]
        arms, stops = (
            [float(options[s].get(key, a[key])) for s in STEPPERS]
            for key in ("arm_length", "position_endstop")
        )
        angles = [
            float(options[s].get("angle", v))
            for s, v in zip(STEPPERS, BASE, strict=True)
        ]
        # of a fork: what a tower adds to the radius, that of tower a where it says none
        trim = a.get("delta_radius_offset", 0.0)
        trims = [float(options[s].get("delta_radius_offset", trim)) for s in STEPPERS]
        radii = float(options["printer"]["delta_radius"]) + np.array(trims)
        return delta(radii, arms, angles, stops)

    @property
    def step(self) -> float:
        a = self.options["stepper_a"]
        return float(a["rotation_distance"]) / (200.0 * float(a["microsteps"]))

    def travel(self, points) -> np.ndarray:
        return self.geometry.travel(points)

    # -- measuring ---------------------------------------------------------------------
    def calibrate(self, real: Delta, probe: Probe, places, rng=None) -> None:
        """DELTA_CALIBRATE: save heights at places (n, 2), without a fit."""
        z = contact(self, real, probe, places, rng)
        travels = self.travel(np.column_stack([places, z]))
        height = float(self.options["probe"]["z_offset"])
        section = self.saved.setdefault("delta_calibrate", {})
        for k, travel in enumerate(travels):
            section[f"height{k}"] = f"{height:g}"
            section[f"height{k}_pos"] = self._position(travel)

    def analyze(self, real: Delta, sigma: float, rng, objects=1) -> None:
        """DELTA_ANALYZE: save the twelve distances of so many printed objects."""
        a = np.radians([210.0, 270.0, 330.0, 30.0, 90.0, 150.0])
        way = np.column_stack([np.cos(a), np.sin(a)])
        inner, outer = RIDGES
        turned = np.roll(way, -2, axis=0)
        first = np.vstack([way * inner, way * PILLAR + turned * inner])
        second = np.vstack([way * outer, way * PILLAR + turned * outer])
        ends = [
            self.travel(np.column_stack([p, np.zeros(len(p))])) for p in (first, second)
        ]
        true = np.linalg.norm(real.tool(ends[0]) - real.tool(ends[1]), axis=1)
        section, number = self.saved.setdefault("delta_calibrate", {}), 0
        for _ in range(objects):
            lengths = true + sigma * rng.normal(size=len(true))
            for length, p, q in zip(lengths, *ends, strict=True):
                section[f"distance{number}"] = f"{length:.3f}"
                section[f"distance{number}_pos1"] = self._position(p)
                section[f"distance{number}_pos2"] = self._position(q)
                number += 1

    def _position(self, travel: np.ndarray) -> str:
        return ",".join(f"{v:.3f}" for v in travel / self.step)

    def readings(self, name: str, *ends: str) -> tuple[np.ndarray, list[np.ndarray]]:
        """Saved numbers (n,), and the travels (n, 3) of their positions."""
        section, numbers = self.options["delta_calibrate"], []
        while f"{name}{len(numbers)}" in section:
            numbers.append(float(section[f"{name}{len(numbers)}"]))
        travels = [
            np.array(
                [
                    [float(v) for v in section[f"{name}{k}{end}"].split(",")]
                    for k in range(len(numbers))
                ]
            )
            for end in ends
        ]
        return np.array(numbers), [self.step * t for t in travels]

    def fitted(self) -> Delta:
        """The delta of Klipper's own fit: with distances, arms are free as well."""
        heights, (travels,) = self.readings("height", "_pos")
        lengths, ends = self.readings("distance", "_pos1", "_pos2")
        start = self.geometry
        weight = np.sqrt(len(lengths) / (0.5 * len(heights))) if len(lengths) else 1.0

        def printer(p: np.ndarray) -> Delta:
            arms = p[6:] if len(lengths) else start.arms
            return delta(p[0], arms, [p[1], p[2], start.angles[2]], p[3:6])

        def misses(p: np.ndarray) -> np.ndarray:
            real = printer(p)
            misfit = weight * (real.tool(travels)[:, 2] - heights)
            if not len(lengths):
                return misfit
            spans = np.linalg.norm(real.tool(ends[0]) - real.tool(ends[1]), axis=1)
            return np.concatenate([misfit, spans - lengths])

        first = [start.radius[0], *start.angles[:2], *start.endstops]
        first += list(start.arms) if len(lengths) else []
        return printer(least_squares(misses, first, x_scale=1e-3).x)

    # -- output ------------------------------------------------------------------------
    def text(self) -> str:
        """printer.cfg with the block of SAVE_CONFIG."""
        return written(self.regular) + "\n" + HEADER + written(self.saved, "#*# ")


def example(radius=110.0, arm=250.0, endstop=260.0, probe=(0.0, 0.0, 0.0)) -> str:
    """printer.cfg of a small printer."""
    rows = ["[printer]", "kinematics: delta", f"delta_radius: {radius:g}"]
    for stepper, angle in zip(STEPPERS, BASE, strict=True):
        rows += [f"[{stepper}]", "rotation_distance: 40", "microsteps: 16"]
        rows += [f"arm_length: {arm:g}", f"position_endstop: {endstop:g}"]
        rows += [f"angle: {angle:g}"]
    rows += ["[probe]", "pin: ^PA1"]
    rows += [f"{k}_offset: {v:g}" for k, v in zip("xyz", probe, strict=True)]
    return "\n".join([*rows, "[delta_calibrate]", "radius: 90", ""])
