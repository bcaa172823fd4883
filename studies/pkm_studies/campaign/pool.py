"""The same work on many items: in this process, on processes, or on a Dask cluster.

Neighbouring items may share what is expensive to prepare. So each process starts with a
stretch of neighbours, and takes others' items only once its own are done.
"""

from __future__ import annotations

import importlib
import itertools
import multiprocessing
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from typing import Any, TypeVar

from pkm_studies.errors import InputError

#: items that each process has at once, so that none waits for the next
AHEAD = 2
#: seconds in which a scheduler has to answer
PATIENCE = "10s"

Item = TypeVar("Item")
Outcome = TypeVar("Outcome")


def results(
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
        yield from _on_cluster(work, items, scheduler)
    elif count > 1:
        yield from _on_processes(work, items, count)
    else:
        for item in items:
            yield item, work(item)


def _on_processes(
    work: Callable[[Item], Outcome], items: Sequence[Item], count: int
) -> Iterator[tuple[Item, Outcome]]:
    """From processes that are spawned, as on every system."""
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited: a core each
    shares = [deque(share) for share in _stretches(items, count)]
    context = multiprocessing.get_context("spawn")
    processes = [
        futures.ProcessPoolExecutor(1, context, _end_with_parent) for _ in shares
    ]
    waiting: dict[futures.Future[Outcome], tuple[int, Item]] = {}

    def submit(number: int) -> None:
        """Give a process the next item of its share, or another's last one."""
        largest = max(shares, key=len)
        if not largest:
            return
        share = shares[number]
        item = share.popleft() if share else largest.pop()
        waiting[processes[number].submit(work, item)] = number, item

    try:
        for number in [*range(len(processes))] * AHEAD:
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


def _stretches(items: Sequence[Item], count: int) -> list[Sequence[Item]]:
    """The items in so many parts of neighbours, as equal as they can be."""
    ends = [len(items) * k // count for k in range(count + 1)]
    return [items[i:j] for i, j in itertools.pairwise(ends)]


def _end_with_parent() -> None:
    """End this process with the one that started it, even where that is killed.

    Otherwise it would wait for work without end.
    """
    parent = multiprocessing.parent_process()
    if parent is None:
        return

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _on_cluster(
    work: Callable[[Item], Outcome], items: Sequence[Item], scheduler: str
) -> Iterator[tuple[Item, Outcome]]:
    """From the workers of a Dask scheduler."""
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        raise InputError(
            "Dask is not installed",
            "pip install distributed, or leave the scheduler out",
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
        addresses = [*client.scheduler_info(n_workers=-1)["workers"]]
        item_of: dict[Any, Item] = {}
        for number, stretch in enumerate(_stretches(items, max(len(addresses), 1))):
            begun = client.map(
                work,
                list(stretch),
                pure=False,
                workers=addresses[number : number + 1] or None,
                allow_other_workers=bool(addresses),
            )
            item_of |= dict(zip(begun, stretch, strict=True))
        for future in distributed.as_completed(list(item_of)):
            yield item_of.pop(future), future.result()
