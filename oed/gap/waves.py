"""Steady waves, as an unknown process: in time (interference, a pump), or along the path at one feed (a resonance).

Their frequency is anybody's guess, from one period in the session or a run to one in two readings. Of all frequencies
(Lomb's periodogram, in the metric that lets the parameters absorb first) the strongest few are kept, each with the
prior weight of one among all that were looked at.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import signal, stats

from oed.batch import Array
from oed.gap.law import Law, Metric
from oed.gap.library import Atom, Library
from oed.gap.problem import Problem
from oed.gap.unknown import UNIT

NAME = "a steady wave"
#: frequencies a resolution cell, most of them, how many peaks of each kind are kept
OVER, MOST, KEPT = 1.5, 6000, 4
CHUNK = 512
#: shortest period that is looked for in time, s, where times are not regular; shortest along the path, m
SHORTEST, FINEST = 12.0, 0.02
#: periods in the session up to which waves are slow: these few are looked at apart from the many fast ones
SLOW = 100.0
#: places between two frequencies at which a peak is looked at closely
FINE = np.linspace(-0.8, 0.8, 9)
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
    """The processes with the strongest steady waves of each kind beside them: slow, fast, along the path.

    Each kind has the prior weight of a process.
    """
    metric, joints = Metric(problem, law), _joints(problem)
    tool = _tool(problem, joints)
    found: list[tuple[_Peak, float]] = []
    for bands in (*([band] for band in _in_time(problem, joints, tool)), _along_path(problem, tool)):
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


def _in_time(problem: Problem, joints: Array, tool: Array) -> list[_Band]:
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
    step = float(np.median(np.diff(ticks)))
    places = (ticks - ticks[0]) / step
    regular = not known or bool(np.abs(places - np.round(places)).max() <= 0.05)
    most = 0.5 / step if regular else 1.0 / SHORTEST  # irregular times tell fast waves from slow, however far apart
    channels = [np.where(problem.group == g, UNIT / problem.sigma, 0.0)[:, None] for g in np.unique(problem.group)]
    carriers = [*channels, *(joints[:, i, None] for i in range(joints.shape[1])), tool]
    span = float(np.ptp(clock)) + step
    middle = min(SLOW / span, most)
    bands = [_Band("s", clock, carriers, _frequencies(span, 1.0 / span, middle))]
    return [*bands, _Band("s", clock, carriers, _frequencies(span, middle, most))] if most > middle else bands


def _along_path(problem: Problem, tool: Array) -> list[_Band]:
    """Waves along the path of the tool, at one feed."""
    feed = problem.rows["feed"].to_numpy(dtype=float) if "feed" in problem.rows else np.full(len(problem), np.nan)
    arc, bands = _arc(problem), []
    for value in np.unique(np.round(feed[np.isfinite(feed)], 9)):
        here = np.isclose(feed, value)
        steps = np.diff(arc[here])
        steps = steps[steps > 1e-6]
        if here.sum() < LEAST or not steps.size:
            continue
        span = float(arc[here].max())
        frequencies = _frequencies(span, 1.0 / span, max(1.0 / FINEST, 1.0 / span))
        bands.append(_Band("m", arc, [np.where(here[:, None], tool, 0.0)], frequencies))
    return bands


def _frequencies(span: float, low: float, high: float) -> Array:
    """From one to another, so close that no wave over a span falls between them."""
    return np.linspace(low, high, int(min(max(OVER * span * (high - low), 1.0), MOST)))


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
    for carrier, tail in zip(band.carriers, _tails(problem, metric, band), strict=True):
        peaks, _ = signal.find_peaks(np.concatenate([[-1.0], -tail, [-1.0]]), distance=int(2 * OVER))
        for k in peaks[np.argsort(tail[peaks - 1])][:KEPT] - 1:
            near = _close(band, carrier, int(k))
            tails = _tails(problem, metric, near)[0]
            best = float(near.frequencies[np.argmin(tails)])
            columns = _waves(carrier, _both(band.clock, np.array([best])))[:, :, 0]
            found.append(_Peak(float(tails.min()), columns, band.unit, 1.0 / best))
    return found


def _close(band: _Band, carrier: Array, k: int) -> _Band:
    """The band about its k-th frequency, on one carrier."""
    step = float(np.diff(band.frequencies[:2])[0]) if len(band.frequencies) > 1 else 0.0
    return dataclasses.replace(band, carriers=[carrier], frequencies=band.frequencies[k] + step * FINE)


def _both(clock: Array, frequencies: Array) -> Array:
    """Cosine and sine (N, 2, k) of each frequency."""
    angle = 2.0 * np.pi * clock[:, None] * frequencies[None, :]
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _waves(carrier: Array, both: Array) -> Array:
    """Columns (N, 2 c, k): cosines and sines (N, 2, k) on each column of a carrier (N, c)."""
    return np.asarray((carrier[:, :, None, None] * both[:, None]).reshape(len(carrier), -1, both.shape[2]))


def _tails(problem: Problem, metric: Metric, band: _Band) -> Array:
    """Log tail probability (carriers, k) of the energy that each wave explains of the residual, its phases free."""
    residual = metric.parts(problem.residual[:, None])
    tails = np.empty((len(band.carriers), len(band.frequencies)))
    for start in range(0, tails.shape[1], CHUNK):
        here = slice(start, start + CHUNK)
        both = _both(band.clock, band.frequencies[here])
        for row, carrier in zip(tails, band.carriers, strict=True):
            row[here] = _tail(metric, _waves(carrier, both), residual)
    return tails


def _tail(metric: Metric, waves: Array, residual: tuple[Array, Array]) -> Array:
    """Log tail probability (k,) of what waves (N, c, k) explain."""
    size, width = waves.shape[1:]
    inner, told = np.zeros((width, size, size)), np.zeros((width, size))
    for sign, v, r in zip((1.0, -1.0), metric.parts(waves.reshape(len(waves), -1)), residual, strict=True):
        part = np.ascontiguousarray(v.reshape(-1, size, width).transpose(2, 1, 0))
        inner += sign * (part @ part.transpose(0, 2, 1))
        told += sign * (part @ r[:, 0])
    inner += (1e-6 * np.trace(inner, axis1=1, axis2=2) + 1e-300)[:, None, None] * np.eye(size)
    energy = np.einsum("fi,fi->f", told, np.linalg.solve(inner, told[:, :, None])[:, :, 0])
    return np.asarray(stats.chi2.logsf(energy, size))
