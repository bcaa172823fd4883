"""Keeps freed memory in the process, as the C library does by itself.

A Dask worker starts with MALLOC_TRIM_THRESHOLD_, so that memory goes back to the system
after each larger array and comes back page by page: cases then take a sixth more time.
The two values are those that the C library of Linux reaches by itself (mallopt(3)).
"""

from __future__ import annotations

import ctypes
import functools
import sys

#: parameters of mallopt, and bytes
TRIM_THRESHOLD, MMAP_THRESHOLD = -1, -3
KEPT, LARGEST = 64 * 2**20, 32 * 2**20


@functools.cache
def keep_freed_memory() -> bool:
    """Whether it could be set: with the GNU C library alone. Once in a process."""
    if not sys.platform.startswith("linux"):
        return False
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (OSError, AttributeError):
        return False
    done = [mallopt(MMAP_THRESHOLD, LARGEST), mallopt(TRIM_THRESHOLD, KEPT)]
    return all(done)
