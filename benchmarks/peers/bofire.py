"""BoFire: all coordinates of all runs at once by Ipopt from one random design."""

from __future__ import annotations

from peers import FACTORS, SIZE, Choice, Task

REQUIRES = ("bofire[optimization]==0.5.0", "cyipopt-wheels==1.7.0.dev0")


def strategy() -> Choice:
    """Its DoE strategy with criterion D and a linear model."""
    import bofire.strategies.api as strategies
    from bofire.data_models.domain.api import Domain
    from bofire.data_models.features.api import ContinuousInput, ContinuousOutput
    from bofire.data_models.strategies.doe import DoEStrategy, DOptimalityCriterion

    names = [f"x{k:02d}" for k in range(FACTORS)]
    domain = Domain(
        inputs=[ContinuousInput(key=name, bounds=(-1.0, 1.0)) for name in names],
        outputs=[ContinuousOutput(key="y")],
    )
    model = DoEStrategy(
        domain=domain, criterion=DOptimalityCriterion(formula="linear"), seed=1
    )
    made = strategies.map(model)
    return lambda: (
        made.ask(candidate_count=SIZE)[names].to_numpy(dtype=float).clip(-1.0, 1.0)
    )


TASKS = (Task("B, D", "Ipopt", strategy, "one local search; no list of rows"),)
