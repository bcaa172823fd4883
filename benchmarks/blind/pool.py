"""The same work on many cases: in this process, on all cores, or on a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent import futures
from typing import Any, TypeVar

Job = TypeVar("Job")
Done = TypeVar("Done")


def results(
    work: Callable[[Job], Done],
    jobs: Sequence[Job],
    *,
    workers: int = 0,
    dask: str = "",
) -> Iterator[tuple[Job, Done]]:
    """Each job with what `work` makes of it, as they come.

    workers   processes; 0: one a core, 1: this process alone
    dask      address of a scheduler, in place of processes here; its workers need the
              project and the sets' folders
    """
    if dask:
        yield from _on_cluster(work, jobs, dask)
        return
    count = min(workers or os.cpu_count() or 1, max(len(jobs), 1))
    if count <= 1:
        for job in jobs:
            yield job, work(job)
        return
    os.environ["OPENBLAS_NUM_THREADS"] = "1"  # inherited: a core each
    context = multiprocessing.get_context("spawn")
    with futures.ProcessPoolExecutor(count, mp_context=context) as pool:
        begun = {pool.submit(work, job): job for job in jobs}
        try:
            for done in futures.as_completed(begun):
                yield begun[done], done.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise


def _on_cluster(
    work: Callable[[Job], Done], jobs: Sequence[Job], address: str
) -> Iterator[tuple[Job, Done]]:
    try:
        distributed: Any = __import__("distributed")
    except ImportError:
        raise ValueError(
            f"--dask {address}: the package `distributed` is not installed; `pip"
            " install dask[distributed]`"
        ) from None
    with distributed.Client(address) as client:
        begun = client.map(work, list(jobs), pure=False)
        of = {f.key: job for f, job in zip(begun, jobs, strict=True)}
        for done in distributed.as_completed(begun):
            yield of[done.key], done.result()
