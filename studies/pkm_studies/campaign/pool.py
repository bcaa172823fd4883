"""The same work on many items: in this process, on processes, or on a Dask cluster."""

from __future__ import annotations

import importlib
import multiprocessing
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from typing import Any, TypeVar

from pkm_studies.errors import InputError

#: items that wait for each process, so that none runs dry
QUEUE = 4
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
    pool = futures.ProcessPoolExecutor(
        count,
        mp_context=multiprocessing.get_context("spawn"),
        initializer=_end_with_parent,
    )
    try:
        waiting: dict[futures.Future[Outcome], Item] = {}
        for item in items:
            waiting[pool.submit(work, item)] = item
            if len(waiting) >= QUEUE * count:
                done, _ = futures.wait(waiting, return_when=futures.FIRST_COMPLETED)
                for future in done:
                    yield waiting.pop(future), future.result()
        for future in futures.as_completed(waiting):
            yield waiting[future], future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


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
        begun = client.map(work, list(items), pure=False)
        item_of = {future.key: item for future, item in zip(begun, items, strict=True)}
        for future in distributed.as_completed(begun):
            yield item_of[future.key], future.result()
