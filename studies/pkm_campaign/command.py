"""The subcommand `oed campaign`."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands import AllowCode
from pkm_studies.user_code import Consent


def campaign(
    file: Annotated[
        Path, typer.Argument(metavar="CAMPAIGN.toml", help="The campaign.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder of the cases [out/NAME].")
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes [one for each core].")
    ] = None,
    scheduler: Annotated[
        str,
        typer.Option(metavar="ADDRESS", help="Dask scheduler, in place of processes."),
    ] = "",
    seeds: Annotated[
        int | None,
        typer.Option(min=1, help="First seeds of each combination only [all]."),
    ] = None,
    *,
    quiet: Annotated[bool, typer.Option("--quiet", help="Print results only.")] = False,
    allow_code: AllowCode = False,
) -> int:
    """Run settings x seeds over cases; again: go on where it was."""
    import os

    from pkm_campaign import load_campaign, report, run_cases
    from pkm_studies import commands

    loaded = load_campaign(file, Consent.from_call(allow_code=allow_code))
    loaded = loaded if seeds is None else loaded.first(seeds)
    folder = Path("out") / loaded.name if out is None else out
    with commands.progress(quiet=quiet) as progress:
        progress.stage("cases")
        broken = run_cases(
            loaded,
            folder,
            workers=workers or os.cpu_count() or 1,
            scheduler=scheduler,
            progress=progress.share,
        )
    for sentence in broken:
        print(f"Warning: {sentence}.")
    table = report.read_table(loaded, folder)
    summary = report.summarise(loaded, table)
    paths = report.write_table(table, summary, folder)
    page = report.write_report(loaded, summary, folder)
    for sentence in report.sentences(loaded, summary):
        print(sentence)
    seconds = report.processor_time(loaded, folder)
    print(f"Processor time of the cases: {seconds:.0f} s.")
    print(f"Report: {', '.join(str(p) for p in page)}")
    print(f"Table: {', '.join(str(p) for p in paths)}")
    return 0
