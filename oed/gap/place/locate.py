"""Blocks in which a gap lies: a scan over legs, runs, times, phases and directions.

A gap shows in several places at once; the least p-value tells which confines it best.
Where effects that are known to act have their legs is a question of its own, and its
regions are a family of their own.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed.arrays import Array
from oed.gap.data.diagnosis import Block
from oed.gap.data.metric import Embedding
from oed.gap.data.problem import GapProblem
from oed.gap.data.tail import log_tail
from oed.gap.place import session, warm_up
from oed.gap.place.family import all_regions
from oed.gap.place.report import BLOCKS, LIKELY, Candidate, select_blocks
from oed.gap.place.scan import Scan, corrected_p_values
from oed.gap.place.selected import SELECTED
from oed.noise.law import NoiseLaw

#: share of what heat explains below which a stretch of it is not reported
PART = 0.03
#: ends of a window that are tried at once, when it is moved to where it explains most
ENDS = 256


def locate(
    problem: GapProblem,
    law: NoiseLaw,
    rng: np.random.Generator,
    *,
    columns: Array | None = None,
    labels: Sequence[str] | None = None,
    known: bool = False,
    draws: int = 500,
) -> tuple[Block, ...]:
    """Blocks in which the gap lies, those that confine it best first.

    columns    (N, k) of the selected effects, in units of the stated noise. Those of a
               leg are one more region of it; few are looked for in each run. The
               correction ignores that they were selected: `effect_legs` tests whether a
               leg carries them
    labels     (k,) blocks that the columns belong to (`leg 1`, "")
    known      whether these effects are all that acts: their columns alone then locate
               the legs, if all of them belong to a leg or a set-up
    draws      of the bootstrap

    The result has all legs, and `all legs` where the same change in each confines the
    gap better than any one leg. Of runs, times, phases and directions it has the best,
    and up to three more that do not overlap with it and have p < 0.05. `strength` is
    the block's share of the residual's energy beyond the noise; it means something
    where p is small. Where not all of what acts is known, and a tool that is warmed for
    a while explains more than a shift for a while, the times are those of the warming.
    The law is taken as known, its level too. Raises ValueError for columns that do not
    fit.
    """
    embedding = Embedding(problem, law)
    scores = embedding.scores(problem.residual)
    drawn = rng.standard_normal((len(problem), draws))
    regions = all_regions(problem, columns, labels, known)
    scan = Scan(embedding, regions, np.column_stack([scores, drawn]))
    energy = scan.energy[:, 0]
    log_p = log_tail(energy, scan.rank)
    by_effects = np.array([region.known for region in scan.regions])
    corrected = corrected_p_values(log_p, scan, scan.energy[:, 1:], by_effects)
    beyond = np.maximum(energy - scan.rank, 0.0)
    excess = float(scores @ scores) - len(problem)
    total = max(excess, float(beyond.max()), 1e-300)
    candidates = [
        Candidate(
            region=region,
            log_p=float(log_p[k]),
            p=float(corrected[k]),
            strength=float(beyond[k] / total),
            energy=float(energy[k]),
        )
        for k, region in enumerate(scan.regions)
    ]
    blocks = [
        _sharpen(problem, embedding, scores, candidate)
        for candidate in select_blocks(candidates)
    ]
    if not known:
        blocks = _with_warming(problem, embedding, scores, blocks)
    return tuple(candidate.block for candidate in blocks)


def _sharpen(
    problem: GapProblem,
    embedding: Embedding,
    scores: Array,
    candidate: Candidate,
) -> Candidate:
    """A likely window of the session with its ends moved to where it explains most.

    Each end moves by up to a cell.
    """
    region = candidate.region
    if region.kind != "time" or region.form == SELECTED:
        return candidate
    if candidate.p >= LIKELY:
        return candidate

    def energies(ends: Sequence[tuple[float, float]]) -> Array:
        windows = (
            dataclasses.replace(
                region, basis=session.window_basis(problem, *pair, region.form)
            )
            for pair in ends
        )
        return Scan(embedding, windows, scores[:, None]).energy[:, 0]

    times, starts = session.clock(problem), session.cell_starts(problem)
    times = np.unique(times[np.isfinite(times)])
    bounds = np.append(starts, np.inf)
    a, b = min(region.cells), max(region.cells) + 1
    last = float(times[times < bounds[b]].max())
    near = times[(times > bounds[a - 1]) & (times < bounds[a + 1])]
    begins = near[near <= last]
    (first, last), energy = _best_ends([(float(t), last) for t in begins], energies)
    if b < len(starts):
        earliest = max(first, bounds[b - 1])
        stops = times[(times >= earliest) & (times < bounds[b + 1])]
        ends = [(first, float(t)) for t in stops]
        (first, last), energy = _best_ends(ends, energies)
    place = session.time_span(session.clock(problem), first, last)
    region = dataclasses.replace(region, place=place)
    return dataclasses.replace(candidate, region=region, energy=energy)


def _best_ends(
    ends: Sequence[tuple[float, float]],
    energies: Callable[[Sequence[tuple[float, float]]], Array],
) -> tuple[tuple[float, float], float]:
    """The ends of a window, in order, that explain most, and what they explain.

    Of many, every so-manieth is tried, then those next to the best.
    """
    step = -(-len(ends) // ENDS)
    coarse = ends[::step]
    energy = energies(coarse)
    best = int(np.argmax(energy))
    if step > 1:
        middle = best * step
        coarse = ends[max(middle - step + 1, 0) : middle + step]
        energy = energies(coarse)
        best = int(np.argmax(energy))
    return coarse[best], float(energy[best])


def _with_warming(
    problem: GapProblem,
    embedding: Embedding,
    scores: Array,
    candidates: Sequence[Candidate],
) -> list[Candidate]:
    """With the warm-up intervals of the tool in place of windows of the session.

    Unchanged where these explain no more than the best window.
    """
    times = [c for c in candidates if c.region.kind == "time"]
    if not times or times[0].p >= LIKELY:
        return list(candidates)
    first = times[0]
    clock = session.clock(problem)
    intervals = warm_up.intervals(problem, embedding.scores, first.energy)
    if not intervals:
        return list(candidates)
    total = sum(interval.energy for interval in intervals)
    warmed = []
    for interval in intervals[:BLOCKS]:
        if interval.energy > PART * total:
            place = session.time_span(clock, interval.first, interval.last)
            region = dataclasses.replace(first.region, place=place)
            strength = first.strength * interval.energy / total
            warmed.append(dataclasses.replace(first, region=region, strength=strength))
    others = [c for c in candidates if c.region.kind != "time"]
    return sorted([*warmed, *others], key=lambda c: c.log_p)
