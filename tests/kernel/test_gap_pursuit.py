"""Several processes at once, and the noise law that goes with them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from kernel.gap_lines import readings
from kernel.gap_unknown import SMOOTH
from oed.gap.cause import pursuit
from oed.gap.cause import searches as searching
from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.cause.search import Search
from oed.gap.data import noise
from oed.gap.forms import library, waves
from oed.noise.law import stated_law


def test_noise_told_beside_a_wave_does_not_hold_it() -> None:
    """Carried noise takes the place of a wave where it is told first; beside the wave
    that was found it is gone.
    """
    problem = readings(5)
    angle = 2.0 * np.pi * problem.rows["time"].to_numpy(dtype=float) / 391.0
    wave = np.where(problem.rows["channel"] == "dy", 1.6 * np.sin(angle + 1.0), 0.0)
    acting = problem.with_residual(problem.residual + wave)
    alone, prior = noise.fit_law(acting, np.zeros((len(acting), 0)))
    none = waves.add(library.build(acting, ()), acting, alone)
    processes, (with_wave,) = pursuit.pursue(none, acting, [alone])
    assert alone.ar1_sd > 0.5
    assert with_wave[0].ar1_sd < 0.5 * alone.ar1_sd
    first = Search(acting, library.build(acting, ()), processes, alone, prior).run()
    anew = Search(acting, library.build(acting, ()), processes, *with_wave).run()

    def odds(hypotheses: list[Hypothesis]) -> float:
        by = {h.key: h.log_evidence for h in hypotheses}
        return by[frozenset(), True] - by[frozenset(), False]

    assert odds(anew) > odds(first) + 5.0


def test_what_shifts_whole_runs_is_looked_for_where_runs_repeat() -> None:
    """Under a law of runs that do not repeat, a drift from run to run is noise, and
    begun there it stays noise.
    """
    problem = readings(8)
    runs = np.concatenate(
        [np.full(len(members), k) for k, members in enumerate(problem.members)]
    )
    shift = 4.0 * np.cos(
        np.pi * runs[np.argsort(np.concatenate(problem.members))] / len(problem.members)
    )
    acting = problem.with_residual(problem.residual + shift)
    loose, _ = noise.fit_law(acting, np.zeros((len(acting), 0)))
    processes = library.build(acting, SMOOTH)
    _, (noisy, calm) = pursuit.pursue(processes, acting, [loose, stated_law(problem)])
    assert loose.run_sd > 1.0
    assert calm[0].run_sd < 0.5 * min(noisy[0].run_sd, loose.run_sd)


@pytest.mark.parametrize("suits", [True, False])
def test_no_gap_is_given_a_law_of_its_own(suits: bool) -> None:
    """Begun at the law of a gap, and taken where it suits no gap better than the laws
    that there are: white noise is no large carried error.
    """
    problem = readings(7)
    none, law = (
        library.build(problem, ()),
        dataclasses.replace(stated_law(problem), ar1_sd=3.0, ar1_length=8.0),
    )
    best = noise.fit_law(problem, np.zeros((len(problem), 0)))
    searches = [Search(problem, none, none, *(best if suits else (law, 0.0)))]
    searching._add_without_gap(searches, law)

    def worth(search: Search) -> float:
        return next(
            h.log_evidence for h in search.run() if not h.effects and not h.unknown
        )

    assert len(searches) == (1 if suits else 2)
    assert suits or worth(searches[1]) > worth(searches[0]) + 20.0
    assert searches[-1].law.ar1_sd < 0.3


def test_two_waves_are_told_together() -> None:
    problem = readings(6)
    time = problem.rows["time"].to_numpy(dtype=float)
    dy, dz = ((problem.rows["channel"] == name).to_numpy() for name in ("dy", "dz"))
    both = np.where(dy, 2.0 * np.sin(2.0 * np.pi * time / 173.0), 0.0)
    both += np.where(dz, 2.0 * np.sin(2.0 * np.pi * time / 611.0), 0.0)
    acting = problem.with_residual(problem.residual + both)
    none = library.build(acting, ())
    processes, _ = pursuit.pursue(
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
        pursuit.pursue(in_noise, problem, [stated_law(problem)])[0],
        stated_law(problem),
        0.0,
    )
    assert compare([quiet])[0].key == (frozenset(), False)
