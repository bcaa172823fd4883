"""Which commands of a pose are the axes of a map, and which one makes its panels."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Final

import numpy as np

from oed.base import Array, Mask

POLAR: Final = ("psi_deg", "theta_deg")
MOST_LEVELS: Final = 4
#: levels from which a command is not a stack of layers but a cloud
CLOUD: Final = 8


@dataclasses.dataclass(frozen=True, slots=True)
class MapLayout:
    """The commands that a map shows.

    across, up    names of the axes
    panel         command with a panel for each of its levels, None for a single panel
    levels        values of that command
    """

    across: str
    up: str
    panel: str | None
    levels: list[float]

    @property
    def polar(self) -> bool:
        """Whether the angle is the azimuth of the tilt and the radius the tilt."""
        return (self.across, self.up) == POLAR

    def poses_at(
        self,
        level: float,
        commands: Mapping[str, Array],
    ) -> Mask:
        """Which poses (n,) belong to a panel."""
        if self.panel is None:
            return np.ones(len(commands[self.across]), dtype=bool)
        return np.asarray(commands[self.panel] == level)


def choose_layout(commands: Mapping[str, Array]) -> MapLayout:
    """Polar axes for psi and theta; otherwise the first two commands that vary."""
    varying = [name for name, values in commands.items() if np.ptp(values) > 0]
    constant = [name for name in commands if name not in varying]
    ordered = [*varying, *constant]
    across, up = POLAR if set(POLAR) <= set(commands) else ordered[:2]
    others = [name for name in ordered if name not in (across, up)]
    if not others:
        return MapLayout(across, up, None, [np.nan])
    levels = np.unique(commands[others[0]])
    if len(levels) > CLOUD:
        return MapLayout(across, up, None, [np.nan])
    spaced = np.linspace(0, len(levels) - 1, min(MOST_LEVELS, len(levels)))
    picked = np.unique(spaced.round().astype(int))
    return MapLayout(across, up, others[0], levels[picked].tolist())
