"""One case of a campaign: a setting and a seed in, a row of figures out."""

import dataclasses
import functools
import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from scipy import special

from oed.base import Array
from oed.estimation import IdentificationError
from oed.mechanism import AssemblyError
from oed.text import shorten
from pkm_studies import catalogue
from pkm_studies.base import Location
from pkm_studies.user_code import Origin

#: columns of every case: what a case function returns has other names
SEED, ERROR, PROCESSOR_TIME = "seed", "error", "cpu_s"
COLUMNS = (SEED, ERROR, PROCESSOR_TIME)

#: failures of a case that are no fault of what computes it
EXPECTED = (IdentificationError, AssemblyError, np.linalg.LinAlgError)

#: computes the figures of a setting and a seed, as numbers, texts and truth values
Figures = Callable[[Mapping[str, Any], int], Mapping[str, Any]]


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """What a process needs for a row.

    figures    computes them
    setting    the varied values by field
    seed       of the case
    """

    figures: Figures
    setting: Mapping[str, Any]
    seed: int


def evaluate(case: Case) -> dict[str, Any]:
    """The row of a case: setting, seed, figures or `error`, processor time in s."""
    row: dict[str, Any] = {**case.setting, SEED: case.seed, ERROR: ""}
    begin = time.process_time()
    try:
        row |= case.figures(case.setting, case.seed)
    except EXPECTED as error:
        row[ERROR] = str(error)
    return {**row, PROCESSOR_TIME: round(time.process_time() - begin, 4)}


# The 95 % interval of a mean over independent cases.

#: standard deviations to either side of a 95 % interval
HALF_WIDTH = float(special.ndtri(0.975))


def mean_interval(values: Sequence[float] | Array) -> tuple[float, float]:
    """Ends of the interval, by the normal law; NaN from one value."""
    count = len(values)
    if count < 2:
        return math.nan, math.nan
    mean = np.mean(values)
    half = HALF_WIDTH * np.std(values, ddof=1) / np.sqrt(count)
    return float(mean - half), float(mean + half)


# Functions of a user that compute the figures of a case, or summarise cases.
#
# A function is named by `path/to/file.py:function`, relative to the campaign, as machines
# are. Every process looks its function up by itself.

#: characters of a failure that are shown
MAX_REASON_LENGTH = 150


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
        """The figures, as JSON holds them. Raises CaseFunctionError, and failures of a case."""
        try:
            figures = self.function.load("case")(setting, seed)
        except EXPECTED:
            raise
        except Exception as error:
            raise CaseFunctionError(
                f"with {_words(setting, seed)} it ends with {type(error).__name__}:"
                f" {shorten(str(error), MAX_REASON_LENGTH)}"
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
