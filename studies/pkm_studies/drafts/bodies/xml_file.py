"""Reads the XML of bodies: the root of a file, and the numbers of its attributes."""

from __future__ import annotations

import io
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np

from oed.base import Array
from pkm_studies import files
from pkm_studies.base import Location

LIMIT = 20_000_000
#: largest number of a file, m or degrees: what is beyond is no place of a machine
LARGEST = 1e6
#: elements within one another, and bodies behind one another: humanoid robots have 30
DEEPEST = 200
#: elements of a file: the largest public models of robots have some 5000
MOST_ELEMENTS = 20_000


def read_root(path: Path, tag: str, what: str) -> ET.Element:
    """The root of an XML file. Raises InputError where it is another one.

    tag   that the root has
    what  the format, for the error
    """
    location = Location(str(path))
    content = files.read_bytes(path, limit=LIMIT, what=f"{what} file")
    try:
        root = _bounded(content, location, what)
    except (ET.ParseError, ValueError) as error:
        raise location.error(
            f"this is no XML file: {error}", f"give a whole {what} file"
        ) from None
    if root.tag != tag:
        raise location.error(
            f"its root is <{root.tag}>", f"give {what}, whose root is <{tag}>"
        )
    return root


def _bounded(content: bytes, location: Location, what: str) -> ET.Element:
    """The root of XML. Raises InputError where it is deeper or larger than a machine."""
    root, depth, count = None, 0, 0
    for event, element in ET.iterparse(io.BytesIO(content), ("start", "end")):
        root = element if root is None else root
        starts = event == "start"
        depth, count = depth + (1 if starts else -1), count + starts
        if depth > DEEPEST or count > MOST_ELEMENTS:
            raise location.error(
                f"it has more than {MOST_ELEMENTS} elements, or more than {DEEPEST}"
                " within one another, as no model of a machine has",
                f"give the {what} of the mechanism alone",
            )
    return root  # type: ignore[return-value]  # a file without one is a ParseError


def read_numbers(text: str, count: int, location: Location, remedy: str) -> Array:
    """Numbers (count,) separated by blanks. Raises InputError."""
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        raise location.error(f"{text!r} are no numbers", remedy) from None
    if len(numbers) != count:
        raise location.error(f"{text!r} are not {count} numbers", remedy)
    if not (np.abs(numbers) <= LARGEST).all():
        raise location.error(f"{text!r} is no place and no angle of a machine", remedy)
    return numbers


def read_direction(text: str, count: int, location: Location, remedy: str) -> Array:
    """The same, scaled to the length 1. Raises InputError where it has no length."""
    numbers = read_numbers(text, count, location, remedy)
    length = float(np.linalg.norm(numbers))
    if length == 0.0:
        raise location.error(f"{text!r} has no direction", remedy)
    return np.asarray(numbers / length)
