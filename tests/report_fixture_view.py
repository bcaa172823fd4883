"""A whole result whose residuals, runs and error map have places, for the views."""

from __future__ import annotations

import math
from typing import Any

import report_fixture


def sample() -> dict[str, Any]:
    """The sample with places for the error map, and circles of readings with residuals."""
    raw = report_fixture.sample()
    poses = raw["design"]["poses"]
    drawing = raw["drawing"]
    drawing["runs"] = [pose["run"] for pose in poses]
    drawing["commands"] = [pose["command"] for pose in poses]
    drawing["tool_points"] = [_on_circle(k) for k in range(len(poses))]
    drawing["labels"] = [
        {"at": [0.0, -0.25, 0.0], "text": "db1x, y", "parameters": ["db1x", "db1y"]},
        {"at": [0.2, 0.1, 0.27], "text": "dq2", "parameters": ["dq2"]},
    ]
    for point in raw["prediction"]["map"]:
        command = point["command"]
        turn = math.radians(command["psi_deg"])
        reach = 0.5 * math.sin(math.radians(command["theta_deg"]))
        height = 1e-3 * command["z_mm"]
        point["at"] = [reach * math.cos(turn), reach * math.sin(turn), height]
    return raw


def _on_circle(k: int) -> list[float]:
    """15 points round each of two circles, m."""
    turn, height = 2.0 * math.pi * (k % 15) / 15.0, 1.15 + 0.1 * (k // 15)
    return [0.25 * math.cos(turn), 0.25 * math.sin(turn), height]
