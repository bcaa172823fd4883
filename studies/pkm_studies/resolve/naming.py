"""Names that a study uses: looked up, with the nearest known one as a remedy."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Sequence

from pkm_studies.errors import Place, suggest


def known(name: str, names: Iterable[str], place: Place, what: str = "set-up") -> str:
    """The name, if it is one of `names`; raises InputError."""
    there = list(names)
    if name not in there:
        raise place.error(
            f"no such {what}",
            suggest(name, there, "set-ups" if what == "set-up" else "allowed"),
            name,
        )
    return name


def match(patterns: Sequence[str], names: Iterable[str], place: Place) -> list[str]:
    """Parameters that match any of the patterns; raises InputError for a pattern that
    matches nothing.
    """
    names = list(names)
    for i, pattern in enumerate(patterns):
        if not fnmatch.filter(names, pattern):
            raise place.item(i).error(
                "no parameter has this name",
                suggest(pattern.strip("*"), names),
                pattern,
            )
    return [n for n in names if any(fnmatch.fnmatchcase(n, p) for p in patterns)]
