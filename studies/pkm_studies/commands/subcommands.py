"""The subcommands of `oed`, each imported and parsed by typer when it is asked for.

Reading the signatures of all takes longer than the work of a light command.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator, Mapping
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from pkm_studies.base import InputError
from pkm_studies.plugins import project_plugins

#: options that name readings, of which none may be left out without a word
READINGS = {"--readings", "--after"}
#: module of this package and function in it, by subcommand, in the order of the help; the
#: entry points `pkm_oed.commands` follow
FUNCTIONS = {
    "run": ("runs", "run"),
    "check": ("check", "check"),
    "simulate": ("runs", "simulate"),
    "identify": ("runs", "identify"),
    "diagnose": ("runs", "diagnose"),
    "plan": ("runs", "plan"),
    "compare": ("results", "compare"),
    "report": ("results", "report"),
    "list": ("catalogue", "list_entries"),
    "schema": ("catalogue", "schema"),
    "new": ("new", "new"),
    "import": ("import_files", "import_files"),
    "compensate": ("results", "compensate"),
    "forecast": ("runs", "forecast"),
    "verify": ("verify", "verify"),
    "adjust": ("results", "adjust"),
    "history": ("results", "history"),
    "next": ("at_machine", "next_reading"),
}


class Subcommand(TyperCommand):
    """A command that refuses further readings where an option takes one file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As typer does, which keeps the last value alone. Raises InputError.

        Other options may be given again: the last one counts, as in a call that changes
        a default of a script.
        """
        _, _, given = self.make_parser(ctx).parse_args(args=list(args))
        for parameter in given:
            takes_one = not getattr(parameter, "multiple", True)
            holds_readings = bool(READINGS & {*parameter.opts})
            if takes_one and holds_readings and given.count(parameter) > 1:
                raise InputError(
                    f"it is given {given.count(parameter)} times, and takes one file",
                    "give it once",
                    field=parameter.opts[0],
                )
        return super().parse_args(ctx, args)


class Subcommands(Mapping[str, Any]):
    """typer's command by name. Raises KeyError for a name that is none."""

    def __getitem__(self, name: str) -> Any:
        single = typer.Typer(
            add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None
        )
        single.command(name=name, cls=Subcommand)(_function(name))
        return get_command(single)

    def __iter__(self) -> Iterator[str]:
        return iter([*FUNCTIONS, *project_plugins("commands")])

    def __len__(self) -> int:
        return len(FUNCTIONS) + len(project_plugins("commands"))


def _function(name: str) -> Callable[..., int]:
    """The function of a subcommand, of this package or another. Raises KeyError."""
    if name not in FUNCTIONS:
        return cast(Callable[..., int], project_plugins("commands")[name].load())
    module_name, function_name = FUNCTIONS[name]
    module = importlib.import_module(f"pkm_studies.commands.{module_name}")
    return cast(Callable[..., int], getattr(module, function_name))


class SubcommandGroup(TyperGroup):
    """A group whose commands are these subcommands."""

    def __init__(self, **attributes: Any) -> None:
        super().__init__(**attributes)
        self.commands = cast(Any, Subcommands())  # typer changes none
