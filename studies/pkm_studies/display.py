"""Progress as a person sees it: a bar on a terminal, one line a stage elsewhere,
nothing where quiet is wanted.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from pkm_studies.progress import Progress, Silent

if TYPE_CHECKING:
    from oed.result import PlanSection


class Lines(Silent):
    """One line a stage, on stdout: stderr is for what went wrong."""

    def stage(self, name: str) -> None:
        """A stage begins. Work goes on where nobody reads any more (`oed run ... |
        head`).
        """
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


def stages(plan: PlanSection) -> None:
    """The plan as a table, with what to know beside it, on stdout."""
    from rich.console import Console
    from rich.table import Table

    table = Table(
        title=f"Plan: {plan.cost:.0f} of {plan.budget_min or plan.cost:.0f} min"
    )
    for name in (
        "Stage",
        "Measurement",
        "Set-ups",
        "Readings",
        "Lost",
        "Min",
        "Rank",
        "Accuracy afterwards",
    ):
        table.add_column(
            name,
            justify=(
                "left"
                if name in ("Measurement", "Set-ups", "Accuracy afterwards")
                else "right"
            ),
        )
    for k, s in enumerate(plan.stages):
        told = ", ".join(
            f"{n.rpartition('_')[0]} {v:.3g} {n.rpartition('_')[2]}"
            for n, v in s.accuracy.items()
        )
        time = f"{s.begin_min or 0.0:.0f}-{s.end_min or s.cost:.0f}"
        row = [
            str(s.readings),
            f"{s.lost or 0.0:.1f}",
            time,
            str(s.rank or s.identifies),
            told,
        ]
        table.add_row(str(k + 1), s.measurement, ", ".join(s.setups), *row)
    console = Console(width=None if sys.stdout.isatty() else 120, highlight=False)
    console.print(table)
    for text in [plan.after, *plan.needs, plan.stop]:
        if text:
            console.print(text, markup=False)
    for one in plan.compared:
        console.print(
            f"{one.name}: rank {one.rank}, weakest {one.weakest:.3g}. {one.words}",
            markup=False,
        )
