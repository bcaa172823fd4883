"""Work in a process of its own, whose memory and compiled functions nothing else shares."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from typing import Any, TypeVar

Result = TypeVar("Result")


def alone(work: Callable[..., Result], *arguments: Any) -> Result:
    """What a module's function returns in a fresh process."""
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(1, context) as pool:
        return pool.submit(work, *arguments).result()


def peak() -> int:
    """Peak memory of this process, bytes. Raises ImportError where there is no POSIX."""
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
