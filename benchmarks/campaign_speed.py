"""A campaign in one process and on a local Dask cluster of two workers.

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

from pkm_studies.campaign import runner, tables
from pkm_studies.campaign.tables import Campaign

WORKERS = 2
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
        lambda: runner.run_cases(campaign, out, workers=1),
        lambda: [time.process_time()],
    )


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
            lambda: runner.run_cases(campaign, out, workers=1, scheduler=address),
            times,
        )


def _import() -> None:
    """What a worker needs before its first case."""
    import pkm_studies.campaign.runner  # noqa: F401


def main() -> None:
    """Print both, and what two workers gain."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign_speed")
    parser.add_argument("campaign", nargs="?", type=Path, default=Path("a3_noise"))
    parser.add_argument("--seeds", type=int, default=100, help="of each combination")
    options = parser.parse_args()
    campaign = tables.load_campaign(options.campaign).first(options.seeds)
    with tempfile.TemporaryDirectory() as folder:
        one = in_one_process(campaign, Path(folder) / "one")
        two = on_cluster(campaign, Path(folder) / "two")
    cases = len(campaign.settings()) * campaign.seeds
    print(f"{campaign.name}: {cases} cases")
    print(
        f"one process: {one.clock:.1f} s by the clock, {sum(one.processes):.1f} s of work"
    )
    shares = ", ".join(f"{seconds:.1f}" for seconds in two.processes)
    print(
        f"two workers: {two.clock:.1f} s by the clock; work of workers and store: {shares} s"
    )
    print(f"by the clock {one.clock / two.clock:.2f} times as fast")
    work = sum(one.processes)
    print(f"by the work, on free cores: {work / two.least:.2f} times,")
    idle = ", ".join(f"{100.0 * share:.1f}" for share in two.idle)
    print(f"without what idle processes take ({idle} %): {work / two.least_quiet:.2f}")


if __name__ == "__main__":
    main()
