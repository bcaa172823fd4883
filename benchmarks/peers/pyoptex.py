"""PyOptEx: coordinate exchange over levels of each factor."""

from __future__ import annotations

from peers import FACTORS, SIZE, Choice, Task

REQUIRES = ("pyoptex==1.2.1",)


def coordinates(tries: int) -> Choice:
    """Its fixed-structure design with metric D."""
    from pyoptex.doe.fixed_structure import (
        Factor,
        create_fixed_structure_design,
        create_parameters,
        default_fn,
    )
    from pyoptex.doe.fixed_structure.metric import Dopt
    from pyoptex.utils.model import model2Y2X, partial_rsm_names

    names = [f"x{k}" for k in range(FACTORS)]
    factors = [Factor(name, type="continuous", min=-1.0, max=1.0) for name in names]
    model = partial_rsm_names(dict.fromkeys(names, "lin"))
    params = create_parameters(
        factors, default_fn(factors, Dopt(), model2Y2X(model, factors)), SIZE
    )
    create_fixed_structure_design(params, n_tries=1)  # compiles

    return lambda: create_fixed_structure_design(params, n_tries=tries)[0][
        names
    ].to_numpy(dtype=float)


NOTE = "levels -1, 0, 1 by default; no list of rows; no E"
TASKS = (
    Task("B, D", "coordinate exchange, 10 starts", lambda: coordinates(10), NOTE),
    Task("B, D", "coordinate exchange, 100 starts", lambda: coordinates(100), NOTE),
)
