"""What a world gives: cases with study, readings and truth."""

from __future__ import annotations

import dataclasses
import importlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, cast

from oed.gap import GapProblem
from oed.noise import NoiseLaw


@dataclasses.dataclass(frozen=True)
class Case:
    """A case of a world."""

    name: str  #: of the case
    study: Path  #: its study file
    readings: Path  #: its readings file
    label: Mapping[str, Any]  #: the truth, as `judge` reads it
    #: key of the random numbers that its diagnosis draws
    stream: int | Sequence[int] = 0
    #: the noise law of its residuals; None where the world does not give it
    true_law: Callable[[GapProblem], NoiseLaw] | None = None


class World(Protocol):
    """A module that draws cases."""

    def draw(self, setting: Mapping[str, Any], number: int, folder: Path) -> Case:
        """Case `number` of a setting, with its files in a folder.

        Raises ValueError, OSError where there is no such case.
        """


def load(name: str) -> World:
    """A world by name. Raises ModuleNotFoundError."""
    return cast(World, importlib.import_module(f"benchmarks.{name}.world"))
