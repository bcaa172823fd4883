"""Runs the cases of a campaign on processes of this computer, or on a Dask cluster.

Each case leaves a file of its own, written whole. What is there is not done again, so
that a campaign which was interrupted goes on where it was.
"""

from __future__ import annotations

import concurrent.futures
import contextlib
import importlib
import json
import multiprocessing
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

from pkm_studies import files
from pkm_studies.campaign.machine_case import Case, work
from pkm_studies.campaign.tables import Campaign
from pkm_studies.errors import InputError

#: cases that a process takes at once: neighbours share a combination, and its plan
BATCH = 10
#: batches that wait for each process, so that none runs dry
QUEUE = 4

Batch = list[tuple[Path, Case]]


def run_cases(
    campaign: Campaign,
    out: Path,
    *,
    workers: int,
    scheduler: str | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> None:
    """Do the cases that `out` lacks.

    workers    processes on this computer; 1: this one alone
    scheduler  address of a Dask scheduler, in place of them

    Raises InputError where the folder belongs to another campaign.
    """
    folder = _case_folder(campaign, out)
    cases = list(_cases(campaign, folder))
    missing = [(path, case) for path, case in cases if not path.is_file()]
    done = len(cases) - len(missing)
    batches = [missing[i : i + BATCH] for i in range(0, len(missing), BATCH)]
    for results in _results(batches, workers, scheduler):
        for name, row in results:
            files.write_whole(Path(name), json.dumps(row))
        done += len(results)
        progress(done / len(cases))


def case_paths(campaign: Campaign, out: Path) -> list[Path]:
    """Files of all cases, in order, whether they are there or not."""
    return [path for path, _ in _cases(campaign, out / "cases")]


def _case_folder(campaign: Campaign, out: Path) -> Path:
    """The folder of the cases, which holds those of this campaign alone."""
    stamp = out / "campaign.toml"
    content = f"# study: {files.digest(campaign.varied.text.encode())}\n{campaign.text}"
    if stamp.is_file() and stamp.read_text(encoding="utf-8") != content:
        raise InputError(
            "it holds cases of another campaign, or of this one before a change",
            "choose another folder with --out, or remove this one",
            file=str(out),
        )
    files.write_whole(stamp, content)
    return out / "cases"


def _cases(campaign: Campaign, folder: Path) -> Iterator[tuple[Path, Case]]:
    path = str(campaign.varied.path)
    for number, setting in enumerate(campaign.settings(), start=1):
        text = campaign.study_with(setting).text
        for k in range(campaign.seeds):
            seed = campaign.first_seed + k
            case = Case(text, path, setting, seed, campaign.diagnose)
            yield folder / f"{number:04d}-{seed:06d}.json", case


def _work(batch: Sequence[tuple[str, Case]]) -> list[tuple[str, dict[str, Any]]]:
    return [(name, work(case)) for name, case in batch]


def _results(
    batches: Sequence[Batch], workers: int, scheduler: str | None
) -> Iterable[list[tuple[str, dict[str, Any]]]]:
    named = [[(str(path), case) for path, case in batch] for batch in batches]
    if not named:
        return iter(())
    if scheduler is not None:
        return _on_cluster(named, scheduler)
    if workers <= 1:
        return map(_work, named)
    return _on_processes(named, workers)


def _on_processes(
    batches: Sequence[Sequence[tuple[str, Case]]], workers: int
) -> Iterator[list[tuple[str, dict[str, Any]]]]:
    """Results as they come, from processes that are spawned as on every system."""
    context = multiprocessing.get_context("spawn")
    pool = concurrent.futures.ProcessPoolExecutor(workers, mp_context=context)
    try:
        waiting: set[concurrent.futures.Future[Any]] = set()
        for batch in batches:
            waiting.add(pool.submit(_work, batch))
            if len(waiting) >= QUEUE * workers:
                first = concurrent.futures.FIRST_COMPLETED
                done, waiting = concurrent.futures.wait(waiting, return_when=first)
                yield from (future.result() for future in done)
        for future in concurrent.futures.as_completed(waiting):
            yield future.result()
    finally:
        pool.shutdown(wait=True, cancel_futures=True)


def _on_cluster(
    batches: Sequence[Sequence[tuple[str, Case]]], scheduler: str
) -> Iterator[list[tuple[str, dict[str, Any]]]]:
    """Results as they come, from the workers of a Dask scheduler.

    Raises InputError where Dask is not installed, or the scheduler does not answer.
    """
    try:
        distributed: Any = importlib.import_module("distributed")
    except ImportError:
        remedy = "pip install distributed, or leave --scheduler out"
        raise InputError("Dask is not installed", remedy) from None
    try:
        client = distributed.Client(scheduler, timeout="10s")
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            f"the scheduler does not answer: {error}",
            "start it with `dask scheduler`, and give the address that it prints",
            field="--scheduler",
            value=scheduler,
        ) from error
    with contextlib.closing(client):
        futures = client.map(_work, batches, pure=False)
        for future in distributed.as_completed(futures):
            yield future.result()
