"""How the cases of a campaign go to processes, and to the workers of a cluster."""

from __future__ import annotations

import dataclasses
import os
import sys
import time
from collections.abc import Callable
from types import ModuleType

import pytest
from fresh_process import printed_by

from pkm_campaign import jobs


@dataclasses.dataclass(eq=False)
class Future:
    """What a worker is to do."""

    worker: str
    item: int
    result: Callable[[], int]


class Cluster(ModuleType):
    """Dask with workers `one` and `two`, of which the second is fast; `three` joins.

    `done` has what each of them did, in order.
    """

    def __init__(self) -> None:
        super().__init__("distributed")
        self.done = {"one": [], "two": [], "three": []}
        self.queue: list[Future] = []

    def Client(self, address: str, timeout: str) -> Cluster:
        assert address == "tcp://there:8786"
        return self

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def wait_for_workers(self, count: int) -> None:
        assert count == 1

    def scheduler_info(self, n_workers: int) -> dict:
        count = 2 if sum(map(len, self.done.values())) < 6 else 3
        return {"workers": dict.fromkeys([*self.done][:count])}

    def submit(self, work, item, pure, workers, allow_other_workers):
        assert not pure
        assert allow_other_workers
        return Future(workers[0], item, lambda: work(item))

    def as_completed(self, futures: list) -> Cluster:
        self.queue = list(futures)
        return self

    def update(self, futures: list) -> None:
        self.queue += futures

    def __iter__(self):
        while self.queue:
            fast = [f for f in self.queue if f.worker != "one"]
            slow = len(self.done["two"]) % 3 == 2 or not fast
            future = self.queue[0] if slow else fast[0]
            self.queue.remove(future)
            self.done[future.worker].append(future.item)
            yield future


def test_items_go_to_a_cluster_and_come_back_with_their_results(monkeypatch):
    """Neighbours to each worker, and of others the last ones; late workers help."""
    cluster = Cluster()
    monkeypatch.setitem(sys.modules, "distributed", cluster)
    items = list(range(20))
    come = jobs.pool_results(lambda item: item**2, items, scheduler="tcp://there:8786")
    assert sorted(come) == [(item, item**2) for item in items]
    one, two, three = cluster.done.values()
    assert sorted([*one, *two, *three]) == items
    for stretch, worker in ((items[:10], one), (items[10:], two)):
        own = [item for item in worker if item in stretch]
        assert own == stretch[: len(own)]
    assert len(set(one) & set(items[:10])) < 10  # others helped at its end
    assert three


#: arrays of 0.4 MB, as cases have them; prints page faults before and after
ARRAYS = """
import resource

import numpy as np

from pkm_campaign.jobs import keep_freed_memory


def faults():
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(400):
        np.ones(50_000).sum()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


print(faults(), int(keep_freed_memory()), faults())
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the GNU C library's")
def test_freed_memory_stays_in_a_process_that_dask_has_started():
    environment = {**os.environ, "MALLOC_TRIM_THRESHOLD_": "65536"}
    [line] = printed_by(ARRAYS, environment=environment)
    before, is_set, after = map(int, line.split())
    assert is_set
    assert before > 400 * 50
    assert after < 0.05 * before


def test_processes_share_items_and_take_those_of_others():
    items = [0.02] * 2 + [0.0] * 7
    come = list(jobs.pool_results(_nap, items, workers=2))
    assert sorted(item for item, _ in come) == sorted(items)
    assert all(process != os.getpid() for _, process in come)
    assert len({process for _, process in come}) == 2


def _nap(seconds: float) -> int:
    """The process that rested so long."""
    time.sleep(seconds)
    return os.getpid()
