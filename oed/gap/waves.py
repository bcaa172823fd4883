"""Steady waves in time, as an unknown process: interference, a pump, a resonance that runs on through all readings.

Their frequency is anybody's guess, from one period in the session to one in two readings. Of all frequencies (Lomb's
periodogram, in the metric that lets the parameters absorb first) the strongest few are kept, each with the prior weight
of one among all that were looked at.
"""

from __future__ import annotations

import dataclasses
import math

import numpy as np
from scipy import signal

from oed.batch import Array
from oed.gap.law import Law, Metric
from oed.gap.library import Atom, Library
from oed.gap.problem import Problem
from oed.gap.unknown import UNIT

NAME = "a steady wave"
#: frequencies a resolution cell, most of them, how many peaks are kept
OVER, MOST, KEPT = 1.5, 6000, 4
CHUNK = 512


def added(processes: Library, problem: Problem, law: Law) -> Library:
    """The processes with the strongest steady waves beside them."""
    found, count = _strongest(problem, law)
    if not found:
        return processes
    carriers, clock = _carriers(problem), _clock(problem)
    start = processes.columns.shape[1]
    columns, atoms, names = [processes.columns], list(processes.atoms), list(processes.names)
    for k, (number, frequency) in enumerate(found):
        angle = 2.0 * np.pi * frequency * clock
        columns.append(carriers[number][:, None] * np.column_stack([np.cos(angle), np.sin(angle)]))
        at = np.array([start + 2 * k, start + 2 * k + 1], dtype=np.intp)
        atoms.append(Atom(NAME, {"period": 1.0 / frequency}, at, -math.log(count)))
        names += [f"wave {k} cos", f"wave {k} sin"]
    return dataclasses.replace(
        processes,
        columns=np.hstack(columns),
        atoms=tuple(atoms),
        names=tuple(names),
        labels=(*processes.labels, *[""] * (2 * len(found))),
        scales=np.concatenate([processes.scales, np.full(2 * len(found), UNIT)]),
    )


def _carriers(problem: Problem) -> list[Array]:
    """What a wave of a micrometre may sit on, in units of the noise (N,): a channel of readings, or a joint."""
    joints = [
        problem.of(UNIT * np.concatenate([r.joints[0][:, :, i].ravel() for r in problem.responses]))
        for i in problem.states[0].limbs
    ]
    channels = [np.where(problem.group == g, UNIT / problem.sigma, 0.0) for g in np.unique(problem.group)]
    return [*channels, *joints]


def _clock(problem: Problem) -> Array:
    """Time (N,) of each reading, s; its number where times are not known."""
    rows = problem.rows
    if "time" in rows and rows["time"].notna().all():
        time = rows["time"].to_numpy(dtype=float)
        return np.asarray(time - time.min())
    return np.cumsum(rows["reading"].diff().ne(0).to_numpy(dtype=float))


def _strongest(problem: Problem, law: Law) -> tuple[list[tuple[int, float]], int]:
    """Carrier and frequency of the strongest waves, and how many were looked at."""
    clock = _clock(problem)
    ticks = np.unique(clock)
    if len(ticks) < 16:
        return [], 0
    step = float(np.median(np.diff(ticks)))
    span = float(np.ptp(clock)) + step
    count = int(min(OVER * span / (2.0 * step), MOST))
    frequencies = np.linspace(1.0 / span, 0.5 / step, count)
    metric, found = Metric(problem, law), []
    carriers = _carriers(problem)
    for number, carrier in enumerate(carriers):
        power = _power(problem, metric, carrier, clock, frequencies)
        peaks, _ = signal.find_peaks(np.concatenate([[0.0], power, [0.0]]), distance=int(2 * OVER))
        best = peaks[np.argsort(-power[peaks - 1])][:KEPT] - 1
        found += [(float(power[k]), number, float(frequencies[k])) for k in best]
    found.sort(reverse=True)
    return [(number, f) for _, number, f in found[:KEPT]], count * len(carriers)


def _power(problem: Problem, metric: Metric, carrier: Array, clock: Array, frequencies: Array) -> Array:
    """Energy (k,) of the residual that each wave on a carrier (N,) explains, its two phases free."""
    r0, r1 = metric.parts(problem.residual[:, None])
    power = np.empty(len(frequencies))
    for start in range(0, len(frequencies), CHUNK):
        angle = 2.0 * np.pi * clock[:, None] * frequencies[None, start : start + CHUNK]
        both = metric.parts(carrier[:, None] * np.hstack([np.cos(angle), np.sin(angle)]))
        told = both[0].T @ r0 - both[1].T @ r1
        own = (both[0] ** 2).sum(axis=0) - (both[1] ** 2).sum(axis=0)
        half = angle.shape[1]
        across = sum(sign * (v[:, :half] * v[:, half:]).sum(axis=0) for sign, v in zip((1.0, -1.0), both, strict=True))
        c, s = told[:half, 0], told[half:, 0]
        cc, ss = own[:half], own[half:]
        scale = np.maximum(cc * ss - across**2, 1e-9 * np.maximum(cc * ss, 1e-300))
        power[start : start + CHUNK] = (ss * c**2 + cc * s**2 - 2.0 * across * c * s) / scale
    return power
