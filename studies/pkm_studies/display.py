"""Progress as a person sees it: a bar on a terminal, one line a stage elsewhere, nothing where quiet is wanted."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import Any

from pkm_studies.progress import Progress, Silent


class Lines(Silent):
    """One line a stage, on stdout: stderr is for what went wrong."""

    def stage(self, name: str) -> None:
        """A stage begins. Work goes on where nobody reads any more (`oed run ... | head`)."""
        with contextlib.suppress(BrokenPipeError):
            print(name, flush=True)


class Bar:
    """A bar of the rich package: it pulses until a stage tells its share."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._task = bar.add_task("starting", total=None)

    def stage(self, name: str) -> None:
        """A stage begins."""
        self._bar.update(self._task, description=name, completed=0.0, total=None)

    def share(self, done: float) -> None:
        """Share (0..1) of the present stage that is done."""
        self._bar.update(self._task, completed=min(max(done, 0.0), 1.0), total=1.0)


@contextlib.contextmanager
def shown(*, quiet: bool) -> Iterator[Progress]:
    """The progress that fits where stderr goes."""
    if quiet:
        yield Silent()
    elif sys.stderr.isatty():
        with _rich() as bar:
            yield Bar(bar)
    else:
        yield Lines()


def _rich() -> Any:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn()
    return Progress(*columns, console=Console(stderr=True), transient=True)
