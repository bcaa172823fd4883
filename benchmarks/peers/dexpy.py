"""dexpy: coordinate exchange over 12 levels of each factor from one random start."""

from __future__ import annotations

from peers import FACTORS, SIZE, Choice, Task

REQUIRES = ("dexpy==0.12", "pandas<2", "numpy<2", "setuptools<80")


def coordinates() -> Choice:
    """Its `build_optimal` for a linear model."""
    from dexpy.model import ModelOrder
    from dexpy.optimal import build_optimal

    return lambda: build_optimal(
        FACTORS, order=ModelOrder.linear, run_count=SIZE
    ).to_numpy(dtype=float)


TASKS = (
    Task(
        "B, D",
        "coordinate exchange, 1 start",
        coordinates,
        "no list of rows; no E; unmaintained since 2017",
    ),
)
