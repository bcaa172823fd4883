"""When functions are compiled: at once, after enough work, or never.

The environment variable `OED_COMPILE` is 0 for never and 1 for at once. Otherwise a
function is compiled once its work has taken about as long as its compilation will: so
that a job takes twice the least time at most. What counts is the number of points, not a
time, nor whether a compiled file is there already. So the same run computes the same
numbers again, to the last digit.
"""

from __future__ import annotations

import os

VARIABLE = "OED_COMPILE"
NEVER, AT_ONCE = "0", "1"
#: points after which the array code has taken longer than the compilation of a long
#: function, 0.4 ms an instruction
ENOUGH_POINTS = 400_000
#: points times instructions more, for the 0.1 s that the compiler takes at least
LEAST_WORK = 100_000_000


class _Jobs:
    """The number of the job that this process does."""

    number = 0


def begin_job() -> None:
    """Start to count anew, for results that do not depend on the jobs before."""
    _Jobs.number += 1


class CompileSettingError(ValueError):
    """The environment variable has a value that says nothing."""


class CompileSwitch:
    """Whether a function runs compiled. Raises CompileSettingError."""

    def __init__(self) -> None:
        self._setting = _setting()
        self._job, self._points = _Jobs.number, 0

    def is_on(self, points: int, length: int) -> bool:
        """Whether it does now.

        points  that it is to be computed at now
        length  number of its instructions
        """
        if self._setting in (NEVER, AT_ONCE):
            return self._setting == AT_ONCE
        if self._job != _Jobs.number:
            self._job, self._points = _Jobs.number, 0
        self._points += points
        return (self._points - ENOUGH_POINTS) * length > LEAST_WORK


def _setting() -> str:
    """NEVER, AT_ONCE, or an empty text: after enough work. Raises CompileSettingError."""
    setting = os.environ.get(VARIABLE, "").strip()
    if setting not in ("", NEVER, AT_ONCE):
        raise CompileSettingError(
            f"the environment variable {VARIABLE} is {setting!r}: write {NEVER} for never,"
            f" {AT_ONCE} for at once, or unset it"
        )
    return setting
