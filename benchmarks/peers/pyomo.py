"""Pyomo.DoE: one experiment of 30 outputs whose 600 settings are its inputs; log det
through a Cholesky factor.
"""

from __future__ import annotations

import numpy as np

from peers import COLUMNS, FACTORS, SIZE, Choice, Task

REQUIRES = ("pyomo==6.10.1", "pyomo-pounce==0.13.0", "packaging", "pandas", "scipy")


def labeled() -> object:
    """The linear model with the suffixes that Pyomo.DoE reads; random settings to start
    from.
    """
    import pyomo.environ as pyo

    start = np.random.default_rng(1).uniform(-1.0, 1.0, (SIZE, FACTORS))
    m = pyo.ConcreteModel()
    m.x = pyo.Var(
        range(SIZE),
        range(FACTORS),
        bounds=(-1.0, 1.0),
        initialize=lambda _, i, k: start[i, k],
    )
    m.b = pyo.Var(range(COLUMNS), initialize=1.0)
    m.b.fix()
    m.x.fix()
    m.y = pyo.Var(range(SIZE), initialize=lambda m, i: 1.0 + sum(start[i]))
    m.law = pyo.Constraint(
        range(SIZE),
        rule=lambda m, i: (
            m.y[i] == m.b[0] + sum(m.b[k + 1] * m.x[i, k] for k in range(FACTORS))
        ),
    )
    m.experiment_outputs = pyo.Suffix(direction=pyo.Suffix.LOCAL)
    m.experiment_outputs.update((m.y[i], None) for i in range(SIZE))
    m.measurement_error = pyo.Suffix(direction=pyo.Suffix.LOCAL)
    m.measurement_error.update((m.y[i], 1.0) for i in range(SIZE))
    m.experiment_inputs = pyo.Suffix(direction=pyo.Suffix.LOCAL)
    m.experiment_inputs.update(
        (m.x[i, k], None) for i in range(SIZE) for k in range(FACTORS)
    )
    m.unknown_parameters = pyo.Suffix(direction=pyo.Suffix.LOCAL)
    m.unknown_parameters.update((m.b[k], 1.0) for k in range(COLUMNS))
    return m


def doe() -> Choice:
    """Its D objective, solved by POUNCE, the interior-point solver with a wheel for
    Pyomo.
    """
    import pyomo.environ as pyo
    import pyomo_pounce  # noqa: F401 - makes the solver known
    from pyomo.contrib.doe import DesignOfExperiments

    class Experiment:
        def get_labeled_model(self) -> object:
            return labeled()

    made = DesignOfExperiments(
        Experiment(), objective_option="determinant", solver=pyo.SolverFactory("pounce")
    )

    def choose() -> np.ndarray:
        made.run_doe()
        return (
            np.array(made.results["Experiment Design"])
            .reshape(SIZE, FACTORS)
            .clip(-1.0, 1.0)
        )

    return choose


TASKS = (
    Task(
        "B, D",
        "POUNCE",
        doe,
        "one local search; no list of rows; no E without a grey box",
    ),
)
