"""How long work reports its progress."""

from typing import Protocol


class Progress(Protocol):
    """What a pipeline reports: the stage that begins, and the share that is done."""

    def stage(self, name: str) -> None:
        """A stage begins."""

    def share(self, done: float) -> None:
        """The share (0..1) of the present stage that is done."""


class Silent:
    """Progress that nobody watches."""

    def stage(self, name: str) -> None:
        """Ignore the stage."""

    def share(self, done: float) -> None:
        """Ignore the share."""
