"""Runs the cases of a campaign that have no row yet."""

import json
from collections.abc import Callable, Iterator
from pathlib import Path

from oed import safe_files
from pkm_campaign import jobs
from pkm_campaign.case import ERROR, SEED, Case, CaseFunctionError, evaluate
from pkm_campaign.jobs import Job
from pkm_campaign.tables import Campaign
from pkm_studies import files
from pkm_studies.base import InputError

#: cases that a process takes at once: neighbours share a combination, and its plan
CASES_AT_ONCE = 10
STAMP = "campaign.toml"


def run_cases(
    campaign: Campaign,
    out: Path,
    *,
    workers: int,
    scheduler: str = "",
    progress: Callable[[float], None] = lambda share: None,
) -> list[str]:
    """Do the cases that `out` lacks; sentences on files that were no whole cases.

    workers    processes on this computer; 1: this one alone
    scheduler  address of a Dask scheduler, in place of them

    Raises InputError where the folder belongs to another campaign, or where a case
    function fails.
    """
    every = list(_jobs(campaign, _case_folder(campaign, out)))
    broken = [_set_aside(job.path) for job in every if _is_broken(job)]
    missing = [job for job in every if not job.path.is_file()]
    done = len(every) - len(missing)
    # No batch may be so large that some processes have nothing to do.
    batch = min(CASES_AT_ONCE, max(1, len(missing) // (4 * max(workers, 1))))
    try:
        for _ in jobs.run_jobs(
            evaluate, missing, workers=workers, scheduler=scheduler, batch=batch
        ):
            done += 1
            progress(done / len(every))
    except CaseFunctionError as error:
        raise campaign.location.key("case").error(
            str(error), "mend the function; the other cases stay", campaign.case
        ) from error
    return broken


def _is_broken(job: Job[Case]) -> bool:
    """Whether a case's file is there, but has no whole row of this case."""
    if not job.path.is_file():
        return False
    case = job.case
    # a list or table of a setting comes back as JSON has it
    setting = json.loads(json.dumps(dict(case.setting)))
    setting_of_case = {**setting, SEED: case.seed}
    return not jobs.is_done(job.path, setting_of_case, [ERROR])


def _set_aside(path: Path) -> str:
    """Rename a broken file; a sentence about it."""
    name = safe_files.set_aside(path, "broken").name
    return f"{path} is no whole case: it is now {name}, and was computed again"


def case_paths(campaign: Campaign, out: Path) -> list[Path]:
    """Files of all cases, in order, whether they are there or not."""
    folder = out / "cases"
    return [
        _case_file(folder, number, seed)
        for number in range(len(campaign.settings()))
        for seed in campaign.all_seeds()
    ]


def _case_file(folder: Path, number: int, seed: int) -> Path:
    """The file of a case: number of its combination from 0, and its seed."""
    return folder / f"{number + 1:04d}-{seed:06d}.json"


def _case_folder(campaign: Campaign, out: Path) -> Path:
    """The folder of the cases, which holds those of this campaign alone."""
    stamp = out / STAMP
    content = campaign.text
    if campaign.varied is not None:
        digest = files.digest(campaign.varied.text.encode())
        content = f"# study: {digest}\n{content}"
    if stamp.is_file() and stamp.read_bytes() != content.encode():
        raise InputError(
            "it holds cases of another campaign, or of this one before a change",
            "choose another folder with --out, or remove this one",
            file=str(out),
        )
    files.write_whole(stamp, content)
    return out / "cases"


def _jobs(campaign: Campaign, folder: Path) -> Iterator[Job[Case]]:
    for number, setting in enumerate(campaign.settings()):
        figures = campaign.figures(setting)
        for seed in campaign.all_seeds():
            yield Job(_case_file(folder, number, seed), Case(figures, setting, seed))
