"""A campaign in one process, in two, and on a local Dask cluster of two workers.

    python -m benchmarks.campaign_speed [CAMPAIGN] [--seeds N]

The case part alone is measured: imports and report are a fixed start, but compilation
and the preparation of each combination count, on both sides. Beside the clock stand processor
times, which other load on the computer changes little: on free cores, two workers
cannot be faster than the work of the busier one, nor than half of all work. The
cluster's processes look after each other even when idle; on a loaded computer, where
the clock runs long, that share is measured and taken off.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from pkm_campaign import Campaign, load_campaign, run_cases

WORKERS = 2
#: of a long campaign
MANY = 10_000
#: seconds for which an idle cluster is watched
IDLE = 10.0


@dataclasses.dataclass(frozen=True)
class Measured:
    """Seconds of a case part.

    clock      from its begin to its end
    processes  processor time of each process; the last one starts and stores the cases
    idle       processor time of each in a second without cases
    """

    clock: float
    processes: Sequence[float]
    idle: Sequence[float]

    @property
    def least(self) -> float:
        """Clock seconds on as many free cores as there are workers."""
        return max(*self.processes, sum(self.processes) / WORKERS)

    @property
    def work(self) -> list[float]:
        """Processor time of each process without that of an idle one."""
        pairs = zip(self.processes, self.idle, strict=True)
        return [total - self.clock * idle for total, idle in pairs]

    @property
    def least_quiet(self) -> float:
        """The same on a computer without other load: T = work + idle T."""
        pairs = zip(self.work, self.idle, strict=True)
        busiest = max(work / (1.0 - idle) for work, idle in pairs)
        return max(busiest, sum(self.work) / (WORKERS - sum(self.idle)))


def measured(run: Callable[[], None], times: Callable[[], list[float]]) -> Measured:
    """The seconds of a run; `times` reads the processor times of all processes."""
    before = times()
    time.sleep(IDLE)
    begun, begin = times(), time.perf_counter()
    run()
    clock = time.perf_counter() - begin
    idle = [(b - a) / IDLE for a, b in zip(before, begun, strict=True)]
    taken = [b - a for a, b in zip(begun, times(), strict=True)]
    return Measured(clock, taken, idle)


def in_one_process(campaign: Campaign, out: Path) -> Measured:
    """All cases in this process."""
    return measured(
        lambda: run_cases(campaign, out, workers=1), lambda: [time.process_time()]
    )


def in_two_processes(campaign: Campaign, out: Path) -> Measured:
    """All cases in processes of this computer, their start included; the clock alone."""
    return measured(lambda: run_cases(campaign, out, workers=WORKERS), list)


def on_cluster(campaign: Campaign, out: Path) -> Measured:
    """All cases on two workers of a scheduler in this process, as the guide starts them."""
    import dask
    import distributed

    with (
        dask.config.set({"distributed.worker.profile.enabled": False}),
        distributed.LocalCluster(
            n_workers=WORKERS, threads_per_worker=1, dashboard_address=None
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        address = cluster.scheduler_address
        client.run(_import)

        def times() -> list[float]:
            workers: dict[str, Any] = client.run(time.process_time)
            return [*(workers[key] for key in sorted(workers)), time.process_time()]

        return measured(
            lambda: run_cases(campaign, out, workers=1, scheduler=address), times
        )


def _import() -> None:
    """What a worker needs before its first case."""
    from pkm_campaign import run_cases  # noqa: F401


def compare(campaign: Campaign) -> None:
    """Print one row a way of running all cases."""
    cases = len(campaign.settings()) * campaign.seeds
    print(
        f"| {campaign.name}, {cases} cases | s | cases/s | work, s | {MANY} cases, min |"
    )
    print("| --- | --: | --: | --: | --: |")
    with tempfile.TemporaryDirectory() as folder:
        one = in_one_process(campaign, Path(folder) / "one")
        print_row("one process", one, cases)
        two = in_two_processes(campaign, Path(folder) / "two")
        print_row("two processes", two, cases)
        cluster = on_cluster(campaign, Path(folder) / "cluster")
        print_row("Dask cluster of two workers", cluster, cases)
    print_gain(one, cluster)


def print_row(name: str, taken: Measured, cases: int) -> None:
    """Print seconds by the clock, cases a second, and processor seconds of all processes."""
    minutes = taken.clock / cases * MANY / 60.0
    work = f"{sum(taken.processes):.1f}" if taken.processes else "-"
    print(
        f"| {name} | {taken.clock:.1f} | {cases / taken.clock:.1f}"
        f" | {work} | {minutes:.1f} |",
        flush=True,
    )


def print_gain(one: Measured, two: Measured) -> None:
    """Print what two workers of the cluster gain."""
    shares = ", ".join(f"{seconds:.1f}" for seconds in two.processes)
    print(f"work of the cluster's workers and store: {shares} s")
    print(f"by the clock {one.clock / two.clock:.2f} times as fast")
    work = sum(one.processes)
    print(f"by the work, on free cores: {work / two.least:.2f} times,")
    idle = ", ".join(f"{100.0 * share:.1f}" for share in two.idle)
    print(f"without what idle processes take ({idle} %): {work / two.least_quiet:.2f}")


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign_speed")
    parser.add_argument("campaign", nargs="?", type=Path, default=Path("a3_noise"))
    parser.add_argument("--seeds", type=int, default=100, help="of each combination")
    options = parser.parse_args()
    compare(load_campaign(options.campaign).first(options.seeds))


if __name__ == "__main__":
    main()
