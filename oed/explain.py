"""Identifiability told in words: what is seen, what only in combination, what is lost
and what would bring it back.

Remedies are computed, not looked up: each trial adds readings to the plan (the same
poses with a longer tool, with the tool's position or axis read as well, another set-up
of the study) and counts the directions that are no longer lost.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence

import numpy as np

from oed import identifiability, information, units
from oed.arrays import Array, Index, Mask
from oed.identifiability import Identifiability
from oed.measurement import Measurement, Series

#: posterior over prior standard deviation above which a parameter counts as hardly seen
WEAK = 0.7
#: length (m) by which the trial tool is longer
LONGER = 0.100


@dataclasses.dataclass(frozen=True, slots=True)
class Finding:
    """One line of the verdict: kind is seen, combination, weak or lost."""

    kind: str
    text: str
    remedies: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class Seen:
    """Readings with their verdict.

    verdict    over the free parameters `names`, columns scaled by `scale` (n,)
    shrinkage  (n,) posterior over prior standard deviation, from these readings alone
    covariance (n, n) posterior in units of the tolerances
    """

    measurement: Measurement
    series: tuple[Series, ...]
    verdict: Identifiability
    scale: Array
    shrinkage: Array
    covariance: Array

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return self.verdict.names


def look(
    measurement: Measurement,
    series: Sequence[Series],
    scaling: information.Scaling = "length",
    at: Array | None = None,
    tolerance: float = identifiability.TOLERANCE,
) -> Seen:
    """Identifiability of readings at theta `at` (nominal by default), over machine and
    the set-ups they use.
    """
    theta = measurement.nominal if at is None else at
    free = _concerned(measurement, series)
    h = information.scaled(measurement, series, theta, scaling)[:, free]
    scale = information.column_scale(measurement, scaling)[free]
    covariance = information.posterior_covariance(
        information.scaled(measurement, series, theta, "tolerance")[:, free]
    )
    return Seen(
        measurement=measurement,
        series=tuple(series),
        verdict=identifiability.analyse(
            h, [measurement.names[k] for k in free], scale, tolerance
        ),
        scale=scale,
        shrinkage=np.sqrt(np.diag(covariance)),
        covariance=covariance,
    )


def explain(
    seen: Seen, others: Mapping[str, tuple[Measurement, Sequence[Series]]] | None = None
) -> list[Finding]:
    """The verdict in sentences; `others` are readings of the study not in this plan, as
    possible remedies.
    """
    findings = [
        _one_by_one(seen),
        _weak(seen),
        _families(seen),
        _combinations(seen),
        _lost(seen, others or {}),
    ]
    return [f for f in findings if f is not None]


def _concerned(measurement: Measurement, series: Sequence[Series]) -> Index:
    """Indices of the free parameters of the machine and of the set-ups read in."""
    used = {s.setup for s in series}
    return np.array(
        [
            k
            for k, (name, free) in enumerate(
                zip(measurement.names, measurement.free, strict=True)
            )
            if free and ("." not in name or name.rpartition(".")[0] in used)
        ],
        dtype=np.intp,
    )


def _alone(seen: Seen) -> Mask:
    """Mask (n,) of the parameters that the readings determine each by itself."""
    return np.asarray(np.sum(seen.verdict.null_space**2, axis=0) < 1e-12)


def _tightened(seen: Seen, k: int) -> str:
    parameter = next(p for p in seen.measurement.parameters if p.name == seen.names[k])
    unit = units.display(parameter.unit)
    before = units.number(parameter.tolerance, unit)
    shown = "" if unit == "1" else f" {unit}"
    return f"{parameter.name} ({before:.3g} to {before * seen.shrinkage[k]:.2g}{shown})"


def _one_by_one(seen: Seen) -> Finding | None:
    found = np.flatnonzero(_alone(seen) & (seen.shrinkage <= WEAK))
    if not found.size:
        return Finding("weak", "No parameter is determined by itself.")
    told = ", ".join(_tightened(seen, int(k)) for k in found)
    return Finding(
        "seen",
        f"Seen one by one, standard deviation before to after the readings: {told}.",
    )


def _weak(seen: Seen) -> Finding | None:
    found = np.flatnonzero(_alone(seen) & (seen.shrinkage > WEAK))
    if not found.size:
        return None
    told = ", ".join(_tightened(seen, int(k)) for k in found)
    return Finding(
        "weak",
        f"Seen in principle, but in practice these stay near their tolerance: {told}.",
    )


def _families(seen: Seen) -> Finding | None:
    """Kinds of machine parameters whose common error the readings leave as it was."""
    kinds: dict[str, list[int]] = {}
    for k, name in enumerate(seen.names):
        if "." not in name:
            kinds.setdefault(re.sub(r"\d", "", name), []).append(k)
    told = []
    for kind, members in kinds.items():
        common = np.zeros(len(seen.names))
        common[members] = 1.0 / np.sqrt(len(members))
        left = float(np.sqrt(common @ seen.covariance @ common))
        if left > WEAK and len(members) > 1:
            named = ", ".join(seen.names[k] for k in members)
            told.append(
                f"the common {kind} ({named}) keeps {100 * left:.0f} % of its tolerance"
            )
    if not told:
        return None
    return Finding(
        "weak", f"Not identifiable in practice from these readings: {'; '.join(told)}."
    )


def _combinations(seen: Seen) -> Finding | None:
    parameter_unit = {p.name: p.unit for p in seen.measurement.parameters}
    told = [
        combination(terms, parameter_unit)
        for terms in seen.verdict.named(seen.verdict.combinations)
        if len(terms) > 1
    ]
    if not told:
        return None
    return Finding(
        "combination",
        f"Determined only in combination ({len(told)}): {'; '.join(told)}.",
    )


def combination(terms: Mapping[str, float], unit: Mapping[str, str]) -> str:
    """`beta1 + 0.279/m (z1 - z2)`-like text of one minimal linear combination, pivot
    first.
    """
    pivot = next(
        (n for n in reversed(list(terms)) if abs(terms[n] - 1.0) < 1e-9),
        next(iter(terms)),
    )
    text = pivot
    for name, value in terms.items():
        if name != pivot:
            size = abs(value)
            factor = "" if abs(size - 1.0) < 5e-4 else f"{size:.3g} "
            text += (
                f" {'-' if value < 0 else '+'}"
                f" {factor}{_per(unit[pivot], unit[name])}{name}"
            )
    return text


def _per(pivot: str, other: str) -> str:
    return "" if pivot == other or "1" in (pivot, other) else f"{pivot}/{other} "


def _lost(
    seen: Seen, others: Mapping[str, tuple[Measurement, Sequence[Series]]]
) -> Finding | None:
    count = len(seen.names) - seen.verdict.rank
    if not count:
        return Finding(
            "seen", "Nothing is lost: the readings determine every free parameter."
        )
    motions, rest = identifiability.lost_motions(
        seen.verdict, seen.measurement.machine, seen.scale
    )
    texts = [f"the {m}" for m in motions] + [
        _direction(seen, row) for row in identifiability.echelon(rest)
    ]
    text = (
        f"Lost, {count} direction{'s' if count > 1 else ''} of {len(seen.names)}:"
        f" {'; '.join(texts)}. A motion of the parameters along these changes no"
        " reading."
    )
    return Finding("lost", text, tuple(remedies(seen, others)))


def _direction(seen: Seen, row: Array) -> str:
    """A null direction by its largest entries, as a joint change of parameters in their
    display units.
    """
    shown = units.DISPLAY
    move = row * seen.scale
    parameters = {p.name: p for p in seen.measurement.parameters}
    told = np.array(
        [
            units.number(m, shown[parameters[n].unit])
            for m, n in zip(move, seen.names, strict=True)
        ]
    )
    size = np.round(
        np.abs(row) / np.abs(row).max(), 9
    )  # equal entries keep the parameters' order
    told /= told[np.argmax(size)]
    order = [k for k in np.argsort(-size, kind="stable") if size[k] > 0.05]
    parts = [
        f"{seen.names[k]} by {told[k]:+.3g} {shown[parameters[seen.names[k]].unit]}".removesuffix(
            " 1"
        )
        for k in order[:8]
    ]
    return "moving " + ", ".join(parts) + (" and more" if len(order) > 8 else "")


def remedies(
    seen: Seen, others: Mapping[str, tuple[Measurement, Sequence[Series]]]
) -> list[str]:
    """Trials that bring lost directions back, in words with the number they bring back."""
    lost = len(seen.names) - seen.verdict.rank
    told = []
    for text, still in [
        *_tool_trial(seen),
        *_pose_trials(seen),
        *_other_trials(seen, others),
    ]:
        if still < lost:
            which = (
                f"{lost - still} of {lost} lost directions"
                if still > 0
                else "the lost direction"
            )
            told.append(
                f"{text} brings back"
                f" {'all lost directions' if still <= 0 and lost > 1 else which}"
            )
    return told


def _deficit(rows: Array, free: Index, scale: Array) -> int:
    h = (rows * scale)[:, free]
    s = np.linalg.svd(h, compute_uv=False)
    return int(len(free) - np.count_nonzero(s > identifiability.TOLERANCE * s[0]))


def _tool_trial(seen: Seen) -> list[tuple[str, int]]:
    """The same joint positions read once more with a longer tool in set-ups of their
    own.
    """
    machine, used = (
        seen.measurement.machine,
        list(dict.fromkeys(s.setup for s in seen.series)),
    )
    if not any(c.unit == "rad" for c in machine.pose):
        return []
    setups = [seen.measurement.setups[n] for n in used]
    longer = [
        dataclasses.replace(
            s,
            name=f"{s.name}, longer tool",
            tool=(s.tool[0], s.tool[1], s.tool[2] + LONGER),
        )
        for s in setups
    ]
    trial = Measurement(machine, [*setups, *longer])
    again = [
        dataclasses.replace(s, setup=f"{s.setup}, longer tool") for s in seen.series
    ]
    rows = trial.jacobian([*seen.series, *again], trial.nominal)
    still = _deficit(rows, np.flatnonzero(trial.free), 1.0 / trial.lengths)
    return [
        (f"a second tool, {LONGER * 1e3:.0f} mm longer, in a set-up of its own", still)
    ]


def _pose_trials(seen: Seen) -> list[tuple[str, int]]:
    """The same poses with more of the pose read, by a tracker whose frame is known."""
    measurement, machine = seen.measurement, seen.measurement.machine
    rows = measurement.jacobian(seen.series, measurement.nominal)
    position, axis, full = [], [], []
    for s in seen.series:
        tool = np.array(measurement.setups[s.setup].tool)
        x = measurement.poses(s, measurement.nominal)
        rotation, _, twist = measurement.kinematics.frames(x, tool)
        slope = twist @ measurement.kinematics.sensitivity(x, s.q, machine.nominal)
        body = np.swapaxes(rotation, 1, 2) @ slope[:, 3:]
        position.append(slope[:, :3].reshape(-1, slope.shape[2]))
        axis.append(body[:, :2].reshape(-1, slope.shape[2]))
        full.append(slope.reshape(-1, slope.shape[2]))
    free, scale = _concerned(measurement, seen.series), 1.0 / measurement.lengths

    def still(extra: Sequence[Array]) -> int:
        wide = np.vstack(extra)
        padded = np.hstack([wide, np.zeros((len(wide), rows.shape[1] - wide.shape[1]))])
        return _deficit(np.vstack([rows, padded]), free, scale)

    trials = [("reading the tool's position too, in a known frame,", still(position))]
    if any(c.unit == "rad" for c in machine.pose):
        trials += [
            ("reading the tool axis' direction too, in a known frame,", still(axis)),
            ("reading all six pose components, in a known frame,", still(full)),
        ]
    return trials


def _other_trials(
    seen: Seen, others: Mapping[str, tuple[Measurement, Sequence[Series]]]
) -> list[tuple[str, int]]:
    trials = []
    for name, (measurement, extra) in others.items():
        known = {s.setup for s in seen.series} | {s.setup for s in extra}
        setups = {**measurement.setups, **seen.measurement.setups}
        both = Measurement(
            measurement.machine, [setups[k] for k in setups if k in known]
        )
        rows = both.jacobian([*seen.series, *extra], both.nominal)
        trials.append(
            (
                f"adding the readings of {name}",
                _deficit(rows, np.flatnonzero(both.free), 1.0 / both.lengths),
            )
        )
    return trials
