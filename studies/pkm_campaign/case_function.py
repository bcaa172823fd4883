"""Functions of a user that compute the figures of a case, or summarise cases.

A function is named by `path/to/file.py:function`, relative to the campaign, as machines
are. Every process looks its function up by itself.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from oed.text import shorten
from pkm_campaign.case import COLUMNS, EXPECTED
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.user_code import Origin

#: characters of a failure that are shown
LONGEST_REASON = 150


class CaseFunctionError(RuntimeError):
    """A case function failed, or returns what no table can hold."""


@dataclasses.dataclass(frozen=True, slots=True)
class UserFunction:
    """A function by name.

    reference  its name, see the module
    origin     of the campaign
    file       of the campaign, for errors
    """

    reference: str
    origin: Origin
    file: str

    def load(self, field: str) -> Callable[..., Any]:
        """The function itself. Raises InputError about a field of the campaign."""
        return _loaded(self, field)


@functools.cache
def _loaded(function: UserFunction, field: str) -> Callable[..., Any]:
    location = Location(function.file, field)
    return catalogue.function(function.reference, function.origin, location)


@dataclasses.dataclass(frozen=True, slots=True)
class CaseFunction:
    """Computes the figures of a case by a user's function."""

    function: UserFunction

    def __call__(self, setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
        """The figures, as JSON holds them.

        Raises CaseFunctionError, and the failures of a case as they are.
        """
        try:
            figures = self.function.load("case")(setting, seed)
        except EXPECTED:
            raise
        except Exception as error:
            raise CaseFunctionError(
                f"with {_words(setting, seed)} it ends with {type(error).__name__}:"
                f" {shorten(str(error), LONGEST_REASON)}"
            ) from error
        return _checked(figures, setting, seed)


def _words(setting: Mapping[str, Any], seed: int) -> str:
    values = [f"{name} = {value!r}" for name, value in setting.items()]
    return ", ".join([*values, f"seed = {seed}"])


def _checked(figures: Any, setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Figures whose names are their own and whose values JSON can hold."""
    where = f"with {_words(setting, seed)} it returns"
    if not isinstance(figures, Mapping):
        raise CaseFunctionError(f"{where} {type(figures).__name__}, no dictionary")
    taken = [name for name in figures if name in setting or name in COLUMNS]
    if taken:
        raise CaseFunctionError(f"{where} {taken[0]!r}, which names another column")
    try:
        return dict(json.loads(json.dumps(dict(figures), default=_plain)))
    except (TypeError, ValueError) as error:
        raise CaseFunctionError(f"{where} what no table can hold: {error}") from None


def _plain(value: Any) -> Any:
    """A NumPy number as Python's."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"a value of type {type(value).__name__}")
