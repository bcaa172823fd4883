"""Rows of many cases, each stored in a file of its own as soon as it is there.

A file is written whole or not at all. What is stored is not computed again, so that
work which was interrupted, or killed, goes on where it was.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Generic, TypeVar

from oed.mechanism.compiled.switch import begin_job
from pkm_campaign import pool
from pkm_studies import files

#: digits of case numbers in messages and files that a row may hold: plain JSON
Row = dict[str, Any]
Case = TypeVar("Case")


@dataclasses.dataclass(frozen=True, slots=True)
class Job(Generic[Case]):
    """A case, and the file of its row."""

    path: Path
    case: Case


def run_jobs(
    work: Callable[[Case], Row],
    jobs: Sequence[Job[Case]],
    *,
    workers: int = 0,
    scheduler: str = "",
    batch: int = 1,
) -> Iterator[Row]:
    """Store the row of each job that `work` computes, and yield it, as they come.

    workers, scheduler  see `pool.results`
    batch               jobs that a process takes at once: neighbours may share what is
                        expensive to prepare
    """
    batches = [jobs[i : i + batch] for i in range(0, len(jobs), batch)]
    cases = [tuple(job.case for job in part) for part in batches]
    numbered = list(enumerate(cases))
    task = functools.partial(_work, work)
    for (number, _), rows in pool.results(
        task, numbered, workers=workers, scheduler=scheduler
    ):
        for job, row in zip(batches[number], rows, strict=True):
            files.write_whole(job.path, json.dumps(row))
            yield row


def _work(
    work: Callable[[Case], Row], numbered: tuple[int, Sequence[Case]]
) -> list[Row]:
    return [_row(work, case) for case in numbered[1]]


def _row(work: Callable[[Case], Row], case: Case) -> Row:
    """The row of a case, whatever this process has done before."""
    begin_job()
    return work(case)


def read_row(path: Path) -> Row:
    """The row of a job that is done. Raises ValueError where it is not whole."""
    row = json.loads(path.read_bytes())
    if not isinstance(row, dict):
        raise ValueError("no row of a table")
    return row


def is_done(path: Path, known: Mapping[str, Any], required: Sequence[str]) -> bool:
    """Whether a file has the whole row of a job, with values that are known before.

    required  names of further values
    """
    try:
        row = read_row(path)
    except (OSError, ValueError, RecursionError):
        return False
    has_all = row.keys() >= {*known, *required}
    return has_all and all(row[name] == value for name, value in known.items())
