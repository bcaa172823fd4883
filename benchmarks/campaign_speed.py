"""How much faster a local Dask cluster of two workers runs a campaign than one process.

    python -m benchmarks.campaign_speed [CAMPAIGN] [--seeds N]

Imports and report do not count; compilation and the preparation of each combination do, on
both sides. The ratio is by processor time, which other load on the computer changes little:
on free cores, two workers are not faster than the work of the busier one, nor than half of
all work. The cluster's processes look after each other even when idle; that share is
measured before the cases and taken off.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from pathlib import Path
from typing import Any, NamedTuple

from pkm_campaign import Campaign, load_campaign, run_cases

WORKERS = 2
IDLE_S = 10.0  #: seconds for which an idle cluster is watched


class Taken(NamedTuple):
    """Seconds by the clock, and processor time of each process without that of an idle one."""

    clock: float
    work: list[float]
    busy: list[float]  #: shares (p,) of a core that each process takes when idle

    @property
    def least(self) -> float:
        """Clock seconds T on as many free cores as there are workers: T = work + busy T."""
        pairs = zip(self.work, self.busy, strict=True)
        busiest = max(work / (1.0 - busy) for work, busy in pairs)
        return max(busiest, sum(self.work) / (WORKERS - sum(self.busy)))


def on_cluster(campaign: Campaign, out: Path) -> Taken:
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

        before = times()
        time.sleep(IDLE_S)
        begun, begin = times(), time.perf_counter()
        run_cases(campaign, out, workers=1, scheduler=address)
        clock = time.perf_counter() - begin
        busy = [seconds / IDLE_S for seconds in _passed(before, begun)]
        total = _passed(begun, times())
    work = [t - clock * share for t, share in zip(total, busy, strict=True)]
    return Taken(clock, work, busy)


def _passed(before: list[float], after: list[float]) -> list[float]:
    return [b - a for a, b in zip(before, after, strict=True)]


def _import() -> None:
    """What a worker needs before its first case."""
    from pkm_campaign import run_cases  # noqa: F401


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.campaign_speed")
    parser.add_argument("campaign", nargs="?", type=Path, default=Path("a3_noise"))
    parser.add_argument("--seeds", type=int, default=100, help="of each combination")
    options = parser.parse_args()
    campaign = load_campaign(options.campaign).first(options.seeds)
    with tempfile.TemporaryDirectory() as folder:
        begin, start = time.perf_counter(), time.process_time()
        run_cases(campaign, Path(folder) / "one", workers=1)
        clock, work = time.perf_counter() - begin, time.process_time() - start
        cluster = on_cluster(campaign, Path(folder) / "cluster")
    print(f"{campaign.name}, {len(campaign.settings()) * campaign.seeds} cases")
    print(f"one process: {clock:.1f} s, work {work:.1f} s")
    shares = ", ".join(f"{seconds:.1f}" for seconds in cluster.work)
    print(f"cluster: {cluster.clock:.1f} s, work {shares} s")
    print(f"by the work, without what idle processes take: {work / cluster.least:.2f}")


if __name__ == "__main__":
    main()
