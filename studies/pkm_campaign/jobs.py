"""Rows of many cases, each stored in a file of its own as soon as it is there.

A file is written whole or not at all. What is stored is not computed again, so that
work which was interrupted, or killed, goes on where it was.
"""

from __future__ import annotations

import ctypes
import dataclasses
import functools
import importlib
import itertools
import json
import multiprocessing
import os
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent import futures
from pathlib import Path
from typing import Any, Generic, TypeVar

from oed import child_process
from pkm_studies import files
from pkm_studies.base import InputError

# The same work on many items: in this process, on processes, or on a Dask cluster.
#
# Neighbouring items may share what is expensive to prepare. So each process starts with a
# stretch of neighbours, and takes others' items only once its own are done.

TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3  #: parameters of mallopt (malloc.h)
KEPT = 64 * 2**20  #: bytes of free memory that a process keeps
LARGEST = 32 * 2**20  #: bytes of the largest block that comes from there
ITEMS_AHEAD = 2  #: items that each process has at once, so that none waits for the next
PATIENCE = "10s"  #: seconds in which a scheduler has to answer

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")
Name = TypeVar("Name")  #: of a worker


def pool_results(
    work: Callable[[Item], Outcome],
    items: Sequence[Item],
    *,
    workers: int = 0,
    scheduler: str = "",
) -> Iterator[tuple[Item, Outcome]]:
    """Each item with what `work` returns for it, as they come.

    workers    processes on this computer; 0: one a core, 1: this process alone
    scheduler  address of a Dask scheduler, in place of them; its workers need the same
               packages and files

    Raises InputError where Dask is not installed, or the scheduler does not answer.
    """
    count = min(workers or os.cpu_count() or 1, len(items))
    if scheduler:
        yield from _run_on_cluster(work, items, scheduler)
    elif count > 1:
        yield from _run_on_processes(work, items, count)
    else:
        for item in items:
            yield item, work(item)


def _run_on_processes(
    work: Callable[[Item], Outcome], items: Sequence[Item], count: int
) -> Iterator[tuple[Item, Outcome]]:
    """From processes that are spawned, as on every system."""
    for variable in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[variable] = "1"  # inherited: a core each
    shares: Shares[int, Item] = Shares(items, range(count))
    processes = [child_process.worker(_end_with_parent) for _ in range(count)]
    waiting: dict[futures.Future[Outcome], tuple[int, Item]] = {}

    def submit(number: int) -> None:
        for item in shares.take(number):
            waiting[processes[number].submit(work, item)] = number, item

    try:
        for number in [*range(count)] * ITEMS_AHEAD:
            submit(number)
        while waiting:
            done, _ = futures.wait(waiting, return_when=futures.FIRST_COMPLETED)
            for future in done:
                number, item = waiting.pop(future)
                submit(number)
                yield item, future.result()
    finally:
        for process in processes:
            process.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.shutdown(wait=True)


class Shares(Generic[Name, Item]):
    """Items that are to be done, a stretch of neighbours for each worker."""

    def __init__(self, items: Sequence[Item], workers: Iterable[Name]) -> None:
        names = list(workers)
        parts = _stretches(items, len(names))
        self._shares = {n: deque(part) for n, part in zip(names, parts, strict=True)}

    def add(self, worker: Name) -> bool:
        """Whether a worker is new: it has none of its own, and takes others' items."""
        if worker in self._shares:
            return False
        self._shares[worker] = deque()
        return True

    def take(self, worker: Name) -> list[Item]:
        """The next item of a worker's share, or the last of the largest; none at the end."""
        share = self._shares[worker]
        if share:
            return [share.popleft()]
        largest = max(self._shares.values(), key=len)
        return [largest.pop()] if largest else []


def _stretches(items: Sequence[Item], count: int) -> list[Sequence[Item]]:
    """The items in so many parts of neighbours, as equal as they can be."""
    ends = [len(items) * k // count for k in range(count + 1)]
    return [items[i:j] for i, j in itertools.pairwise(ends)]


def _end_with_parent() -> None:
    """End this process with the one that started it, even where that is killed."""
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _run_on_worker(work: Callable[[Item], Outcome], item: Item) -> Outcome:
    keep_freed_memory()
    return work(item)


def _run_on_cluster(
    work: Callable[[Item], Outcome], items: Sequence[Item], scheduler: str
) -> Iterator[tuple[Item, Outcome]]:
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError(
            "Dask is not installed",
            "pip install pkm-oed[cluster], or leave the scheduler out",
            value=scheduler,
        ) from None
    try:
        client = distributed.Client(scheduler, timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"the scheduler does not answer: {error}",
            "start it with `dask scheduler`, and give the address that it prints",
            field="--scheduler",
            value=scheduler,
        ) from error
    with client:
        yield from _run_on_workers(work, items, client, distributed.as_completed)


def _run_on_workers(
    work: Callable[[Item], Outcome],
    items: Sequence[Item],
    client: Any,
    as_completed: Callable[[list[Any]], Any],
) -> Iterator[tuple[Item, Outcome]]:
    """From the workers of a client.

    Dask itself would hand over items from the middle of a share, each of which has to be
    prepared anew: so a worker has few at once, and another may do these if it is lost.
    """
    client.wait_for_workers(1)
    names = [*client.scheduler_info(n_workers=-1)["workers"]]
    shares: Shares[str, Item] = Shares(items, names)
    waiting: dict[Any, tuple[str, Item]] = {}
    task = functools.partial(_run_on_worker, work)

    def submit(name: str) -> list[Any]:
        begun = []
        for item in shares.take(name):
            future = client.submit(
                task, item, pure=False, workers=[name], allow_other_workers=True
            )
            waiting[future] = name, item
            begun.append(future)
        return begun

    done = as_completed([f for name in names * ITEMS_AHEAD for f in submit(name)])
    for future in done:
        name, item = waiting.pop(future)
        done.update(submit(name))
        for other in client.scheduler_info(n_workers=-1)["workers"]:
            if shares.add(other):
                done.update([f for _ in range(ITEMS_AHEAD) for f in submit(other)])
        yield item, future.result()


#
# A Dask worker starts with MALLOC_TRIM_THRESHOLD_, so that memory goes back to the system
# after each larger array and comes back page by page: cases then take a sixth more time.
# The two values are those that the C library of Linux reaches by itself (mallopt(3)).
@functools.cache
def keep_freed_memory() -> bool:
    """Whether it could be set: with the GNU C library alone. Once in a process."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    done = [mallopt(MMAP_THRESHOLD, LARGEST), mallopt(TRIM_THRESHOLD, KEPT)]
    return all(done)


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

    workers, scheduler  see `pool_results`
    batch               jobs that a process takes at once: neighbours may share what is
                        expensive to prepare
    """
    batches = [jobs[i : i + batch] for i in range(0, len(jobs), batch)]
    cases = [tuple(job.case for job in part) for part in batches]
    numbered = list(enumerate(cases))
    task = functools.partial(_work, work)
    for (number, _), rows in pool_results(
        task, numbered, workers=workers, scheduler=scheduler
    ):
        for job, row in zip(batches[number], rows, strict=True):
            files.write_whole(job.path, json.dumps(row))
            yield row


def _work(
    work: Callable[[Case], Row], numbered: tuple[int, Sequence[Case]]
) -> list[Row]:
    return [work(case) for case in numbered[1]]


def read_row(path: Path) -> Row:
    """The row of a job that is done. Raises ValueError where it is not whole."""
    row = json.loads(path.read_bytes())
    if not isinstance(row, dict):
        raise ValueError("no row of a table")
    return row


def is_done(
    path: Path, done_setting: Mapping[str, Any], required: Sequence[str]
) -> bool:
    """Whether a file has the whole row of a job with values known before and `required`."""
    try:
        row = read_row(path)
    except (OSError, ValueError, RecursionError):
        return False
    has_all = row.keys() >= {*done_setting, *required}
    return has_all and all(row[name] == value for name, value in done_setting.items())
