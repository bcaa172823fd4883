"""Exit codes of the command."""

from __future__ import annotations

from typing import Final

DONE: Final = 0
#: a claim is not met, or the fit is not to be trusted
FAILED: Final = 1
#: what the user gave cannot be used
BAD_INPUT: Final = 2
