"""A made-up A3 head under a ball bar: parameters, set-ups, poses and drawings."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from oed.base.arrays import Array

#: radius of the base and the platform, length of the tool axis and home height, m
RADIUS, TOOL, HEIGHT = 0.250, 0.526, 0.540
ANGLES = [2.0 * math.pi * i / 3.0 - math.pi / 2.0 for i in range(3)]
#: stroke and bar length of each set-up, m
SETUPS = {"short tool": (0.080, 0.300), "long tool": (0.200, 0.250)}
JOINT_SHIFTS = [f"da{i}{axis}" for i in (1, 2, 3) for axis in "xyz"]
LENGTHS = ["dq1", "dq2", "dq3", "db1y", "db2x", "db3x", *JOINT_SHIFTS]
TILTS = [f"beta{i}" for i in (1, 2, 3)]
CUPS = [f"{name} cup_{axis}" for name in ("short", "long") for axis in "xyz"]
NAMES = LENGTHS + TILTS + CUPS
READINGS_PER_SETUP = 15


def machine() -> dict[str, Any]:
    """The table of the machine's parameters."""
    lengths = [
        _parameter(name, 1.0, "mm", f"joint error {name[1:]}") for name in LENGTHS
    ]
    tilts = [_parameter(name, 10.0, "mrad", "tilt of the limb") for name in TILTS]
    return {
        "name": "a3_head",
        "about": "A3 spindle head (3-RPS): z, psi, theta driven; x, y, phi parasitic",
        "source": "Tian et al. 2016, Mech. Mach. Theory 102, 167-178",
        "parameters": lengths + tilts,
        "frame": ["db1x", "db2y", "db3y", "db1z", "db2z", "db3z"],
    }


def _parameter(
    name: str,
    tolerance: float,
    unit: str,
    about: str,
) -> dict[str, Any]:
    return {
        "name": name,
        "nominal": 0.0,
        "tolerance": tolerance,
        "unit": unit,
        "about": about,
    }


def setups() -> list[dict[str, Any]]:
    """The ball bar's two set-ups."""
    return [
        {
            "name": name,
            "instrument": "ball_bar",
            "about": "double ball bar, table cup taught by the machine",
            "numbers": {"length_mm": 1e3 * bar, "tool_z_mm": 1e3 * (stroke - 0.08)},
            "sigma": {"length_um": 0.5},
            "unknowns": {f"cup_{axis}_mm": 0.02 for axis in "xyz"},
        }
        for name, (stroke, bar) in SETUPS.items()
    ]


# -- poses -----------------------------------------------------------------------------


def poses() -> list[dict[str, Any]]:
    """15 readings of a circle in each set-up."""
    return [_pose(setup, k) for setup in SETUPS for k in range(READINGS_PER_SETUP)]


def _pose(setup: str, k: int) -> dict[str, Any]:
    stroke, bar = SETUPS[setup]
    psi = 2.0 * math.pi * k / READINGS_PER_SETUP
    theta = math.radians(30.0 + 4.0 * math.sin(3.0 * psi + stroke))
    command = {
        "z_mm": 1e3 * (TOOL + HEIGHT + stroke),
        "psi_deg": math.degrees(psi),
        "theta_deg": math.degrees(theta),
    }
    return {
        "setup": setup,
        "run": f"circle {setup[0]}",
        "order": k,
        "command": command,
        "reading": {"length_mm": 1e3 * bar},
    }


# -- drawings --------------------------------------------------------------------------


def drawing(readings: list[dict[str, Any]]) -> dict[str, Any]:
    """The head at home, the cups, and a bar to each tool point."""
    base = _joints(RADIUS)
    platform = base + np.array([0.0, 0.0, HEIGHT])
    tip = np.array([0.0, 0.0, TOOL + HEIGHT])
    legs = [_line("machine", list(leg)) for leg in zip(base, platform, strict=True)]
    lines = [
        _line("machine", [*base, base[0]]),
        _line("machine", [*platform, platform[0]]),
        *legs,
        _line("machine", [platform.mean(axis=0), tip]),
    ]
    cups = {
        name: np.array([0.0, 0.0, TOOL + HEIGHT + stroke - 0.14])
        for name, (stroke, _) in SETUPS.items()
    }
    lines += [_line("cup", [cup]) for cup in cups.values()]
    tips = [_tool_point(reading) for reading in readings]
    setup_of_each = [reading["setup"] for reading in readings]
    return {
        "lines": lines,
        "tool_points": [tip.tolist() for tip in tips],
        "reading_of": setup_of_each,
        "bars": [
            [cups[setup].tolist(), tip.tolist()]
            for setup, tip in zip(setup_of_each, tips, strict=True)
        ],
    }


def delta_drawing() -> dict[str, Any]:
    """A linear delta with a grid of probed points."""
    feet = _joints(0.16)
    tool = np.array([0.0, 0.0, 0.02])
    top = np.array([0.0, 0.0, 0.72])
    carriage = np.array([0.0, 0.0, 0.33])
    columns = [_line("machine", [foot, foot + top]) for foot in feet]
    arms = [_line("machine", [foot + carriage, tool]) for foot in feet]
    steps = range(-2, 3)
    points = [[0.05 * i, 0.05 * j, 0.0] for i in steps for j in steps]
    return {
        "lines": columns + arms,
        "tool_points": points,
        "reading_of": ["probe"] * len(points),
        "bars": [],
    }


def _joints(radius: float) -> Array:
    corners = [[math.cos(angle), math.sin(angle), 0.0] for angle in ANGLES]
    return radius * np.array(corners)


def _rotation(psi: float, theta: float) -> Array:
    """Rotation by theta about a horizontal axis of azimuth psi."""
    x, y = math.cos(psi), math.sin(psi)
    cross = np.array([[0.0, 0.0, y], [0.0, 0.0, -x], [-y, x, 0.0]])
    twice = cross @ cross
    sine, versine = math.sin(theta), 1.0 - math.cos(theta)
    turn: Array = np.eye(3) + sine * cross + versine * twice
    return turn


def _tool_point(reading: dict[str, Any]) -> Array:
    """Tool point on the bar's sphere, roughly."""
    command = reading["command"]
    psi = math.radians(command["psi_deg"])
    theta = math.radians(command["theta_deg"])
    tip = _rotation(psi, theta) @ np.array([0.0, 0.0, TOOL])
    return np.array([tip[0], tip[1], 1e-3 * command["z_mm"]])


def _line(kind: str, points: list[Array]) -> dict[str, Any]:
    return {"kind": kind, "points": [point.tolist() for point in points]}
