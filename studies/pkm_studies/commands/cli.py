"""The command `oed`: runs a subcommand and turns its errors into exit codes.

Exit 0: done; 1: a claim fails; 2: bad input, in one paragraph on stderr; 130:
interrupted. A subcommand is imported when it is called, and everything heavy inside it,
so that `oed --help` answers at once.
"""

import gc
import importlib
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, cast

import typer
from typer.core import TyperCommand, TyperGroup
from typer.main import get_command

from oed.text import shorten
from pkm_studies import console, files
from pkm_studies.base import InputError
from pkm_studies.console import BAD_INPUT, DONE, FAILED
from pkm_studies.plugins import project_plugins

# The subcommands of `oed`, each imported and parsed by typer when it is asked for.
#
# Reading the signatures of all takes longer than the work of a light command.

#: options that name readings, of which none may be left out without a word
READINGS = {"--readings", "--after"}
#: module of this package and function in it, by subcommand, in the order of the help; the
#: entry points `pkm_oed.commands` follow
FUNCTIONS = {
    "run": ("runs", "run"),
    "check": ("new", "check"),
    "simulate": ("runs", "simulate"),
    "identify": ("runs", "identify"),
    "diagnose": ("runs", "diagnose"),
    "plan": ("runs", "plan"),
    "compare": ("results", "compare"),
    "report": ("results", "report"),
    "list": ("catalogue", "list_entries"),
    "schema": ("catalogue", "schema"),
    "new": ("new", "new"),
    "import": ("new", "import_files"),
    "compensate": ("results", "compensate"),
    "forecast": ("runs", "forecast"),
    "verify": ("results", "verify"),
    "adjust": ("results", "adjust"),
    "history": ("results", "history"),
    "next": ("runs", "next_reading"),
}

HELP_INDENT = 6  #: columns before and between the names and the texts of the help
#: commands by when one needs them; those of other packages come where they are named
GROUPS = {
    "Before the machine test": ("new", "import", "run", "plan", "simulate", "forecast"),
    "At the machine": ("serve", "next", "check"),
    "With readings": ("identify", "diagnose", "compensate", "adjust", "verify"),
    "Afterwards": ("certificate", "compare", "history", "report"),
    "Many": ("campaign",),
    "Look up": ("list", "schema"),
}


class Subcommand(TyperCommand):
    """A command that refuses further readings where an option takes one file."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """As typer does, which keeps the last value alone. Raises InputError.

        Other options may be given again: the last one counts, as in a call that changes
        a default of a script.
        """
        _, _, ordered = self.make_parser(ctx).parse_args(args=list(args))
        for parameter in ordered:
            takes_one = not getattr(parameter, "multiple", True)
            holds_readings = bool(READINGS & {*parameter.opts})
            if takes_one and holds_readings and ordered.count(parameter) > 1:
                raise InputError(
                    f"it is given {ordered.count(parameter)} times, and takes one file",
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

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """The commands with what each does, grouped by when one needs them."""
        names = self.list_commands(ctx)
        grouped = {name for group in GROUPS.values() for name in group}
        groups = {**GROUPS, "Of other packages": tuple(sorted({*names} - grouped))}
        room = formatter.width - HELP_INDENT - max(map(len, names))
        for title, members in groups.items():
            rows = [
                (name, self.commands[name].get_short_help_str(room))
                for name in members
                if name in names
            ]
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


app = typer.Typer(
    name="oed",
    cls=SubcommandGroup,
    help=(
        "Optimal experiment design and uncertainty for calibrating parallel kinematic"
        " machines."
    ),
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


@app.callback()
def oed() -> None:
    """What is common to all subcommands: nothing."""


INTERRUPTED_EXIT_CODE = 130
#: new objects after which Python looks for garbage: after its usual 700 that takes a tenth
#: of a run, most of it during imports
GARBAGE_THRESHOLD = 50_000
#: errors of the kernel about the input, by module; looked for only in loaded modules
KERNEL_ERRORS = {
    "oed.units": "UnitError",
    "oed.mechanism.batch": "CompileSettingError",
    "oed.mechanism.kinematics": "AssemblyError",
    "oed.dataset.readings_file": "ReadingsError",
    "oed.estimation.identification": "IdentificationError",
    "oed.posterior.log_density": "OutOfBoundsError",
}

#: what is refused because the fit is bad, as a claim that fails
BAD_FIT = {"pkm_studies.results": "BadFitError"}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command, by default on the arguments of the process; the exit code."""
    # before NumPy is loaded: the matrices are small, and two BLAS threads on busy cores
    # slow them down tenfold
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    if arguments is not None:
        return _guarded(arguments)
    # the process is the command's own
    gc.set_threshold(GARBAGE_THRESHOLD, 20, 50)
    try:
        return _guarded(None)
    finally:
        # what is alive now goes with the process: to look through all of it for garbage
        # once more takes a tenth of a light command; files are closed, and whole
        gc.freeze()


def _guarded(arguments: Sequence[str] | None) -> int:
    """The exit code, also of what the command refuses."""
    try:
        console.set_up()
        return _call(arguments)
    except InputError as error:
        return _bad_input(_add_notes(str(error), error))
    except KeyboardInterrupt:  # outside typer's care, as during an import
        return _interrupted()
    except SystemExit:  # typer's way to say that nobody reads the output any more
        console.discard_output()
        return DONE
    except OSError as error:
        if console.reader_has_gone(error):
            console.discard_output()
            return DONE
        return _bad_input(_file_text(error))
    except _loaded_errors(BAD_FIT) as error:
        console.print_error(str(error))
        return FAILED
    except _loaded_errors(KERNEL_ERRORS) as error:
        return _bad_input(_add_notes(shorten(str(error), 500), error))
    except Exception as error:
        if not hasattr(error, "format_message"):
            raise
        usage = error.format_message()
        if usage.startswith("Usage:"):
            console.print_on_error_stream(usage)
            return BAD_INPUT
        line = " ".join(usage.split()).rstrip(".").replace("Value error, ", "")
        problem, asks, guess = line.partition(". Did you mean ")
        if asks:
            line = f"{problem} (did you mean {guess.rstrip('?')}?)"
        return _bad_input(f"{line}; see `oed --help`.")


def _call(arguments: Sequence[str] | None) -> int:
    ordered = None if arguments is None else list(arguments)
    code = app(args=ordered, prog_name="oed", standalone_mode=False)
    if code == INTERRUPTED_EXIT_CODE:  # typer's code for Ctrl-C
        _interrupted()
    sys.stdout.flush()
    return code if isinstance(code, int) else DONE


def _interrupted() -> int:
    console.print_error("interrupted: files written so far are whole")
    return INTERRUPTED_EXIT_CODE


def _add_notes(paragraph: str, error: BaseException) -> str:
    """The paragraph, then what was noted while the error passed."""
    return " ".join([paragraph, *getattr(error, "__notes__", ())])


def _file_text(error: OSError) -> str:
    """What a file refuses; an error without a name may be the output's own."""
    about_output = console.is_about_output(error)
    if about_output:
        console.discard_output()
    if about_output or error.filename == console.OUTPUT:
        problem = (error.strerror or type(error).__name__).lower()
        return f"{console.OUTPUT}: {problem}; send it to a terminal, a pipe or another file."
    return str(files.refusal(error))


def _loaded_errors(names: Mapping[str, str]) -> tuple[type[BaseException], ...]:
    loaded = [(sys.modules.get(module), name) for module, name in names.items()]
    return tuple(getattr(module, name) for module, name in loaded if module is not None)


def _bad_input(paragraph: str) -> int:
    console.print_error(paragraph)
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
