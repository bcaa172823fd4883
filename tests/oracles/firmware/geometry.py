"""The true printer, its probe, and how far its bed and distances are off.

A firmware offers `travel(points (n, 3)) -> (n, 3)`.
"""

import dataclasses
from typing import Protocol

import numpy as np

BASE = np.array([210.0, 330.0, 90.0])


class Firmware(Protocol):
    def travel(self, points: np.ndarray) -> np.ndarray: ...


def towers(radius, angles) -> np.ndarray:
    """Places (3, 2) of the towers, at one radius or three."""
    a = np.radians(angles)
    return np.asarray(radius)[..., None] * np.column_stack([np.cos(a), np.sin(a)])


def carriages(points, feet: np.ndarray, arms) -> np.ndarray:
    """Heights (n, 3) of the carriages for a nozzle at points (n, 3)."""
    points = np.atleast_2d(np.asarray(points, float))
    across = ((feet - points[:, None, :2]) ** 2).sum(axis=-1)
    return points[:, 2:] + np.sqrt(np.asarray(arms) ** 2 - across)


def nozzle(feet: np.ndarray, heights: np.ndarray, arms) -> np.ndarray:
    """Lower point (n, 3) at the arms' lengths from carriages at heights (n, 3)."""
    heights = np.atleast_2d(heights)
    flat = np.broadcast_to(feet, (len(heights), 3, 2))
    p1, p2, p3 = np.moveaxis(np.concatenate([flat, heights[..., None]], -1), 1, 0)
    d = np.linalg.norm(p2 - p1, axis=-1, keepdims=True)
    ex = (p2 - p1) / d
    i = (ex * (p3 - p1)).sum(-1, keepdims=True)
    ey = p3 - p1 - i * ex
    j = np.linalg.norm(ey, axis=-1, keepdims=True)
    ey = ey / j
    ez = np.cross(ex, ey)
    a1, a2, a3 = np.broadcast_to(np.asarray(arms, float), 3) ** 2
    x = (a1 - a2 + d**2) / (2 * d)
    y = (a1 - a3 + i**2 + j**2 - 2 * i * x) / (2 * j)
    z = np.sqrt(a1 - x**2 - y**2)
    return p1 + x * ex + y * ey - np.sign(ez[:, 2:]) * z * ez


@dataclasses.dataclass
class Delta:
    """Numbers by tower (3,). An endstop is the nozzle's height at its switch.

    `tilt` is the rise of the bed along x and y.
    """

    radius: np.ndarray
    arms: np.ndarray
    angles: np.ndarray
    endstops: np.ndarray
    tilt: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(2))

    @property
    def feet(self) -> np.ndarray:
        return towers(self.radius, self.angles)

    @property
    def home(self) -> np.ndarray:
        return self.endstops + np.sqrt(self.arms**2 - self.radius**2)

    def travel(self, points) -> np.ndarray:
        """Travels (n, 3) of a firmware with these numbers."""
        return self.home - carriages(points, self.feet, self.arms)

    def tool(self, travels) -> np.ndarray:
        """Where the nozzle (n, 3) is."""
        return nozzle(self.feet, self.home - np.atleast_2d(travels), self.arms)

    def over_bed(self, travels) -> np.ndarray:
        """Height (n,) of the nozzle over the bed."""
        tool = self.tool(travels)
        return tool[:, 2] - tool[:, :2] @ self.tilt


def delta(radius, arms, angles, endstops, tilt=(0.0, 0.0)) -> Delta:
    """A delta from numbers, or from one for all towers."""
    numbers = [
        np.ones(3) * np.asarray(v, float) for v in (radius, arms, angles, endstops)
    ]
    return Delta(*numbers, tilt=np.asarray(tilt, float))


@dataclasses.dataclass
class Probe:
    """x, y from the nozzle; z is the nozzle's height where it triggers; noise sigma."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    sigma: float = 0.0


def contact(
    firmware: Firmware, real: Delta, probe: Probe, places, rng=None
) -> np.ndarray:
    """Heights (n,) that a firmware believes in where the probe triggers.

    places  (n, 2) of the nozzle, as commanded
    """
    places = np.atleast_2d(np.asarray(places, float))
    noise = 0.0 if rng is None else probe.sigma * rng.normal(size=len(places))
    z = np.zeros(len(places))
    for _ in range(60):
        tool = real.tool(firmware.travel(np.column_stack([places, z])))
        bed = (tool[:, :2] + [probe.x, probe.y]) @ real.tilt
        gap = tool[:, 2] - bed - probe.z - noise
        z = z - gap
        if np.abs(gap).max() < 1e-11:
            break
    return z


def disc(radius: float, count: int = 21) -> np.ndarray:
    """Places (n, 2) of a square grid within a circle."""
    line = np.linspace(-radius, radius, count)
    x, y = np.meshgrid(line, line)
    inside = np.hypot(x, y) <= radius * (1 + 1e-9)
    return np.column_stack([x[inside], y[inside]])


def spiral(count: int, radius: float) -> np.ndarray:
    """Places (n, 2) that fill a circle evenly, two decimals."""
    angle = np.arange(count) * 2.399963
    away = radius * np.sqrt((np.arange(count) + 0.5) / count)
    away[-1] = radius
    return np.round(np.column_stack([away * np.cos(angle), away * np.sin(angle)]), 2)


def bed(firmware: Firmware, real: Delta, radius: float) -> np.ndarray:
    """Heights (n,) of the nozzle over the bed where z = 0 is commanded."""
    places = disc(radius)
    return real.over_bed(
        firmware.travel(np.column_stack([places, np.zeros(len(places))]))
    )


def distances(firmware: Firmware, real: Delta, radius: float) -> np.ndarray:
    """Distances (n,) of commanded places less those commanded, over a circle."""
    a = np.radians(30.0 * np.arange(12))
    ring = radius * np.column_stack([np.cos(a), np.sin(a)])
    places = np.vstack([[0.0, 0.0], ring])
    i, j = np.triu_indices(len(places), 1)
    tool = real.tool(firmware.travel(np.column_stack([places, np.zeros(len(places))])))
    reached = np.linalg.norm(tool[i] - tool[j], axis=1)
    return reached - np.linalg.norm(places[i] - places[j], axis=1)
