"""Benchmarks: speed beside named alternatives, and diagnosis of readings whose cause is
withheld.
"""

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded
