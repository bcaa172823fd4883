"""How long work tells where it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """What a pipeline tells: the stage it begins, and the share of it that is done."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def share(self, done: float) -> None:
        """Share (0..1) of the present stage that is done."""


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str) -> None:
        """Say nothing."""

    def share(self, done: float) -> None:
        """Say nothing."""
