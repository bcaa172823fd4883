"""The discrepancy: what acts in no form of the library, as Gaussian processes.

Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464: what a model leaves is a random
function of what the machine does. It is carried by the readings, by the tool's place or
by each joint; it varies over the session, the workspace or the run; it may come with the
direction of motion, the payload, the feed or a temperature. Each such term has Matern's
kernel at a few reaches, which the evidence sums over (`oed.base.field_modes`).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base import Array, Index, Mask, field_modes
from oed.gap.data.problem import GapProblem
from oed.gap.forms import carriers
from oed.gap.forms.carriers import JOINTS, Carrier
from oed.gap.forms.library import ALONE, Atom, Library

#: reaches of the kernels: over the session and the travels, from -1 to 1, and over the
#: unit circle of the phase
REACHES = {"time": (0.2, 1.0), "place": (0.3, 1.0), "phase": (0.3, 1.0)}
#: share of its variance that a term's columns hold, and the most of them a carrier has
WHOLE, MODES = 0.98, 36
#: most columns of a term, those of all parts of its carrier together
WIDEST = 72
#: readings that a run must have to be a term by itself
LEAST = 8

#: names of kinds: what acts in one run alone, along all runs, with their direction
IN_A_RUN, ALONG_RUNS, WITH_DIRECTION = (
    "in a run",
    "along the runs",
    "with the direction",
)

#: values (N, J) or (N, J, d) of a coordinate or a factor at the poses readings see
Values = Array


@dataclasses.dataclass(frozen=True)
class Term:
    """One kind of discrepancy at one reach.

    name       of the kind: what it comes with
    about      in words
    carrier    what it acts on
    forms      (N, J, c, k) for each of the carrier's columns
    reach      of its kernel
    timed      whether it varies with the time or a temperature
    """

    name: str
    about: str
    carrier: Carrier
    forms: Array
    reach: float
    timed: bool = False

    @property
    def reversal(self) -> Array:
        """Factor (k,) on the columns of each of the carrier's, driven the other way."""
        factor = np.ones(self.forms.shape[3])
        if self.name == WITH_DIRECTION:
            return -factor
        if self.name == ALONG_RUNS:
            factor[len(factor) // 2 :] = -1.0
        return factor


def build(problem: GapProblem) -> Library:
    """The discrepancy's terms as atoms; each kind has the same prior probability."""
    columns = [np.zeros((len(problem), 0))]
    atoms: list[Atom] = []
    labels: list[str] = []
    for kind in _by_kind(problem):
        every = [(term, *_columns(term)) for term in kind]
        visible = [part for part in every if part[1].any()]
        for term, block, owner in visible:
            start = len(labels)
            constants = {"reach": term.reach} if term.reach else {}
            for choice, share in _choices(term.carrier, owner):
                log_weight = math.log(share) - math.log(len(visible))
                place = start + choice
                factor = np.tile(term.reversal, len(term.carrier.labels))[choice]
                atom = Atom(term.name, constants, place, log_weight, term.about)
                atoms.append(
                    dataclasses.replace(atom, timed=term.timed, reversal=factor)
                )
            columns.append(block)
            labels += [term.carrier.labels[c] for c in owner]
    return assembled(columns, atoms, labels)


def assembled(
    columns: list[Array], atoms: Sequence[Atom], labels: Sequence[str]
) -> Library:
    """Blocks of columns (N, k) of a discrepancy, in units of the noise, as a library.

    The list of blocks is empty afterwards: those of long sessions would be twice in
    memory.
    """
    count = len(labels)
    return Library(
        columns=_joined(columns),
        atoms=tuple(atoms),
        names=tuple(f"discrepancy {k}" for k in range(count)),
        labels=tuple(labels),
        scales=np.ones(count),
        not_testable={},
    )


def _joined(blocks: list[Array]) -> Array:
    """Blocks (N, k) side by side (N, K); the list is emptied on the way."""
    joined = np.empty((len(blocks[0]), sum(block.shape[1] for block in blocks)))
    start = 0
    while blocks:
        block = blocks.pop(0)
        joined[:, start : start + block.shape[1]] = block
        start += block.shape[1]
    return joined


def _columns(term: Term) -> tuple[Array, Index]:
    """Columns (N, c k) of a term, and the number (c k,) of the carrier's of each."""
    block = np.einsum("ncj,njck->nck", term.carrier.columns, term.forms)
    count, width = block.shape[1:]
    return block.reshape(len(block), -1), np.repeat(np.arange(count), width)


def _choices(carrier: Carrier, owner: Index) -> list[tuple[Index, float]]:
    """Columns of all parts of a carrier together and of each alone, with shares."""
    everything = np.arange(len(owner), dtype=np.intp)
    parts = len(carrier.labels)
    if not carrier.separable:
        return [(everything, 1.0)]
    single = [np.flatnonzero(owner == c) for c in range(parts)]
    return [(everything, 1.0 - ALONE), *((part, ALONE / parts) for part in single)]


def _by_kind(problem: GapProblem) -> Iterator[list[Term]]:
    """The terms of each kind that these readings can have."""
    every = carriers.every(problem)
    session = 2.0 * _covariate(problem, "session_progress") - 1.0
    travel = _covariate(problem, "travel")
    over_session = [_Places(c, session[:, :, None]) for c in every]
    over_workspace = [_Places(c, travel, by_column=c.name == JOINTS) for c in every]
    yield [
        Term("over time", f"drift of {p.carrier.name}", p.carrier, forms, reach, True)
        for p in over_session
        for reach, forms in p.forms(REACHES["time"])
    ]
    workspace = [(p, p.forms(REACHES["place"])) for p in over_workspace]
    for name, words, common, by_joint, timed in _factors(problem):
        yield [
            Term(
                name,
                f"an error of {p.carrier.name} over the workspace{words}",
                p.carrier,
                _times(forms, by_joint if p.by_column else common),
                reach,
                timed,
            )
            for p, by_reach in workspace
            for reach, forms in by_reach
        ]
    yield list(_along_runs(problem, every))
    single = list(_in_a_run(problem, every[0]))
    if len(single) > 1:
        yield single


@dataclasses.dataclass(frozen=True)
class _Places:
    """Where a carrier is: its kernel's coordinates at the poses that readings see.

    carrier
    at          (N, J, d), or (N, J, c) one of each column
    by_column   whether each column has its coordinate
    """

    carrier: Carrier
    at: Array
    by_column: bool = False

    def forms(self, reaches: Sequence[float]) -> list[tuple[float, Array]]:
        """Each reach with its forms (N, J, c, k)."""
        return [(reach, self._forms(reach)) for reach in reaches]

    def _forms(self, reach: float) -> Array:
        columns = self.carrier.columns
        count = columns.shape[1]
        most = min(MODES, WIDEST // count)
        acting = [np.asarray(columns[:, c].any(axis=1)) for c in range(count)]
        parts: list[Array] = []
        for c in range(count):
            if c > 0 and not self.by_column and (acting[c] == acting[c - 1]).all():
                parts.append(parts[-1])
                continue
            if not acting[c].any():
                parts.append(np.zeros((*self.at.shape[:2], 0)))
                continue
            at = self.at[:, :, c, None] if self.by_column else self.at
            parts.append(_at_rows(acting[c], modes(at[acting[c]], reach, most)))
        width = max(part.shape[2] for part in parts)
        forms = np.zeros((*self.at.shape[:2], count, width))
        for c, part in enumerate(parts):
            forms[:, :, c, : part.shape[2]] = part
        return forms


def _at_rows(rows: Mask, values: Array) -> Array:
    """Values at some rows, zeros at the others."""
    every = np.zeros((len(rows), *values.shape[1:]))
    every[rows] = values
    return every


def _factors(problem: GapProblem) -> Iterator[tuple[str, str, Values, Values, bool]]:
    """What an error over the workspace may come with: name, words, factors, and whether
    these vary with the time.

    The factors are (N, J), common to all joints, and those of joints (N, J), or
    (N, J, nq) one of each.
    """
    direction = known_values(_covariate(problem, "direction"))
    ones = np.ones_like(direction)
    yield "over the workspace", "", ones, ones, False
    sense = _covariate(problem, "motion_sign")
    yield WITH_DIRECTION, f", {WITH_DIRECTION}", direction, sense, False
    for name in ("payload", "feed"):
        factor = _centred(_covariate(problem, name))
        if factor.any():
            yield f"with the {name}", f", with the {name}", factor, factor, False
    for body in sorted({b for s in problem.states for b in s.temperature}):
        rise = _centred(_temperature(problem, body))
        if rise.any():
            words = f", with the temperature of {body}"
            yield words[2:], words, rise, rise, True


def _covariate(problem: GapProblem, name: str) -> Values:
    return carriers.at_poses(problem, [getattr(s, name) for s in problem.states])


def _temperature(problem: GapProblem, body: str) -> Values:
    """Temperature (N, J) of a body; NaN where it was not recorded."""
    values = []
    for state in problem.states:
        unknown = np.full(len(state), np.nan)
        values.append(state.temperature.get(body, unknown))
    return carriers.at_poses(problem, values)


def known_values(values: Array) -> Array:
    """Values, 0 where unknown."""
    return np.where(np.isfinite(values), values, 0.0)


def _centred(values: Array) -> Array:
    """Values about the middle of their span, from -1 to 1; 0 where unknown."""
    known = values[np.isfinite(values)]
    if not known.size or np.ptp(known) <= 1e-9 * np.abs(known).max():
        return np.zeros_like(values)
    middle = 0.5 * (known.min() + known.max())
    return known_values((values - middle) / (0.5 * np.ptp(known)))


def _times(forms: Array, factor: Array) -> Array:
    """Forms (N, J, c, k) times a factor (N, J), or (N, J, c) of each column's own."""
    if factor.ndim == 2:
        factor = factor[:, :, None]
    return forms * factor[..., None]


def _circle(problem: GapProblem) -> Array:
    """Cosine and sine (N, J, 2) of the phase."""
    phase = known_values(_covariate(problem, "phase"))
    return np.stack([np.cos(phase), np.sin(phase)], axis=2)


def _along_runs(problem: GapProblem, every: Sequence[Carrier]) -> Iterator[Term]:
    """Errors along the runs, the same both ways and with the direction."""
    circle = _circle(problem)
    sense = known_values(_covariate(problem, "direction"))
    for carrier in every:
        if carrier.name == JOINTS:
            continue
        for reach, forms in _Places(carrier, circle).forms(REACHES["phase"]):
            both = np.concatenate([forms, _times(forms, sense)], axis=3)
            about = f"an error of {carrier.name} along the runs"
            yield Term(ALONG_RUNS, about, carrier, both, reach)


def _in_a_run(problem: GapProblem, readings: Carrier) -> Iterator[Term]:
    """An error of the readings in one run, a smooth one along it."""
    circle = _circle(problem)
    reach = REACHES["phase"][-1]
    for members in problem.members:
        if len(members) < LEAST:
            continue
        inside = np.zeros(len(problem))
        inside[members] = 1.0
        columns = readings.columns * inside[:, None, None]
        touched = columns.any(axis=(0, 2))
        rows = problem.rows.iloc[int(members[0])]
        label = f"run {rows['setup']} {rows['run']}"
        carrier = Carrier(label, columns[:, touched], (label,) * int(touched.sum()))
        forms = _Places(carrier, circle).forms((reach,))[0][1]
        yield Term(IN_A_RUN, "an error in one run", carrier, forms, 0.0, True)


def modes(places: Array, reach: float, most: int) -> Array:
    """Columns (N, J, k) whose products are Matern's kernel at places (N, J, d).

    As many as hold `WHOLE` of the variance, `most` at most.
    """
    flat = places.reshape(-1, places.shape[-1])
    factor = field_modes(flat, correlation_length=reach, energy_share=WHOLE, count=most)
    return factor.reshape(*places.shape[:2], -1)
