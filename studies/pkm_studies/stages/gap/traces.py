"""Residuals of a diagnosis laid out run by run and over the workspace, for the report."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from oed import units
from oed.arrays import Array, Index
from oed.effect import State
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.metric import Metric
from oed.result import gap as result_gap
from pkm_studies.resolve.gap import FEED, PASS

#: spread of the radius, share of the mean one, and height over width, up to which
#: points make a circle or a line
ROUND, STRAIGHT = 0.1, 0.05
#: least number of points of a circle or a line
LEAST = 5
#: places of the tool nearer than this count as one, m
SAME_PLACE = 1e-4
DIGITS = 4
#: the unit of residuals told as multiples of the stated noise
SIGMA = "sigma"


def traces(found: Diagnosis) -> list[result_gap.Trace]:
    """Every channel of every run, in the order of the readings; a set-up's runs of few
    readings make one.
    """
    told, tips = [], _tips(found)
    parts = {
        "before": found.before,
        "after": found.after,
        "explained": _left(found, found.explained),
        "unexplained": _left(found, found.unexplained),
    }
    for members in _runs(found):
        channels = found.problem.rows["channel"].to_numpy()[members]
        for channel in dict.fromkeys(channels):
            told.append(
                _trace(found, members[channels == channel], str(channel), tips, parts)
            )
    return told


def _left(found: Diagnosis, part: Array) -> Array:
    """What the parameters leave of a change (N,), SI, of the readings where they are
    fitted to it.
    """
    problem, change = found.problem, found.problem.in_noise_units(part)
    left = change - problem.slopes @ Metric(problem, found.law).fit(change)
    return np.asarray(left * problem.sigma)


def _runs(found: Diagnosis) -> list[Index]:
    """Readings of each run; runs too short to be drawn are joined, set-up by set-up."""
    rows, runs = found.problem.rows, []
    short: dict[str, list[Index]] = {}
    for members in found.problem.blocks:
        first = rows.iloc[members[0]]
        if (rows["channel"].to_numpy()[members] == first["channel"]).sum() < LEAST:
            short.setdefault(str(first["setup"]), []).append(members)
        else:
            runs.append(members)
    return [*runs, *(np.concatenate(parts) for parts in short.values())]


def _trace(
    found: Diagnosis,
    members: Index,
    channel: str,
    tips: Array,
    parts: Mapping[str, Array],
) -> result_gap.Trace:
    rows = found.problem.rows.iloc[members]
    first, names = rows.iloc[0], list(dict.fromkeys(rows["run"]))
    run = str(names[0]) if len(names) == 1 else f"{len(names)} runs"
    kind, at, radius = _places(tips[members], rows["phase"].to_numpy(dtype=float))
    if len(names) > 1:
        kind, at, radius = "points", np.arange(1.0, len(members) + 1.0), None
    unit = units.FINE[_channel_unit(found, str(first["setup"]), channel)]
    order = np.argsort(at, kind="stable")

    values = {
        name: [
            round(float(v), DIGITS) for v in units.from_si(part[members][order], unit)
        ]
        for name, part in parts.items()
    }

    return result_gap.Trace(
        setup=str(first["setup"]),
        run=run,
        base=_base(run),
        channel=channel,
        unit=unit,
        kind=kind,
        at=[round(float(v), 3) for v in at[order]],
        **values,
        direction=_same(rows, "direction", int),
        payload=_same(rows, "payload", float),
        feed_mm_min=_same(rows, "feed", lambda v: round(float(v) / FEED, 6)),
        radius_mm=None if radius is None else round(1e3 * radius, 3),
    )


def _base(run: str) -> str:
    """A run's name without its pass; the number that tells runs of several series apart
    stays.
    """
    number = re.search(r" \(\d+\)$", run)
    tail = number.group() if number else ""
    return PASS.sub("", run.removesuffix(tail)) + tail


def _same(rows: Any, name: str, kind: Any) -> Any:
    """A covariate that is the same in a whole run; None where it varies or is not
    known.
    """
    if name not in rows.columns:
        return None
    values = rows[name].to_numpy(dtype=float)
    return (
        kind(values[0]) if np.isfinite(values).all() and np.ptp(values) == 0.0 else None
    )


def _channel_unit(found: Diagnosis, setup: str, channel: str) -> str:
    channels = found.problem.measurement.setups[setup].instrument.channels
    return next(c.unit for c in channels if c.name == channel)


def _tips(found: Diagnosis) -> Array:
    """Tool point (N, 3) of the pose that each reading reads, m."""
    problem, parts = found.problem, []
    for state, s in zip(problem.states, problem.series, strict=True):
        channels = len(problem.measurement.setups[s.setup].instrument.channels)
        parts.append(np.repeat(_read_tips(state, s.index), channels, axis=0))
    return np.vstack(parts)


def _read_tips(state: State, index: Index) -> Array:
    return state.tool[index[:, 0]]


def _places(tips: Array, phase: Array) -> tuple[str, Array, float | None]:
    """What a run is, where its readings stand on it, and the radius of a circle, m."""
    order = np.arange(1.0, len(tips) + 1.0)
    off = tips - tips.mean(axis=0)
    _, extent, axes = np.linalg.svd(off, full_matrices=False)
    if len(tips) < LEAST or extent[0] < SAME_PLACE:
        return "points", order, None
    if extent[1] < STRAIGHT * extent[0]:
        along = off @ (axes[0] * np.sign(axes[0][np.argmax(np.abs(axes[0]))]))
        return "line", 1e3 * (along - along.min()), None
    flat = off @ axes[:2].T
    system = np.column_stack([2.0 * flat, np.ones(len(flat))])
    centre = np.linalg.lstsq(system, np.sum(flat**2, axis=1), rcond=None)[0][:2]
    radii = np.linalg.norm(flat - centre, axis=1)
    if radii.std() < ROUND * radii.mean() and extent[2] < ROUND * extent[0]:
        return "circle", np.degrees(phase), float(radii.mean())
    return "points", order, None


def spots(found: Diagnosis) -> tuple[list[result_gap.Spot], str]:
    """Rms residual at each place of the tool, before and after; in the readings' unit,
    or in units of the noise.
    """
    problem = found.problem
    kinds = {
        _channel_unit(found, str(r.setup), str(r.channel))
        for r in problem.rows.itertuples()
    }
    unit = units.FINE[kinds.pop()] if len(kinds) == 1 else SIGMA
    scale = (
        problem.sigma if unit == SIGMA else np.full(len(problem), units.factor(unit))
    )
    tips = _tips(found)
    _, owner = np.unique(np.round(tips / SAME_PLACE), axis=0, return_inverse=True)
    owner = owner.ravel()
    told = []
    for k in dict.fromkeys(owner):
        mine = owner == k
        at = [round(1e3 * float(v), 3) for v in tips[mine].mean(axis=0)]
        rms = [
            round(float(np.sqrt(np.mean((v[mine] / scale[mine]) ** 2))), DIGITS)
            for v in (found.before, found.after)
        ]
        told.append(result_gap.Spot(at, *rms))
    return told, unit
