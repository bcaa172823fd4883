"""Steady waves, as an unknown process: in time (interference, a pump), or along the path at one feed (a resonance).

Their frequency is anybody's guess, from one period in the session or a run to one in two readings. Of all frequencies
(Lomb's periodogram, in the metric that lets the parameters absorb first) the strongest few are kept, each with the
prior weight of one among all that were looked at.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import signal, special

from oed.batch import Array
from oed.gap.law import Law, Metric
from oed.gap.library import Atom, Library
from oed.gap.problem import Problem
from oed.gap.unknown import UNIT

NAME = "a steady wave"
#: frequencies a resolution cell, most of them, how many peaks of each kind are kept
OVER, MOST, KEPT = 1.5, 6000, 4
CHUNK = 512
#: readings that a feed must have, and ticks that a clock must have, for its waves to mean something
LEAST = 16


@dataclasses.dataclass(frozen=True, slots=True)
class _Band:
    """Waves over a clock (N,), s or m of path, that may sit on any of some carriers (N, c)."""

    unit: str
    clock: Array
    carriers: list[Array]
    frequencies: Array


@dataclasses.dataclass(frozen=True, slots=True)
class _Peak:
    """A wave: log tail probability of what it explains, its columns (N, 2 c), its period in the clock's unit."""

    log_tail: float
    columns: Array
    unit: str
    period: float


def added(processes: Library, problem: Problem, law: Law) -> Library:
    """The processes with the strongest steady waves beside them."""
    metric = Metric(problem, law)
    found: list[tuple[_Peak, float]] = []
    for bands in (_in_time(problem), _along_path(problem)):
        count = sum(len(b.frequencies) * len(b.carriers) for b in bands)
        peaks = [p for b in bands for p in _peaks(problem, metric, b)]
        peaks.sort(key=lambda p: p.log_tail)
        found += [(p, -math.log(count)) for p in peaks[:KEPT]]
    columns, atoms, names = [processes.columns], list(processes.atoms), list(processes.names)
    for k, (peak, weight) in enumerate(found):
        at = np.arange(len(names), len(names) + peak.columns.shape[1], dtype=np.intp)
        columns.append(peak.columns)
        atoms.append(Atom(NAME, {f"period_{peak.unit}": peak.period}, at, weight))
        names += [f"wave {k} {j}" for j in range(len(at))]
    more = len(names) - len(processes.names)
    return dataclasses.replace(
        processes,
        columns=np.hstack(columns),
        atoms=tuple(atoms),
        names=tuple(names),
        labels=(*processes.labels, *[""] * more),
        scales=np.concatenate([processes.scales, np.full(more, UNIT)]),
    )


def _in_time(problem: Problem) -> list[_Band]:
    """Waves in time on a channel, on a joint, on the tool."""
    rows = problem.rows
    known = "time" in rows and rows["time"].notna().all()
    time = (
        rows["time"].to_numpy(dtype=float) if known else np.cumsum(rows["reading"].diff().ne(0).to_numpy(dtype=float))
    )
    clock = time - time.min()
    ticks = np.unique(clock)
    if len(ticks) < LEAST:
        return []
    step, joints = float(np.median(np.diff(ticks))), _joints(problem)
    channels = [np.where(problem.group == g, UNIT / problem.sigma, 0.0)[:, None] for g in np.unique(problem.group)]
    carriers = [*channels, *(joints[:, i, None] for i in range(joints.shape[1])), _tool(problem, joints)]
    return [_Band("s", clock, carriers, _frequencies(float(np.ptp(clock)) + step, step))]


def _along_path(problem: Problem) -> list[_Band]:
    """Waves along the path of the tool, at one feed."""
    feed = problem.rows["feed"].to_numpy(dtype=float) if "feed" in problem.rows else np.full(len(problem), np.nan)
    carrier, arc, bands = _tool(problem, _joints(problem)), _arc(problem), []
    for value in np.unique(np.round(feed[np.isfinite(feed)], 9)):
        here = np.isclose(feed, value)
        steps = np.diff(arc[here])
        steps = steps[steps > 1e-6]
        if here.sum() < LEAST or not steps.size:
            continue
        frequencies = _frequencies(float(arc[here].max()), float(np.median(steps)))
        bands.append(_Band("m", arc, [np.where(here[:, None], carrier, 0.0)], frequencies))
    return bands


def _frequencies(span: float, step: float) -> Array:
    """From one period in a span to one in two steps."""
    count = int(min(max(OVER * span / (2.0 * step), 1.0), MOST))
    return np.linspace(1.0 / span, max(0.5 / step, 1.0 / span), count)


def _joints(problem: Problem) -> Array:
    """Readings (N, nq), in units of the noise, per micrometre of each joint at the pose read."""
    return problem.of(
        UNIT * np.concatenate([r.joints[0].reshape(-1, r.joints[0].shape[-1]) for r in problem.responses])
    )


def _tool(problem: Problem, joints: Array) -> Array:
    """The same (N, 3) per micrometre of the tool along each axis."""
    parts = []
    for state, series, response in zip(problem.states, problem.series, problem.responses, strict=True):
        by_tool = state.pushing[series.index[:, 0]]  # (n, nq, 3)
        parts.append(np.repeat(by_tool, response.nuisances.shape[1], axis=0))
    return np.asarray(np.einsum("nj,njk->nk", joints, np.concatenate(parts)))


def _arc(problem: Problem) -> Array:
    """Way (N,) of the tool since the start of its run, m."""
    tool = np.concatenate([
        np.repeat(state.tool[series.index[:, 0]], response.nuisances.shape[1], axis=0)
        for state, series, response in zip(problem.states, problem.series, problem.responses, strict=True)
    ])  # fmt: skip
    order, arc = problem.rows["order"].to_numpy(dtype=float), np.zeros(len(problem))
    for members in problem.blocks:
        at = members[np.argsort(order[members], kind="stable")]
        arc[at[1:]] = np.cumsum(np.linalg.norm(np.diff(tool[at], axis=0), axis=1))
    return arc


def _peaks(problem: Problem, metric: Metric, band: _Band) -> list[_Peak]:
    """The strongest waves of a band on each of its carriers."""
    found = []
    for carrier in band.carriers:
        tail = _tails(problem, metric, carrier, band)
        peaks, _ = signal.find_peaks(np.concatenate([[-1.0], -tail, [-1.0]]), distance=int(2 * OVER))
        for k in peaks[np.argsort(tail[peaks - 1])][:KEPT] - 1:
            columns = _waves(carrier, band.clock, band.frequencies[k : k + 1])[:, :, 0]
            found.append(_Peak(float(tail[k]), columns, band.unit, 1.0 / float(band.frequencies[k])))
    return found


def _waves(carrier: Array, clock: Array, frequencies: Array) -> Array:
    """Columns (N, 2 c, k): cosine and sine of each frequency on each column of a carrier (N, c)."""
    angle = 2.0 * np.pi * clock[:, None] * frequencies[None, :]
    both = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return np.asarray((carrier[:, :, None, None] * both[:, None]).reshape(len(clock), -1, len(frequencies)))


def _tails(problem: Problem, metric: Metric, carrier: Array, band: _Band) -> Array:
    """Log tail probability (k,) of the energy that each wave explains of the residual, its phases free."""
    told_by = metric.parts(problem.residual[:, None])
    tails = np.empty(len(band.frequencies))
    for start in range(0, len(tails), CHUNK):
        waves = _waves(carrier, band.clock, band.frequencies[start : start + CHUNK])
        size, width = waves.shape[1], waves.shape[2]
        parts = [v.reshape(-1, size, width) for v in metric.parts(waves.reshape(len(problem), -1))]
        inner = sum(s * np.einsum("nif,njf->fij", v, v) for s, v in zip((1.0, -1.0), parts, strict=True))
        told = sum(s * np.einsum("nif,n->fi", v, r[:, 0]) for s, v, r in zip((1.0, -1.0), parts, told_by, strict=True))
        trace = np.trace(inner, axis1=1, axis2=2)[:, None, None] + 1e-300
        inner = inner + 1e-6 * trace * np.eye(size)
        energy = np.einsum("fi,fi->f", told, np.linalg.solve(inner, told[:, :, None])[:, :, 0])
        tails[start : start + CHUNK] = special.chdtrc(size, energy).clip(1e-300)
    return np.asarray(np.log(tails))
