"""Files and folders in which nobody but this user, and the system's administrator, can write."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from typing import Final

#: number of the administrator
ROOT: Final = 0


def make_private(folder: Path) -> bool:
    """Make a folder, and those above it, for this user alone; whether it is private.

    Who can write into a folder above can put another one in its place. False on Windows,
    which has other permissions. Raises OSError where it cannot be made.
    """
    for path in (*reversed(folder.parents), folder):
        if not path.exists():
            path.mkdir(mode=0o700, exist_ok=True)
    return is_private(folder)


def is_private(path: Path) -> bool:
    """Whether only this user can change a file or a folder, or what stands in its place.

    Links are followed where they are the administrator's alone. Raises OSError.
    """
    user = _user()
    if user is None or path.stat().st_uid != user:
        return False
    whole = path.absolute()
    real = whole.resolve()
    return all(map(_is_safe, {whole, *whole.parents, real, *real.parents}))


def _is_safe(path: Path) -> bool:
    """Whether others can neither write there nor point the path elsewhere."""
    status = path.lstat()
    if stat.S_ISLNK(status.st_mode):
        return status.st_uid == ROOT
    if status.st_uid not in (ROOT, _user()):
        return False
    if stat.S_ISDIR(status.st_mode) and status.st_mode & stat.S_ISVTX:
        return True  # as /tmp, where nobody can rename what is another's
    if status.st_mode & stat.S_IWOTH:
        return False
    return not status.st_mode & stat.S_IWGRP or _is_own_group(status.st_gid)


def _user() -> int | None:
    """Number of this user; None on Windows, which has no such thing."""
    number = getattr(os, "getuid", None)
    return None if number is None else int(number())


def _is_own_group(number: int) -> bool:
    """Whether a group has this user alone, as some systems give each of them one."""
    import grp  # Windows has neither
    import pwd

    try:
        group, user = grp.getgrgid(number), pwd.getpwuid(_user() or ROOT).pw_name
    except KeyError:
        return False
    return group.gr_name == user and set(group.gr_mem) <= {user}
