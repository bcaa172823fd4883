"""The subcommands of `oed`, one a file. Each imports what is heavy only when it is called."""

from __future__ import annotations

import typer

from pkm_studies.commands.campaign import campaign
from pkm_studies.commands.check import check
from pkm_studies.commands.compare import compare
from pkm_studies.commands.compensate import compensate
from pkm_studies.commands.diagnose import diagnose
from pkm_studies.commands.history import history
from pkm_studies.commands.identify import identify
from pkm_studies.commands.import_files import import_files
from pkm_studies.commands.listing import list_entries
from pkm_studies.commands.new import new
from pkm_studies.commands.next import next_reading
from pkm_studies.commands.plan import plan
from pkm_studies.commands.report import report
from pkm_studies.commands.run import run
from pkm_studies.commands.schema import schema
from pkm_studies.commands.simulate import simulate
from pkm_studies.commands.verify import verify

app = typer.Typer(
    name="oed",
    help=(
        "Optimal experiment design and uncertainty for calibrating parallel kinematic"
        " machines."
    ),
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)

app.command()(run)
app.command()(check)
app.command()(simulate)
app.command()(identify)
app.command()(diagnose)
app.command()(plan)
app.command()(compare)
app.command()(report)
app.command(name="list")(list_entries)
app.command()(schema)
app.command()(new)
app.command(name="import")(import_files)
app.command()(compensate)
app.command()(verify)
app.command()(history)
app.command()(campaign)
app.command(name="next")(next_reading)
