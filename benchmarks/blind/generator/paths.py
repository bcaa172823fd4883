"""Paths of the machines: circles, lines and rings as commands, with their phases."""

from __future__ import annotations

import numpy as np

from benchmarks.blind.generator.machine import Array, tip
from benchmarks.blind.generator.machines import MACHINES
from benchmarks.blind.generator.runs import Path

TEACH_Z, BAR = 1.286, 0.300


def a3_circle(z: float, tool: float, count: int) -> Path:
    """Commands (count, 3) at height z that keep the bar's length about a cup taught at
    TEACH_Z + tool.
    """
    psi = 2 * np.pi * (np.arange(count) + 0.37) / count  # no leg turns at a reading
    machine = MACHINES["a3"]

    def excess(theta: Array) -> Array:
        c = np.stack([np.full(count, z), psi, theta], -1)
        pose = machine.inverse(c, np.full(count, tool))
        away = tip(machine, pose.x, pose.R0, np.full(count, tool)) - np.array(
            [0.0, 0.0, TEACH_Z + tool]
        )
        return np.asarray(np.sqrt((away**2).sum(-1)) - BAR)

    low, high = np.full(count, 1e-3), np.full(count, np.deg2rad(40.0))
    for _ in range(48):
        mid = (low + high) / 2
        far = excess(mid) > 0
        low, high = np.where(far, low, mid), np.where(far, mid, high)
    return np.stack([np.full(count, z), psi, (low + high) / 2], -1), psi


def line(axis: int, other: float, count: int) -> Path:
    """Commands (count, 2) along y (axis 0) or z (axis 1); places are no multiples of a
    screw's pitch.
    """
    low, high = ((-1.5, 1.5), (0.0, 1.5))[axis]
    s = np.linspace(-1.0, 1.0, count)
    s[1:-1] += (0.31 / count) * np.sin(2.4 * np.arange(1, count - 1) ** 1.3)
    command = np.full((count, 2), other)
    command[:, axis] = (low + high) / 2 + s * (high - low) / 2
    return command, s


def delta_circle(radius: float, z: float, count: int) -> Path:
    a = 2 * np.pi * (np.arange(count) + 0.3) / count
    return np.stack([radius * np.cos(a), radius * np.sin(a), np.full(count, z)], -1), a


def delta_row(y: float, count: int) -> Path:
    half = np.sqrt(0.135**2 - y**2)
    s = np.linspace(-1.0, 1.0, count)
    return np.stack([half * s, np.full(count, y), np.zeros(count)], -1), s


#: orientation along a hexapod's circle, deg: constant rx, ry, spin, and the size of a
#: tilt that goes round with it
_TILTS = (
    (0.0, 0.0, 0.0, 0.0),
    (11.0, 0.0, 6.0, 0.0),
    (-8.0, 9.0, -9.0, 0.0),
    (0.0, -12.0, 12.0, 0.0),
    (0.0, 0.0, -12.0, 10.0),
    (4.0, 4.0, 10.0, -9.0),
    (-11.0, -6.0, 0.0, 0.0),
    (9.0, 10.0, -4.0, 0.0),
    (0.0, 5.0, 3.0, 9.0),
    (-5.0, 0.0, -13.0, -8.0),
)


def hex_circle(number: int, tool: float, count: int) -> Path:
    radius = (0.095, 0.060)[number % 2]
    rx, ry, spin, wave = np.deg2rad(_TILTS[number % len(_TILTS)])
    a = 2 * np.pi * (np.arange(count) + 0.37) / count
    z = 0.200 + tool + np.sqrt(BAR**2 - radius**2)
    tilt = [
        rx + wave * np.cos(2 * a + number),
        ry + wave * np.sin(a),
        np.full(count, spin),
    ]
    return (
        np.stack(
            [radius * np.cos(a), radius * np.sin(a), np.full(count, z), *tilt], -1
        ),
        a,
    )


#: rings of a hexaglide: radius, height of the middle over home's and how far up and
#: down it goes, m, and angles, deg: constant rx, ry, spin, and the size of a tilt that
#: goes round with it
_RINGS = (
    (0.080, -0.055, 0.030, 0.0, 0.0, 0.0, 7.0),
    (0.055, 0.060, 0.020, 6.0, -3.0, 9.0, 4.0),
    (0.092, 0.020, -0.045, -4.0, 5.0, -9.0, -5.0),
    (0.035, -0.010, 0.080, -7.0, -6.0, 5.0, 4.0),
    (0.070, -0.080, -0.015, 5.0, 7.0, -4.0, -4.0),
)
#: the same for circles about its taught cup: latitude on the ball of the bar's length,
#: deg, and angles
_LATITUDES = (
    (-12.0, 0.0, 0.0, 0.0, 9.0),
    (6.0, 7.0, -2.0, 8.0, -4.0),
    (22.0, -5.0, -6.0, -9.0, 5.0),
    (38.0, 3.0, 8.0, 4.0, -3.0),
    (57.0, -8.0, 2.0, -6.0, 3.0),
)
_GLIDE_HOME, GLIDE_CUP, SHORT_BAR = 0.200, 0.170, 0.100


def _glide_tilts(
    a: Array, rx: float, ry: float, spin: float, wave: float
) -> list[Array]:
    return list(
        np.deg2rad(
            [
                rx + wave * np.sin(a + 0.4),
                ry + wave * np.cos(2 * a),
                spin + 0.5 * wave * np.sin(2 * a),
            ]
        )
    )


def glide_ring(number: int, tool: float, count: int) -> Path:
    radius, middle, rise, *angles = _RINGS[number]
    a = 2 * np.pi * (np.arange(count) + 0.41) / count
    z = _GLIDE_HOME + tool + middle + rise * np.sin(a - 0.7)
    return (
        np.stack(
            [radius * np.cos(a), radius * np.sin(a), z, *_glide_tilts(a, *angles)], -1
        ),
        a,
    )


def glide_bar(number: int, count: int) -> Path:
    latitude, *angles = _LATITUDES[number]
    radius, up = (
        SHORT_BAR * np.cos(np.deg2rad(latitude)),
        SHORT_BAR * np.sin(np.deg2rad(latitude)),
    )
    a = 2 * np.pi * (np.arange(count) + 0.41) / count
    place = [radius * np.cos(a), radius * np.sin(a), np.full(count, GLIDE_CUP + up)]
    return np.stack([*place, *_glide_tilts(a, *angles)], -1), a
