"""Several processes at once."""

from __future__ import annotations

import numpy as np

from kernel.gap_lines import readings
from oed.gap.cause import pursuit
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Search
from oed.gap.forms import library, waves
from oed.noise.law import stated_law


def test_two_waves_are_told_together() -> None:
    problem = readings(6)
    time = problem.rows["time"].to_numpy(dtype=float)
    dy, dz = ((problem.rows["channel"] == name).to_numpy() for name in ("dy", "dz"))
    both = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0), 0.0)
    both += np.where(dz, 2.0 * np.sin(2.0 * np.pi * time / 611.0), 0.0)
    acting = problem.with_residual(problem.residual + both)
    none = library.build(acting, ())
    processes = pursuit.pursue(
        waves.add(none, acting, stated_law(acting)), acting, [stated_law(acting)]
    )
    best = compare([Search(acting, none, processes, stated_law(acting), 0.0)])[0]
    assert best.process is not None
    assert processes.atoms[best.process].effect == pursuit.NAME
    assert processes.atoms[best.process].constants["processes"] >= 2.0
    in_noise = waves.add(none, problem, stated_law(problem))
    quiet = Search(
        problem,
        none,
        pursuit.pursue(in_noise, problem, [stated_law(problem)]),
        stated_law(problem),
        0.0,
    )
    assert compare([quiet])[0].key == (frozenset(), False)
