"""The page at the machine: a local server of one study and its readings file.

PageOptions        what `oed serve` was asked for
serve              serves the page until the process is interrupted
open_page          the page of a study or a result, and the shelf of its results
MachinePage        all that a page can be asked for, apart from the web
Switch             the web side of it
BackgroundCommand  a command of `oed` that runs beside the page
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from oed.base.lazy import attributes

if TYPE_CHECKING:
    from pkm_page.job import BackgroundCommand
    from pkm_page.machine_page import MachinePage
    from pkm_page.server import Switch
    from pkm_page.serving import PageOptions, open_page, serve

__all__ = [
    "BackgroundCommand",
    "MachinePage",
    "PageOptions",
    "Switch",
    "open_page",
    "serve",
]

# imported when first used: `oed --help` imports the subcommand
__getattr__ = attributes(
    __name__,
    {
        "job": ("BackgroundCommand",),
        "machine_page": ("MachinePage",),
        "server": ("Switch",),
        "serving": ("PageOptions", "open_page", "serve"),
    },
)
