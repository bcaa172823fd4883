"""Options that several subcommands have."""

from __future__ import annotations

from typing import Annotated

import typer

AllowCode = Annotated[
    bool,
    typer.Option(
        "--allow-code",
        help="Run Python files that the study names, now and while they are unchanged.",
        show_default=False,
    ),
]
