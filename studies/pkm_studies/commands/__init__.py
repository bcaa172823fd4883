"""The command `oed`: one subcommand a module, and the options that they share.

main          runs the command with its arguments, and returns the exit code
AllowCode     the option that consents to a study's own Python files
MachineStudy  the option that names the study of a result's machine
ResultFolder  the argument that names a result's folder
Wanted        the option that states wanted errors
progress      shows progress on the terminal; elsewhere, one line a stage
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_studies.commands.cli import main
    from pkm_studies.commands.display import progress
    from pkm_studies.commands.options import (
        AllowCode,
        MachineStudy,
        ResultFolder,
        Wanted,
    )
else:
    __getattr__ = door(__name__)
