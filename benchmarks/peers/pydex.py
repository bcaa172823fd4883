"""pydex: relaxed weights by cvxpy, then Adams' apportionment.

With more support points than runs it takes the largest weights.
"""

from __future__ import annotations

import numpy as np

from peers import SIZE, Choose, Task

REQUIRES = ("pydex==0.0.9", "cvxpy==1.9.3", "clarabel==0.11.1")


def weights(rows: np.ndarray, criterion: str) -> Choose:
    """The information matrices are its `atomic_fims`: nothing is differentiated."""
    from pydex.core.designer import Designer

    designer = Designer()
    designer.simulate = lambda ti_controls, model_parameters: np.array(
        [ti_controls @ model_parameters]
    )
    designer.ti_controls_candidates = rows
    designer.model_parameters = np.ones(rows.shape[1])
    designer.initialize(verbose=0)
    designer.sensitivities = rows[:, None, None, :]
    designer.atomic_fims = rows[:, :, None] * rows[:, None, :]
    designer._model_parameters_changed = designer._candidates_changed = False

    def choose() -> np.ndarray:
        goal = getattr(designer, f"{criterion}_opt_criterion")
        designer.design_experiment(goal, package="cvxpy", optimizer="CLARABEL")
        designer.apportion(SIZE, trimmed=False, compute_actual_efficiency=False)
        counts = np.zeros(len(rows), dtype=int)
        for candidate, runs in zip(
            designer.optimal_candidates, designer.apportionments, strict=True
        ):
            counts[candidate[0]] = int(np.nansum(runs))
        return np.repeat(np.arange(len(rows)), counts)

    return choose


NOTE = "may repeat rows; rounds the weights, no exchange"
TASKS = (
    Task("A, D", "Clarabel, apportioned", lambda rows: weights(rows, "d"), NOTE),
    Task("A, E", "Clarabel, apportioned", lambda rows: weights(rows, "e"), NOTE),
)
