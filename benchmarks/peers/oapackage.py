"""OApackage: coordinate exchange of two-level arrays, weighted for its D1 efficiency
(main effects and intercept).
"""

from __future__ import annotations

import numpy as np

from peers import FACTORS, SIZE, Choice, Task

REQUIRES = ("oapackage==2.7.21",)


def coordinates(starts: int) -> Choice:
    """Its `Doptimize` for 30 runs of 20 two-level factors."""
    import oapackage
    from oapackage.Doptim import Doptimize

    kind = oapackage.arraydata_t(2, SIZE, 0, FACTORS)

    def choose() -> np.ndarray:
        oapackage.set_srand(1)
        _, effects, designs, _ = Doptimize(
            kind,
            nrestarts=starts,
            optimfunc=[0, 0, 1],
            verbose=0,
            dverbose=0,
            selectpareto=False,
        )
        return 2.0 * np.array(designs[int(np.argmax(effects[:, 2]))]) - 1.0

    return choose


NOTE = "levels -1 and 1 only; no list of rows; no E"
TASKS = (
    Task("B, D", "coordinate exchange, 10 starts", lambda: coordinates(10), NOTE),
    Task("B, D", "coordinate exchange, 1000 starts", lambda: coordinates(1000), NOTE),
)
