"""The subcommand `oed schema`: JSON schemas."""

from __future__ import annotations

import enum
from typing import Annotated

import typer

from pkm_studies.base import console
from pkm_studies.stages.outcome import DONE


class Schema(enum.StrEnum):
    """Files that `oed schema` describes."""

    study = enum.auto()
    result = enum.auto()
    readings = enum.auto()


def schema(
    of: Annotated[
        Schema, typer.Argument(metavar="study|result|readings", show_default=False)
    ],
) -> int:
    """Print a JSON schema, for editors and scripts."""
    from pkm_studies.study import schemas

    console.print_json(schemas.SCHEMAS[of.value]())
    return DONE
