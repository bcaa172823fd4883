"""What holds between the parts of a result: lengths, names and units that belong together.

Types are checked where result.json is read. A file that was edited, cut or merged may
still contradict itself; then the report of it would be wrong, or fail half-way.
"""

from __future__ import annotations

from collections.abc import Iterator

from oed.result.relations import accuracy, causes, plans, readings
from oed.result.relations.base import Breach, value_breaches
from oed.result.study import StudyResult

__all__ = ["Breach", "breaches"]


def breaches(result: StudyResult) -> Iterator[Breach]:
    """Contradictions within a result, by field; none where all fits."""
    yield from value_breaches("", result)
    yield from plans.breaches(result)
    yield from readings.breaches(result)
    yield from accuracy.breaches(result)
    yield from causes.breaches(result)
