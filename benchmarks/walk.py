"""The rooms that a study file passes through `oed run`, in the order of their first use.

    python -m benchmarks.walk studies/a3_ball_bar.study.toml

A room is a folder or module at the top of a package. Imports do not count, calls do.
"""

from __future__ import annotations

import functools
import re
import sys
import tempfile
from types import FrameType
from typing import Any

from pkm_studies import commands

ROOM = re.compile(r"/(oed|pkm_[a-z]+)/([^/]+?)(?:\.py|/)")


@functools.cache
def room_of(path: str) -> str | None:
    found = ROOM.search(path)
    return None if found is None else f"{found[1]}.{found[2]}"


def rooms_of(arguments: list[str]) -> list[str]:
    """Rooms whose functions a command calls."""
    rooms: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: Any) -> None:
        is_import = frame.f_code.co_name == "<module>"
        room = None if is_import else room_of(frame.f_code.co_filename)
        if event == "call" and room is not None:
            rooms.setdefault(room)

    sys.setprofile(note)
    try:
        commands.main(arguments)
    finally:
        sys.setprofile(None)
    return list(rooms)


def main() -> None:
    """Print the rooms, a line each, and their number."""
    with tempfile.TemporaryDirectory() as folder:
        rooms = rooms_of(["run", *sys.argv[1:], "--quiet", "--out", folder])
    print("\n".join(rooms))
    print(f"{len(rooms)} rooms")


if __name__ == "__main__":
    main()
