"""xpyrment: coordinate exchange over given levels of each factor from ten random
starts.
"""

from __future__ import annotations

from peers import FACTORS, SIZE, Choice, Task

REQUIRES = ("xpyrment==1.6.1.2",)


def coordinates() -> Choice:
    """Its `DOptimalDesign` with the two ends of each factor as levels."""
    from xpyrment.design.doe.d_optimal import DOptimalDesign

    design = DOptimalDesign(
        {f"x{k}": [-1.0, 1.0] for k in range(FACTORS)}, SIZE, seed=1
    )
    return lambda: design.generate().to_numpy(dtype=float)


TASKS = (
    Task(
        "B, D",
        "coordinate exchange, 10 starts",
        coordinates,
        "levels must be given; no list of rows; no E",
    ),
)
