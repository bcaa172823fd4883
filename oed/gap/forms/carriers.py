"""Carriers of a form over time, path or place: a channel's reading, a joint, the tool.

A carrier is the change of the readings per unit of a form at each pose that they see.
Forms that could sit anywhere are too many to be columns all at once. Each is ranked by
what it explains of the residual after the parameters have absorbed what they can. The
strongest few join the library of processes, each with the prior weight of one among all
that were tried.
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
from oed.gap.forms.processes.base import UNIT, parameter_shares
from oed.measurement import Series


@dataclasses.dataclass(frozen=True, slots=True)
class Peak:
    """A form that explains much of the residual.

    log_tail     log tail probability of what it explains; minus its log evidence where
                 its columns are many of which the readings see few well
    columns      (N, k) change of the readings
    constants    {constant: value} that identify it
    about        the form in words
    forms        columns of each of its variants; one variant of all columns by default
    labels       (k,) leg of each column, where the form is a leg's
    """

    log_tail: float
    columns: Array
    constants: Mapping[str, float]
    about: str
    forms: tuple[Index, ...] = ()
    labels: tuple[str, ...] = ()


def add_peaks(
    processes: Library,
    name: str,
    kinds: Sequence[tuple[Sequence[Peak], int]],
    count: int,
) -> Library:
    """Processes together with the strongest `count` peaks of each kind.

    name     effect name that all of the peaks get
    kinds    peaks of a kind, and how many forms were tried to find them; each kind has
             the prior weight of a process
    """
    strongest = [
        (peak, -math.log(tried))
        for peaks, tried in kinds
        for peak in sorted(peaks, key=lambda p: p.log_tail)[:count]
    ]
    columns, atoms = [processes.columns], list(processes.atoms)
    names, labels = list(processes.names), list(processes.labels)
    for k, (peak, log_weight) in enumerate(strongest):
        width = peak.columns.shape[1]
        forms = peak.forms or (np.arange(width),)
        columns.append(peak.columns)
        log_share = log_weight - math.log(len(forms))
        for form in forms:
            at = len(names) + form
            atoms.append(Atom(name, peak.constants, at, log_share, peak.about))
        names += [f"{name} {k} {j}" for j in range(width)]
        labels.extend(peak.labels or [""] * width)
    added = len(names) - len(processes.names)
    return dataclasses.replace(
        processes,
        columns=np.hstack(columns),
        atoms=tuple(atoms),
        names=tuple(names),
        labels=tuple(labels),
        scales=np.concatenate([processes.scales, np.full(added, UNIT)]),
    )


def all_carriers(problem: GapProblem) -> list[Array]:
    """Carriers (N, c, J), in units of the noise per micrometre.

    Each channel alone, each joint alone, and last the tool along its three axes; J are
    the poses that a reading sees.
    """
    legs = joint_carriers(problem)
    groups = np.unique(problem.channel)
    channels = np.zeros((len(problem), len(groups), legs.shape[2]))
    rows = np.arange(len(problem))
    channels[rows, problem.channel, 0] = UNIT / problem.sigma
    alone = []
    for carriers in (channels, legs):
        alone += [carriers[:, i, None] for i in range(carriers.shape[1])]
    return [*alone, tool_carrier(problem, legs)]


def carrier_names(problem: GapProblem) -> list[str]:
    """Each of `all_carriers` in words."""
    channels = problem.rows["channel"].to_numpy()
    names = []
    for group in np.unique(problem.channel):
        channel = channels[problem.channel == group][0]
        names.append(f"the readings of {channel}")
    names += [f"leg {i + 1}" for i in problem.states[0].limbs]
    return [*names, "the tool"]


def joint_carriers(problem: GapProblem) -> Array:
    """Readings (N, nq, J), in units of the noise, per micrometre of each joint."""
    return _slopes(problem, [r.joints for r in problem.responses])


def parameter_carriers(problem: GapProblem) -> Array:
    """Readings (N, n, J), in units of the noise, of the machine's uncertain parameters.

    Each moves by its tolerance against that of lengths, all together by a micrometre.
    """
    shares = parameter_shares(problem.measurement.machine)
    slopes = _slopes(problem, [r.parameters for r in problem.responses])
    factors = np.array(list(shares.values()))
    return np.asarray(slopes[:, list(shares)] * factors[:, None])


def _slopes(problem: GapProblem, slopes: Sequence[Sequence[Array]]) -> Array:
    """Slopes (N, k, J) at the poses that readings see, in units of the noise.

    `slopes` has, for each series and pose, an array (m, channels, k), SI.
    """
    parts, most = [], _most_poses(problem)
    for series, at_pose in zip(problem.series, slopes, strict=True):
        readings, width = at_pose[0][..., 0].size, at_pose[0].shape[-1]
        part = np.zeros((readings, width, most))
        for k, j in enumerate(_moving_poses(series)):
            part[:, :, k] = at_pose[j].reshape(readings, -1)
        parts.append(part)
    return problem.in_noise_units(UNIT * np.concatenate(parts))


def tool_carrier(problem: GapProblem, legs: Array) -> Array:
    """Readings (N, 3, J) per micrometre of the tool along each axis.

    `legs` (N, nq, J) are the joints' carriers.
    """
    pushing = at_poses(problem, [s.joints_per_displacement for s in problem.states])
    return np.asarray(np.einsum("nqj,njqk->nkj", legs, pushing))


def at_poses(problem: GapProblem, values: Sequence[Array]) -> Array:
    """Values (m, ...) at the poses of each series, as the readings see them (N, J, ...).

    First comes the pose read, then what it is read against. The last repeats where a
    reading sees fewer poses than others.
    """
    parts, most = [], _most_poses(problem)
    sources = zip(values, problem.series, problem.responses, strict=True)
    for value, series, response in sources:
        moving = _moving_poses(series)
        padding = [moving[-1]] * (most - len(moving))
        poses = series.index[:, [*moving, *padding]]
        channels = response.nuisances.shape[1]
        parts.append(np.repeat(value[poses], channels, axis=0))
    return np.concatenate(parts)


def apply_carrier(carrier: Array, forms: Array) -> Array:
    """Readings (N, c, k) of forms (N, J, k) on a carrier (N, c, J)."""
    poses = range(carrier.shape[2])
    return np.asarray(sum(carrier[:, :, j, None] * forms[:, None, j] for j in poses))


def _moving_poses(series: Series) -> list[int]:
    """Columns of its index with the poses that differ among a series' readings.

    A taught pose, which all readings share, is none of them.
    """
    places = enumerate(series.index.T)
    return [j for j, place in places if j == 0 or len(np.unique(place)) > 1]


def _most_poses(problem: GapProblem) -> int:
    return max(len(_moving_poses(series)) for series in problem.series)


def _grams(forms: Array) -> Array:
    """Gram matrices (k, c, c) of forms (N, c, k), an entry of all of them at a time."""
    size, width = forms.shape[1:]
    grams = np.empty((width, size, size))
    for i in range(size):
        for j in range(i + 1):
            products = np.einsum("nk,nk->k", forms[:, i], forms[:, j])
            grams[:, i, j] = grams[:, j, i] = products
    return grams


def log_tails(
    metric: Metric,
    forms: Array,
    residual: tuple[Array, Array],
) -> Array:
    """Log tail probability (k,) of what forms (N, c, k) explain of a residual.

    `residual` are its parts in the metric.
    """
    size, width = forms.shape[1:]
    gram, b = np.zeros((width, size, size)), np.zeros((width, size))
    columns = metric.parts(forms.reshape(len(forms), -1))
    for sign, v, r in zip((1.0, -1.0), columns, residual, strict=True):
        part = v.reshape(-1, size, width)
        gram += sign * _grams(part)
        b += sign * np.einsum("nck,n->kc", part, r[:, 0])
    ridge = 1e-6 * np.trace(gram, axis1=1, axis2=2) + 1e-300
    gram += ridge[:, None, None] * np.eye(size)
    solved = np.linalg.solve(gram, b[:, :, None])[:, :, 0]
    energy = np.einsum("fi,fi->f", b, solved)
    return log_tail(energy, size)
