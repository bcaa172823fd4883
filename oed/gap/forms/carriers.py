"""What a form over time, path or place may act on: a channel's reading, a joint, the
tool; and how it is looked for.

Forms that could sit anywhere are too many to be columns all at once. Each is told by
what it explains of the residual, in the metric that lets the parameters absorb first;
the strongest few stand in the library of processes, each with the prior weight of one
among all that were looked at.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.tail import log_tail
from oed.gap.forms.library import Atom, Library
from oed.gap.forms.processes import UNIT, together
from oed.measurement import Series


@dataclasses.dataclass(frozen=True, slots=True)
class Peak:
    """A form: log tail probability of what it explains, its columns (N, k), and what it
    is told by; the columns that each of several forms of the same has, all of them by
    default. Where columns are many and few are seen well, minus the log evidence stands
    in place of the tail. `about`: the form in words; labels (k,): the leg of each
    column, where the form is a leg's.
    """

    log_tail: float
    columns: Array
    constants: Mapping[str, float]
    about: str
    forms: tuple[Index, ...] = ()
    labels: tuple[str, ...] = ()


def beside(
    processes: Library,
    name: str,
    kinds: Sequence[tuple[Sequence[Peak], int]],
    kept: int,
) -> Library:
    """The processes with the strongest `kept` of each kind of forms beside them, all of
    one name.

    kinds   forms, and how many were looked at to find them; each kind has the prior
            weight of a process
    """
    found = [
        (peak, -math.log(count))
        for peaks, count in kinds
        for peak in sorted(peaks, key=lambda p: p.log_tail)[:kept]
    ]
    columns, atoms = [processes.columns], list(processes.atoms)
    names, labels = list(processes.names), list(processes.labels)
    for k, (peak, weight) in enumerate(found):
        width = peak.columns.shape[1]
        forms = peak.forms or (np.arange(width),)
        columns.append(peak.columns)
        less = weight - math.log(len(forms))
        atoms += [
            Atom(name, peak.constants, len(names) + form, less, peak.about)
            for form in forms
        ]
        names += [f"{name} {k} {j}" for j in range(width)]
        labels.extend(peak.labels or [""] * width)
    more = len(names) - len(processes.names)
    return dataclasses.replace(
        processes,
        columns=np.hstack(columns),
        atoms=tuple(atoms),
        names=tuple(names),
        labels=tuple(labels),
        scales=np.concatenate([processes.scales, np.full(more, UNIT)]),
    )


def every(problem: GapProblem) -> list[Array]:
    """Readings (N, c, J), in units of the noise, per micrometre of each channel, then
    each joint, last the tool along each axis, at each of the poses that a reading sees.
    """
    legs = joints(problem)
    channels = np.zeros((len(problem), len(np.unique(problem.group)), legs.shape[2]))
    channels[np.arange(len(problem)), problem.group, 0] = UNIT / problem.sigma
    alone = [
        part[:, i, None] for part in (channels, legs) for i in range(part.shape[1])
    ]
    return [*alone, tool(problem, legs)]


def named(problem: GapProblem) -> list[str]:
    """What each of `every` is, in words."""
    channels = problem.rows["channel"].to_numpy()
    kinds = [
        f"the readings of {channels[problem.group == g][0]}"
        for g in np.unique(problem.group)
    ]
    return [*kinds, *(f"leg {i + 1}" for i in problem.states[0].limbs), "the tool"]


def joints(problem: GapProblem) -> Array:
    """Readings (N, nq, J), in units of the noise, per micrometre of each joint at each
    of the poses that they see.
    """
    return _slopes(problem, [r.joints for r in problem.responses])


def parameters(problem: GapProblem) -> Array:
    """Readings (N, n, J), in units of the noise, of the machine's uncertain parameters
    at each of the poses that they see: each by its tolerance against that of lengths,
    all together by a micrometre.
    """
    shares = together(problem.measurement.machine)
    made = _slopes(problem, [r.parameters for r in problem.responses])[:, list(shares)]
    return np.asarray(made * np.array(list(shares.values()))[:, None])


def _slopes(problem: GapProblem, every: Sequence[Sequence[Array]]) -> Array:
    """Slopes (m, channels, k) at the poses of each series as the readings see them (N,
    k, J), in units of the noise per micrometre.
    """
    parts, most = [], _most(problem)
    for series, told in zip(problem.series, every, strict=True):
        slopes = np.zeros((told[0][..., 0].size, told[0].shape[-1], most))
        for k, j in enumerate(_seen(series)):
            slopes[:, :, k] = told[j].reshape(len(slopes), -1)
        parts.append(slopes)
    return problem.in_noise_units(UNIT * np.concatenate(parts))


def tool(problem: GapProblem, legs: Array) -> Array:
    """The same (N, 3, J) per micrometre of the tool along each axis, from that of the
    joints (N, nq, J).
    """
    return np.asarray(
        np.einsum(
            "nqj,njqk->nkj",
            legs,
            at_poses(problem, [s.pushing for s in problem.states]),
        )
    )


def at_poses(problem: GapProblem, values: Sequence[Array]) -> Array:
    """Values (m, ...) at the poses of each series, as the readings see them (N, J,
    ...): first the pose read, then what it is read against; that once more where a
    reading sees fewer poses than others.
    """
    parts, most = [], _most(problem)
    for value, series, response in zip(
        values, problem.series, problem.responses, strict=True
    ):
        seen = _seen(series)
        poses = series.index[:, [*seen, *[seen[-1]] * (most - len(seen))]]
        parts.append(np.repeat(value[poses], response.nuisances.shape[1], axis=0))
    return np.concatenate(parts)


def acting(carrier: Array, forms: Array) -> Array:
    """Readings (N, c, k) of forms (N, J, k) on a carrier (N, c, J)."""
    return np.asarray(
        sum(carrier[:, :, j, None] * forms[:, None, j] for j in range(carrier.shape[2]))
    )


def _seen(series: Series) -> list[int]:
    """Which of the poses in its index a reading sees as it moves: not those that all of
    them share, as taught ones.
    """
    return [
        j
        for j, place in enumerate(series.index.T)
        if j == 0 or len(np.unique(place)) > 1
    ]


def _most(problem: GapProblem) -> int:
    return max(len(_seen(series)) for series in problem.series)


def tails(metric: Metric, forms: Array, residual: tuple[Array, Array]) -> Array:
    """Log tail probability (k,) of what forms (N, c, k) explain of a residual, told by
    its parts in the metric.
    """
    size, width = forms.shape[1:]
    inner, told = np.zeros((width, size, size)), np.zeros((width, size))
    for sign, v, r in zip(
        (1.0, -1.0), metric.parts(forms.reshape(len(forms), -1)), residual, strict=True
    ):
        part = np.ascontiguousarray(v.reshape(-1, size, width).transpose(2, 1, 0))
        inner += sign * (part @ part.transpose(0, 2, 1))
        told += sign * (part @ r[:, 0])
    inner += (1e-6 * np.trace(inner, axis1=1, axis2=2) + 1e-300)[
        :, None, None
    ] * np.eye(size)
    energy = np.einsum(
        "fi,fi->f", told, np.linalg.solve(inner, told[:, :, None])[:, :, 0]
    )
    return log_tail(energy, size)
