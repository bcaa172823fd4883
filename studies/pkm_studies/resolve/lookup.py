"""Looks up names that a study uses; an unknown one raises with the nearest known."""

from __future__ import annotations

import fnmatch
from collections.abc import Iterable, Mapping, Sequence

from oed.text import suggest
from pkm_studies.base import Location


def known_name(
    name: str, allowed: Iterable[str], location: Location, kind: str = "set-up"
) -> str:
    """The name, if it is one of `allowed`. Raises InputError."""
    names = list(allowed)
    if name not in names:
        listed_as = "set-ups" if kind == "set-up" else "allowed"
        raise location.error(f"no such {kind}", suggest(name, names, listed_as), name)
    return name


def matching_names(
    patterns: Sequence[str], allowed: Iterable[str], location: Location
) -> list[str]:
    """Known names that match any of the patterns.

    Raises InputError for a pattern that matches nothing.
    """
    names = list(allowed)
    for i, pattern in enumerate(patterns):
        if not fnmatch.filter(names, pattern):
            remedy = suggest(pattern.strip("*"), names)
            raise location.item(i).error("no parameter has this name", remedy, pattern)
    return [n for n in names if any(fnmatch.fnmatchcase(n, p) for p in patterns)]


def names_of_one_unit(
    patterns: Sequence[str], units: Mapping[str, str], location: Location
) -> tuple[list[str], str]:
    """Known names that match any of the patterns, and their unit.

    units  of the known names

    Raises InputError for no name, and for names of several units.
    """
    matched = matching_names(patterns, units, location)
    if not matched:
        raise location.error(
            "the list is empty", 'name parameters or patterns: ["dq*"]'
        )
    example = {units[name]: name for name in matched}  # one for each unit
    if len(example) > 1:
        kinds = " and ".join(f"{name} ({unit})" for unit, name in example.items())
        raise location.error(
            f"parameters of different kinds: {kinds}", "make one table for each kind"
        )
    return matched, next(iter(example))
