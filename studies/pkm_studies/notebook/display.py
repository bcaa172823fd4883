"""Shows progress and plans on a terminal; elsewhere, one line a stage."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pkm_studies.base.progress import Progress, Silent

if TYPE_CHECKING:
    from oed.result import PlanSection, StageRecord

#: columns of a plan's table; texts are left-aligned, numbers right-aligned
TEXT_COLUMNS = ("Measurement", "Set-ups", "Accuracy afterwards")
COLUMNS = (
    "Stage",
    "Measurement",
    "Set-ups",
    "Readings",
    "Lost",
    "Min",
    "Rank",
    "Accuracy afterwards",
)
#: width of the table where there is no terminal
WIDTH = 120


class Lines(Silent):
    """One line a stage on stdout; stderr is for errors."""

    def stage(self, name: str) -> None:
        """Print the stage. The work goes on where nobody reads any more."""
        with contextlib.suppress(OSError):
            print(name, flush=True)


class Bar:
    """A bar of the rich package: it pulses until a stage reports its share."""

    def __init__(self, bar: Any) -> None:
        self._bar = bar
        self._task = bar.add_task("starting", total=None)

    def stage(self, name: str) -> None:
        """Begin a stage."""
        self._bar.update(self._task, description=name, completed=0.0, total=None)

    def share(self, done: float) -> None:
        """Move the bar to the share (0..1) of the stage that is done."""
        self._bar.update(self._task, completed=min(max(done, 0.0), 1.0), total=1.0)


@contextlib.contextmanager
def progress(*, quiet: bool) -> Iterator[Progress]:
    """The progress display that fits where stderr goes."""
    if quiet:
        yield Silent()
    elif sys.stderr.isatty():
        with _rich_bar() as bar:
            yield Bar(bar)
    else:
        yield Lines()


def _rich_bar() -> Any:
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        Progress,
        SpinnerColumn,
        TextColumn,
        TimeElapsedColumn,
    )

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TimeElapsedColumn(),
    )
    return Progress(*columns, console=Console(stderr=True), transient=True)


def print_plan(plan: PlanSection) -> None:
    """Print the plan as a table, with its remarks, on stdout."""
    from rich.console import Console
    from rich.table import Table

    budget = plan.budget_min or plan.cost
    table = Table(title=f"Plan: {plan.cost:.0f} of {budget:.0f} min")
    for name in COLUMNS:
        table.add_column(name, justify="left" if name in TEXT_COLUMNS else "right")
    for number, stage in enumerate(plan.stages, start=1):
        table.add_row(str(number), *_cells(stage))
    terminal = Console(width=None if sys.stdout.isatty() else WIDTH, highlight=False)
    terminal.print(table)
    for text in [plan.after, *plan.needs, plan.stop]:
        if text:
            terminal.print(text, markup=False)
    for sequence in plan.compared:
        accuracy = f"rank {sequence.rank}, weakest {sequence.weakest:.3g}"
        terminal.print(f"{sequence.name}: {accuracy}. {sequence.words}", markup=False)


def _cells(stage: StageRecord) -> list[str]:
    accuracy = []
    for key, value in stage.accuracy.items():
        component, _, unit = key.rpartition("_")
        accuracy.append(f"{component} {value:.3g} {unit}")
    return [
        stage.measurement,
        ", ".join(stage.setups),
        str(stage.readings),
        f"{stage.lost or 0.0:.1f}",
        f"{stage.begin_min or 0.0:.0f}-{stage.end_min or stage.cost:.0f}",
        str(stage.rank or stage.identifies),
        ", ".join(accuracy),
    ]
