"""The page at the machine: a local server of one study and its readings file.

PageOptions        what `oed serve` was asked for
serve              serves the page until the process is interrupted
open_page          the page of a study or a result, and the shelf of its results
MachinePage        all that a page can be asked for, apart from the web
Switch             the web side of it
BackgroundCommand  a command of `oed` that runs beside the page
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from pkm_page.machine_page import BackgroundCommand, MachinePage
    from pkm_page.server import PageOptions, Switch, open_page, serve
else:
    # imported when first used: `oed --help` imports the subcommand
    __getattr__ = door(__name__)
