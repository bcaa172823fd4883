"""The subcommand `oed certificate`."""

from pathlib import Path
from typing import Annotated

import typer

from pkm_studies.commands import AllowCode, MachineStudy, ResultFolder
from pkm_studies.console import DONE, FAILED
from pkm_studies.user_code import Consent


def certificate(
    folder: ResultFolder,
    head: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Laboratory, customer, dates, tolerances [DIR/certificate.toml].",
        ),
    ] = None,
    study: MachineStudy = None,
    allow_code: AllowCode = False,
) -> int:
    """Write a calibration certificate: XML for machines (DCC), PDF for persons."""
    from oed.verdict import all_pass
    from pkm_certificate import certify_folder, sentences

    permission = Consent.from_call(allow_code=allow_code)
    written, paths = certify_folder(
        folder, head_file=head, study_file=study, consent=permission
    )
    for line in [*sentences(written), *(f"Written: {path}" for path in paths)]:
        print(line)
    stated = (v for v in written.verdicts if v is not None)
    return DONE if all_pass(stated) else FAILED
