"""How cases go to processes and workers, and campaigns that are killed."""

from __future__ import annotations

import dataclasses
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from fresh_process import printed_by

from pkm_campaign import jobs, load_campaign, read_row, run_cases
from pkm_studies.user_code import Consent


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


SEEDS, KILLS = 500, 5
FUNCTION = """\
import numpy as np

def figures(setting, seed):
    rng = np.random.default_rng([len(setting["law"]), setting["size"], seed])
    values = rng.standard_normal(setting["size"])
    return {"mean": values.mean(), "largest": values.max()}
"""
CAMPAIGN = f"""\
schema = 1
name = "killed"
case = "own.py:figures"
seeds = {SEEDS}

[vary]
law = ["white", "student"]
size = [10, 1000]
"""
COMMAND = "import sys; from pkm_studies.commands import cli; sys.exit(cli.main())"


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / "own.py").write_text(FUNCTION, encoding="utf-8")
    path = tmp_path / "killed.campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


def start(campaign: Path, out: Path) -> subprocess.Popen[bytes]:
    arguments = ["campaign", str(campaign), "--out", str(out), "--workers", "2"]
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, *arguments, "--quiet"],
        stdout=subprocess.DEVNULL,
        env={**os.environ, "CAMPAIGN_UNDER_TEST": str(out)},
    )


def stored(out: Path) -> int:
    return len(list((out / "cases").glob("*-*.json")))


def processes(out: Path) -> list[int]:
    """Processes of the campaign that still run, with those that it started."""
    mark = f"CAMPAIGN_UNDER_TEST={out}".encode()
    running = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            environment = (folder / "environ").read_bytes()
            state = (folder / "stat").read_text(encoding="utf-8").split()[2]
        except OSError:
            continue
        if mark in environment.split(b"\0") and state != "Z":
            running.append(int(folder.name))
    return running


def kill_at(campaign: Path, out: Path, count: int, delay: float) -> None:
    """Kill the command, and it alone, once so many cases are stored and a while later."""
    process = start(campaign, out)
    while stored(out) < count:
        assert process.poll() is None, "it ended before it was killed"
        time.sleep(0.002)
    time.sleep(delay)
    process.send_signal(signal.SIGKILL)
    assert process.wait() == -signal.SIGKILL
    patience = time.monotonic() + 20.0
    while processes(out):
        assert time.monotonic() < patience, "its processes outlive it"
        time.sleep(0.05)


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/proc/self/environ").exists(), reason="needs the processes of Linux"
)
def test_a_campaign_killed_five_times_ends_as_an_unbroken_one(campaign, tmp_path):
    broken, whole = tmp_path / "broken", tmp_path / "whole"
    rng = np.random.default_rng()  # another moment in every run of this test
    total = 4 * SEEDS
    for count in np.sort(rng.integers(1, int(0.8 * total), KILLS)):
        kill_at(campaign, broken, max(int(count), stored(broken)), rng.uniform(0, 0.05))
        assert stored(broken) < total
    for out in (broken, whole):
        assert start(campaign, out).wait() == 0
    table = pd.read_parquet(broken / "cases.parquet")
    assert len(table) == total == stored(broken)
    assert len(table.drop_duplicates(["law", "size", "seed"])) == total
    for name in ("cases.parquet", "cases.csv", "summary.csv", "report.html"):
        assert (broken / name).read_bytes() == (whole / name).read_bytes()


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="no process ends by SIGKILL")
def test_a_campaign_survives_the_death_of_a_worker(campaign, tmp_path):
    """A case kills the worker that computes it first; another one repeats the case."""
    import distributed  # takes a second to import

    killed, own = tmp_path / "killed", tmp_path / "own.py"
    deadly = f"""
    import os, pathlib
    killed = pathlib.Path({str(killed)!r})
    if seed == 10 and not killed.exists():
        killed.touch()
        os.kill(os.getpid(), {signal.SIGKILL:d})
"""
    first = load_campaign(campaign, consent=Consent.GIVEN).first(20)
    run_cases(first, tmp_path / "whole", workers=1)
    changed = FUNCTION.replace("seed):\n", f"seed):{deadly}")
    own.write_text(changed, encoding="utf-8")
    first = load_campaign(campaign, consent=Consent.GIVEN).first(20)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        run_cases(first, tmp_path / "broken", workers=1, scheduler=address)
    assert killed.exists()
    whole, broken = (
        {path.name: read_row(path) for path in (tmp_path / out / "cases").glob("*-*")}
        for out in ("whole", "broken")
    )
    assert len(whole) == 80
    for row in (*whole.values(), *broken.values()):
        row.pop("cpu_s", None)  # differs from run to run
    assert broken == whole
