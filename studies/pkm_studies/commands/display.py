"""Shows progress and plans on a terminal; elsewhere, one line a stage."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from pkm_studies import console
from pkm_studies.base import Progress, Silent

if TYPE_CHECKING:
    from oed.result import PlanSection, StageRecord

#: columns of a plan's table, before those of the accuracy; numbers are right-aligned
TEXT_COLUMNS = ("Measurement", "Set-ups")
COLUMNS = ("No.", *TEXT_COLUMNS, "Readings", "Lost", "Min", "Rank")


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


def plan_lines(plan: PlanSection, *, verbose: bool) -> list[str]:
    """The plan as a table, with its remarks; `verbose`: other sequences as well."""
    from rich import box
    from rich.table import Table

    budget = plan.budget_min or plan.cost
    accuracies = list(dict.fromkeys(key for s in plan.stages for key in s.accuracy))
    table = Table(box=box.SIMPLE_HEAD, show_edge=False, padding=(0, 1, 0, 0))
    for name in (*COLUMNS, *map(_heading, accuracies)):
        side: Any = "left" if name in TEXT_COLUMNS else "right"
        table.add_column(
            name, justify=side, no_wrap=name not in TEXT_COLUMNS, overflow="fold"
        )
    for number, stage in enumerate(plan.stages, start=1):
        table.add_row(str(number), *_cells(stage, accuracies))
    title = f"Plan of {plan.cost:.0f} of {budget:.0f} min; rms error after each stage:"
    lines = [title, *console.table_lines(table), *plan.needs]
    lines += [plan.after] if plan.after else []
    lines += [f"Stop: {plan.stop}"] if plan.stop else []
    for sequence in plan.compared if verbose else ():
        accuracy = f"rank {sequence.rank}, weakest {sequence.weakest:.3g}"
        lines.append(f"{sequence.name}: {accuracy}. {sequence.words}")
    return lines


def _heading(key: str) -> str:
    """`z_um` as `z`, and below it `[um]`: a column no wider than its numbers."""
    component, _, unit = key.rpartition("_")
    return f"{component}\n[{unit}]"


def _cells(stage: StageRecord, accuracies: Sequence[str]) -> list[str]:
    reached = [stage.accuracy.get(key) for key in accuracies]
    return [
        stage.measurement,
        ", ".join(stage.setups),
        str(stage.readings),
        f"{stage.lost or 0.0:.1f}",
        f"{stage.begin_min or 0.0:.0f}-{stage.end_min or stage.cost:.0f}",
        str(stage.rank or stage.identifies),
        *["" if value is None else f"{value:.3g}" for value in reached],
    ]
