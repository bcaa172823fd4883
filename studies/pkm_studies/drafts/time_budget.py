"""As many readings as a time has: `two days`, `90 min` in a draft of a study."""

import math
import re
from typing import Final

from oed import units
from oed.instrument import Instrument
from pkm_studies.base import InputError
from pkm_studies.drafts.template import grid_size

SHIFT: Final = 8.0 * units.HOUR  #: a day at a machine, s: one shift
#: seconds of a unit of time, by the beginning of its name
SECONDS: Final = {"m": units.MINUTE, "h": units.HOUR, "d": SHIFT, "w": 5.0 * SHIFT}
#: numbers that one writes as words
WORDS: Final = ("a", "one", "two", "three", "four", "five", "six")
TIME: Final = re.compile(
    r"(?:a\s+(?=half))?(?P<size>\d+(?:[.,]\d+)?|[a-z]+)"
    r"(?:\s+(?P<half>and\s+a\s+half))?"
    r"(?:(?<=half)\s+an?)?\s*(?P<unit>min(?:utes?)?|h(?:ours?)?|d(?:ays?)?|weeks?)?"
)
MAX_TIME_CHARACTERS: Final = 40  #: characters of a time
FEWEST = 6  #: readings that a time is turned into, at least
MOST = 300  #: and at most


def read_time(text: str) -> float:
    """Seconds of `two days`, `1.5 h`, `90 min`; a bare number is minutes.

    A day has eight hours at the machine, a week five days. Raises InputError.
    """
    match = TIME.fullmatch(text.strip().lower())
    size = None if match is None or len(text) > MAX_TIME_CHARACTERS else _size(match)
    if match is None or size is None:
        raise InputError(
            "this is no time",
            "write it as `two days`, `1.5 h` or `90 min`; a day has 8 hours",
            field="time",
            value=text[:MAX_TIME_CHARACTERS],
        )
    return size * SECONDS[(match["unit"] or "min")[0]]


def _size(match: re.Match[str]) -> float | None:
    """The number of a time; None for a word that is none."""
    half = 0.5 if match["half"] else 0.0
    if not match["size"][0].isdigit():
        if match["size"] == "half" and match["unit"]:
            return 0.5
        if match["size"] not in WORDS:
            return None
        return max(WORDS.index(match["size"]), 1) + half
    size = float(match["size"].replace(",", ".")) + half
    return size if math.isfinite(size) else None


def with_time(draft: str, seconds: float, tool: Instrument) -> str:
    """A draft with as many readings as a time has. Raises InputError below the fewest."""
    count = int((seconds - tool.cost.setup) / max(tool.cost.reading, 1.0))
    if count < FEWEST:
        least = (tool.cost.setup + FEWEST * tool.cost.reading) / units.MINUTE
        raise InputError(
            f"too short: mounting and {FEWEST} readings take {least:.0f} min",
            "allow more time",
            field="time",
            value=f"{seconds / units.MINUTE:g} min",
        )
    grid = draft.partition("[[design.candidates]]")[2].partition("\n\n")[0]
    count = min(count, MOST, grid_size(grid))
    return re.sub(r"^readings = \d+$", f"readings = {count}", draft, flags=re.M)
