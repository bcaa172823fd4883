"""Names of studies and campaigns: they become names of files, and so are no paths."""

from __future__ import annotations

import re
from typing import Annotated, Final

import msgspec

from pkm_studies.base.errors import Location

#: nothing follows the end: Python lets a line feed, which is no letter a, follow `$`
NAME_PATTERN: Final = "^[A-Za-z0-9][A-Za-z0-9_-]*$(?![^a])"
Name = Annotated[str, msgspec.Meta(pattern=NAME_PATTERN)]


def check_name(name: str, location: Location) -> None:
    """Raises InputError for a text at a place that is no name."""
    if not re.search(NAME_PATTERN, name):
        problem, remedy = "this is no name for a study", "use letters, digits, _ and -"
        raise location.error(problem, remedy, name)
