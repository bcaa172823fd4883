"""industrialstats: row exchange over a candidate set that replaces its own grid."""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("industrialstats==0.3.0",)


def exchange(rows: np.ndarray) -> Choose:
    """Its `OptimalDesign` with its 5 random starts (it takes no seed)."""
    import pandas as pd
    from industrialstats.designs.base import Factor
    from industrialstats.designs.optimal import OptimalDesign

    names = [f"x{k}" for k in range(rows.shape[1])]
    factors = [Factor(name, [-5.0, 5.0], "continuous") for name in names]
    design = OptimalDesign(factors, SIZE, "D", model_terms=names)
    design.candidate_set = pd.DataFrame(rows, columns=names)
    numbers = {row.tobytes(): number for number, row in enumerate(rows)}

    def choose() -> list[int]:
        chosen = design.generate_design()[names].to_numpy(dtype=float)
        return [numbers[np.ascontiguousarray(row).tobytes()] for row in chosen]

    return choose


TASKS = (Task("A, D", "row exchange, 5 starts", exchange, "may repeat rows; no E"),)
