"""The subcommand `oed certificate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from oed.result.verdict import overall
from pkm_studies.base import console
from pkm_studies.base.user_code import consent
from pkm_studies.commands.options import AllowCode, MachineStudy, ResultFolder

DONE, FAILED = 0, 1


def certificate(
    folder: ResultFolder,
    head: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Laboratory, customer, dates, tolerances [DIR/certificate.toml].",
            show_default=False,
        ),
    ] = None,
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Write a calibration certificate: XML for machines (DCC), PDF for persons."""
    from pkm_studies.compensation.export import BadFitError
    from pkm_studies.sessions import certify

    given = consent(allow_code=allow_code)
    try:
        written, paths = certify.certify_folder(
            folder, head_file=head, study_file=study, consent=given
        )
    except BadFitError as error:
        console.print_error(str(error))
        return FAILED
    for sentence in certify.sentences(written):
        print(sentence)
    for path in paths:
        print(f"Written: {path}")
    stated = overall(v for v in written.verdicts if v is not None)
    return DONE if stated in (None, "pass") else FAILED
