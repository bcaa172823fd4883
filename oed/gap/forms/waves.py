"""Steady waves, as an unknown process.

In time (interference, a pump), along the path at one feed (a resonance), or of a joint
along its travel (a gear). Their frequency is anybody's guess, from one period in the
session or a run to one in two readings. Of all frequencies (Lomb's periodogram, in the
metric that lets the parameters absorb first) the strongest few are kept, each with the
prior weight of one among all that were looked at.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import signal

from oed.arrays import Array
from oed.gap.data import evidence
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers
from oed.gap.forms.carriers import Peak
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw

NAME = "a steady wave"
#: frequencies a resolution cell, most of them, how many peaks of each kind are kept
OVER, MOST, KEPT = 1.5, 6000, 4
CHUNK = 512
#: frequencies that stand beside one that was found: it may be of the fundamental wave
#: or of its overtone
TONES = (0.5, 1.0, 2.0)
#: shortest period that is looked for in time, s, where times are not regular; shortest
#: along the path, m, or as a share of the way from one reading to the next if that is
#: less: runs of several sizes tell waves from their aliases
SHORTEST, FINEST, BETWEEN = 12.0, 0.02, 0.125
#: longest and shortest period along a joint's travel, a share of it and m
LONG, SHORT = 3.0, 1e-3
#: periods in the session up to which waves are slow: these few are looked at apart from
#: the many fast ones
SLOW = 100.0
#: half periods in the session up to which all of the machine's parameters may swing
#: together; sizes that waves of many columns are tried with, how many are kept
SWINGS, SIZES, BEST = 20, np.array([0.1, 0.3, 1.0, 3.0]), 2
#: places between two frequencies at which a peak is looked at closely
FINE = np.linspace(-0.8, 0.8, 9)
#: readings that a feed must have, and ticks that a clock must have, for its waves to
#: mean something
LEAST = 16


@dataclasses.dataclass(frozen=True, slots=True)
class Band:
    """Waves over a clock (N, J), s or m of path at each of the poses seen, on any of
    some carriers (N, c, J); or over a clock (N, J, c) of each column of a carrier. legs
    (c,): whose travel that is, if it is one.
    """

    unit: str
    clock: Array
    carriers: list[Array]
    frequencies: Array
    names: list[str]
    legs: tuple[str, ...] = ()


def added(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The processes with the strongest steady waves of each kind beside them, each kind
    with a process's prior.
    """
    metric = Metric(problem, law)
    kinds: list[tuple[list[Peak], int]] = []
    for bands in _kinds(problem):
        count = sum(len(b.frequencies) * len(b.carriers) for b in bands)
        kinds.append(
            (
                [
                    p
                    for b in bands
                    for p in peaks(problem, metric, b, -_tails(problem, metric, b))
                ],
                count,
            )
        )
    for bands in (_swings(problem), _in_runs(problem)):
        kinds.append(
            (_told(problem, metric, bands), sum(len(b.frequencies) for b in bands))
        )
    return carriers.beside(processes, NAME, [k for k in kinds if k[0]], KEPT)


def _kinds(problem: GapProblem) -> list[list[Band]]:
    """Slow waves in time, fast ones; along the path; along joints' travels."""
    every = carriers.every(problem)
    in_time = [[band] for band in _in_time(problem, every)]
    return [*in_time, _along_path(problem, every[-1]), _along_travel(problem)]


def _timed(problem: GapProblem) -> bool:
    """Whether the time of every reading is known."""
    return "time" in problem.rows and bool(problem.rows["time"].notna().all())


def _in_time(problem: GapProblem, every: list[Array]) -> list[Band]:
    """Waves in time on a channel, on a joint, on the tool: slow ones, then fast ones."""
    rows, known = problem.rows, _timed(problem)
    time = (
        rows["time"].to_numpy(dtype=float)
        if known
        else np.cumsum(rows["reading"].diff().ne(0).to_numpy(dtype=float))
    )
    clock = time - time.min()
    ticks = np.unique(clock)
    against = (
        carriers.at_poses(problem, [s.time - time.min() for s in problem.states])
        if known
        else _begun(problem, clock, every[0].shape[2])
    )
    if len(ticks) < LEAST:
        return []
    step = float(np.median(np.diff(ticks)))
    places = (ticks - ticks[0]) / step
    regular = not known or bool(np.abs(places - np.round(places)).max() <= 0.05)
    most = (
        0.5 / step if regular else 1.0 / SHORTEST
    )  # irregular times tell fast waves from slow, however far apart
    clocks = np.column_stack([clock, against[:, 1:]])
    span = float(np.ptp(clock)) + step
    middle = min(SLOW / span, most)
    names, unit = carriers.named(problem), "s" if known else "readings"
    bands = [Band(unit, clocks, every, _frequencies(span, 1.0 / span, middle), names)]
    return (
        [*bands, Band(unit, clocks, every, _frequencies(span, middle, most), names)]
        if most > middle
        else bands
    )


def _swings(problem: GapProblem) -> list[Band]:
    """Slow waves in time of all the machine's parameters together."""
    carrier = carriers.parameters(problem)
    readings = sum(len(s) for s in problem.series)
    span = float(
        np.ptp(problem.rows["time"].to_numpy(dtype=float))
        if _timed(problem)
        else readings
    )
    if not carrier.shape[1] or span <= 0.0:
        return []
    clock = span * carriers.at_poses(problem, [s.progress for s in problem.states])
    unit = "s" if _timed(problem) else "readings"
    return [
        Band(
            unit,
            clock,
            [carrier],
            np.arange(1, SWINGS + 1) / (2.0 * span),
            ["all parameters together"],
        )
    ]


def _in_runs(problem: GapProblem) -> list[Band]:
    """Waves in time on a channel, where no time is told: over the way in each run,
    their phases its own.
    """
    if _timed(problem):
        return []
    arc = _arc(problem)
    runs = np.zeros((len(problem), len(problem.blocks)))
    for k, members in enumerate(problem.blocks):
        runs[members, k] = 1.0
    runs, span = runs[:, runs.sum(axis=0) >= LEAST], float(arc[:, 0].max())
    if not runs.shape[1] or span <= 0.0:
        return []
    longest = max(len(members) for members in problem.blocks)
    frequencies = _frequencies(span, 1.0 / span, 0.5 * longest / span)
    channels = zip(
        carriers.every(problem),
        carriers.named(problem)[: len(np.unique(problem.group))],
        strict=False,
    )
    return [
        Band("m", arc, [c * runs[:, :, None]], frequencies, [f"{n}, run by run"])
        for c, n in channels
    ]


def _told(problem: GapProblem, metric: Metric, bands: Sequence[Band]) -> list[Peak]:
    """The best waves of bands whose carriers have many columns of which few are seen
    well: told by their evidence, for what all of them explain is mostly noise.
    """
    found = []
    for band in bands:
        columns = _waves(band.carriers[0], _both(band.clock, band.frequencies))
        width, name = columns.shape[1], band.names[0]
        every = evidence.WhitenedColumns(
            problem, metric, columns.transpose(0, 2, 1).reshape(len(problem), -1)
        )
        for k, frequency in enumerate(band.frequencies):
            told = every.grams(slice(k * width, (k + 1) * width)).log_evidences(
                [np.arange(width)], SIZES
            )
            period = 1.0 / float(frequency)
            about = _words(band.unit, period, name)
            found.append(
                Peak(
                    -float(told.max()),
                    columns[:, :, k],
                    {f"period_{band.unit}": period},
                    about,
                )
            )
    return sorted(found, key=lambda p: p.log_tail)[:BEST]


def _along_path(problem: GapProblem, tool: Array) -> list[Band]:
    """Waves along the path of the tool, at one feed."""
    # a feed that is not told is the same in all
    feed = (
        np.nan_to_num(problem.rows["feed"].to_numpy(dtype=float))
        if "feed" in problem.rows
        else np.zeros(len(problem))
    )
    arc, bands = _arc(problem), []
    for value in np.unique(np.round(feed, 9)):
        here = np.isclose(feed, value)
        steps = np.diff(arc[here, 0])
        steps = steps[steps > 1e-6]
        if here.sum() < LEAST or not steps.size:
            continue
        span, finest = (
            float(arc[here, 0].max()),
            min(FINEST, BETWEEN * float(np.median(steps))),
        )
        frequencies = _frequencies(span, 1.0 / span, max(1.0 / finest, 1.0 / span))
        name = f"the tool at {6e4 * value:.0f} mm/min" if value > 0.0 else "the tool"
        bands.append(
            Band(
                "m",
                arc,
                [np.where(here[:, None, None], tool, 0.0)],
                frequencies,
                [name],
            )
        )
    return bands


def travels(problem: GapProblem) -> tuple[list[int], Array, Array]:
    """Sliding joints with a travel worth telling, all joints' places (N, J, nq), m or
    rad, and their spans (nq,).
    """
    place = carriers.at_poses(problem, [s.joints for s in problem.states])
    place -= place.min(axis=(0, 1))
    spans = np.ptp(place[:, 0], axis=0)
    kinds = problem.measurement.machine.joints
    return (
        [i for i, j in enumerate(kinds) if j.unit == "m" and spans[i] > SHORT * LEAST],
        place,
        spans,
    )


def along(legs: Array, some: Sequence[int], place: Array, frequencies: Array) -> Band:
    """Waves of one joint along its own travel, or of several at one period, each with
    its own phase. legs (N, nq, J) of
    all joints, as from `carriers.joints`;  place (N, J, nq)
    """
    names = tuple(f"leg {i + 1}" for i in some)
    alone = len(names) == 1
    clock = place[:, :, some[0]] if alone else place[:, :, list(some)]
    told = names[0] if alone else "all legs, each"
    return Band("travel_m", clock, [legs[:, list(some)]], frequencies, [told], names)


def _along_travel(problem: GapProblem) -> list[Band]:
    """Waves of a joint along its own travel, and of all of them at one period."""
    legs = carriers.joints(problem)
    long, place, spans = travels(problem)
    bands = []
    for i in long:
        frequencies = _frequencies(spans[i], LONG / spans[i], 1.0 / SHORT)
        bands.append(along(legs, [i], place, frequencies))
    if len(long) > 1:
        span = float(spans[long].max())
        bands.append(
            along(legs, long, place, _frequencies(span, LONG / span, 1.0 / SHORT))
        )
    return bands


def _frequencies(span: float, low: float, high: float) -> Array:
    """From one to another, so close that no wave over a span falls between them."""
    return np.linspace(low, high, int(min(max(OVER * span * (high - low), 1.0), MOST)))


def _begun(problem: GapProblem, clock: Array, seen: int) -> Array:
    """The clock (N, seen) where no time is known: what a reading is read against was
    seen as its run began.
    """
    against = np.repeat(clock[:, None], seen, axis=1)
    for members in problem.blocks:
        against[members, 1:] = clock[members].min()
    return against


def _arc(problem: GapProblem) -> Array:
    """Way (N, J) of the tool since its run's first reading, m; of what it is read
    against, the way back to that.
    """
    tool = carriers.at_poses(problem, [s.tool for s in problem.states])
    order, arc = problem.rows["order"].to_numpy(dtype=float), np.zeros(tool.shape[:2])
    for members in problem.blocks:
        at = members[np.argsort(order[members], kind="stable")]
        arc[at[1:], 0] = np.cumsum(np.linalg.norm(np.diff(tool[at, 0], axis=0), axis=1))
        arc[members, 1:] = -np.linalg.norm(tool[members, 1:] - tool[at[0], 0], axis=2)
    return arc


def peaks(
    problem: GapProblem, metric: Metric, band: Band, strength: Array
) -> list[Peak]:
    """The strongest waves of a band on each of its carriers, by what tells how strong
    they are (carriers, k).
    """
    found = []
    for carrier, name, told in zip(band.carriers, band.names, strength, strict=True):
        high, _ = signal.find_peaks(
            np.concatenate([[-1.0], told, [-1.0]]), distance=int(2 * OVER)
        )
        for k in high[np.argsort(-told[high - 1])][:KEPT] - 1:
            near = _close(band, carrier, int(k))
            tails = _tails(problem, metric, near)[0]
            best = float(near.frequencies[np.argmin(tails)])
            columns = np.hstack(
                [
                    _waves(carrier, _both(band.clock, np.array([f * best])))[:, :, 0]
                    for f in TONES
                ]
            )
            half, own, twice = np.arange(columns.shape[1]).reshape(3, -1)
            forms = (own, np.concatenate([own, twice]), np.concatenate([half, own]))
            about = _words(band.unit, 1.0 / best, name)
            labels = tuple(leg for _ in TONES for leg in band.legs for _ in range(2))
            found.append(
                Peak(
                    float(tails.min()),
                    columns,
                    {f"period_{band.unit}": 1.0 / best},
                    about,
                    forms,
                    labels,
                )
            )
    return found


def _words(unit: str, period: float, name: str) -> str:
    """A wave as a person says it."""
    if unit == "s":
        size, word = next(
            (s, w)
            for s, w in ((3600.0, "h"), (60.0, "min"), (1.0, "s"))
            if period > 2.0 * s or s == 1.0
        )
        return f"{name} in a wave of {period / size:.3g} {word}"
    if unit == "readings":
        return f"{name} in a wave of {period:.3g} readings"
    return (
        f"{name} in a wave every {1e3 * period:.3g} mm of"
        f" {'path' if unit == 'm' else 'travel'}"
    )


def _close(band: Band, carrier: Array, k: int) -> Band:
    """The band about its k-th frequency, on one carrier."""
    step = float(np.diff(band.frequencies[:2])[0]) if len(band.frequencies) > 1 else 0.0
    return dataclasses.replace(
        band, carriers=[carrier], frequencies=band.frequencies[k] + step * FINE
    )


def _both(clock: Array, frequencies: Array) -> Array:
    """Cosine and sine (..., 2, k) of each frequency at a clock (...)."""
    angle = 2.0 * np.pi * clock[..., None] * frequencies
    return np.stack([np.cos(angle), np.sin(angle)], axis=-2)


def _waves(carrier: Array, both: Array) -> Array:
    """Columns (N, 2 c, k): cosines and sines (N, J, 2, k) on each column of a carrier
    (N, c, J), or (N, J, c, 2, k) of each column's own.
    """
    if both.ndim == 5:
        made = np.einsum("ncj,njchk->nchk", carrier, both)
    else:
        made = carriers.acting(carrier, both.reshape(*both.shape[:2], -1))
    return np.asarray(made.reshape(len(carrier), -1, both.shape[-1]))


def _tails(problem: GapProblem, metric: Metric, band: Band) -> Array:
    """Log tail probability (carriers, k) of the energy that each wave explains of the
    residual, its phases free.
    """
    residual = metric.parts(problem.residual[:, None])
    tails = np.empty((len(band.carriers), len(band.frequencies)))
    for start in range(0, tails.shape[1], CHUNK):
        here = slice(start, start + CHUNK)
        both = _both(band.clock, band.frequencies[here])
        for row, carrier in zip(tails, band.carriers, strict=True):
            row[here] = carriers.tails(metric, _waves(carrier, both), residual)
    return tails
