"""The discrepancy: what acts in no form of the library, as Gaussian processes.

Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464: what a model leaves is a random
function of what the machine does. It is carried by the readings, by the tool's place or
by each joint; it varies over the session, the workspace or the run; it may come with the
direction of motion, the payload, the feed or a temperature. Each such term has Matern's
kernel at a few reaches, which the evidence sums over (`oed.base.field_modes`).
"""

import dataclasses
import math
from collections.abc import Iterator, Sequence

import numpy as np

from oed.base import Array, Index, field_modes
from oed.gap.data.columns import Block, Columns
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import ALONE_SHARE, Atom, Library
from oed.measurement import Series

# Carriers of a discrepancy: a channel's reading, a joint, the tool's place.
#
# A carrier is the change of the readings per unit of a form at each pose that they see.
# Its unit changes the readings by about their noise, whatever the machine's size.

#: names of the carriers whose columns are the joints and the channels' readings
JOINTS = "the joints"
READINGS = "the readings"


@dataclasses.dataclass(frozen=True)
class Carrier:
    """What a discrepancy acts on."""

    name: str  #: in words
    #: (N, c, J) change of the readings, in units of the noise; J are the poses that a
    #: reading sees
    columns: Array
    #: (c,) the block of each of its columns; "" where they belong together
    labels: tuple[str, ...]

    @property
    def separable(self) -> bool:
        """Whether one of its columns may act without the others."""
        return len(self.labels) > 1 and all(self.labels)

    def parts(self) -> "list[Carrier]":
        """Each of its columns alone, or all of them where they belong together."""
        if not self.separable:
            return [self]
        return [
            Carrier(part_in_words(label), self.columns[:, k, None], (label,))
            for k, label in enumerate(self.labels)
        ]


def part_in_words(label: str) -> str:
    """A part of a carrier by its label."""
    return label.replace("channel ", f"{READINGS} of ")


def carriers_of(problem: GapProblem) -> tuple[Carrier, ...]:
    """The readings, the joints, the tool's place, and the tool along its own axis, as of
    a spindle that warms.
    """
    slopes, states = _joint_slopes(problem), problem.states
    pushing = values_of_poses(problem, [s.joints_per_displacement for s in states])
    growth = values_of_poses(problem, [s.joints_per_extension for s in states])
    place = np.einsum("nqj,njqk->nkj", slopes, pushing)
    length = np.einsum("nqj,njq->nj", slopes, growth)[:, None]
    legs = tuple(f"leg {i + 1}" for i in states[0].limbs)
    return (
        readings(problem),
        Carrier(JOINTS, _scaled(slopes), legs),
        Carrier("the tool", _scaled(place), ("", "", "")),
        Carrier("the tool's length", _scaled(length), ("",)),
    )


def readings(problem: GapProblem, *, by_setup: bool = True) -> Carrier:
    """The readings of each channel, in each set-up, whose instruments err by themselves,
    or in all set-ups alike.
    """
    rows = problem.rows
    kinds = rows["channel"] + " in " + rows["setup"] if by_setup else rows["channel"]
    names, owner = np.unique(kinds.to_numpy(dtype=str), return_inverse=True)
    columns = np.zeros((len(problem), len(names), _most_poses(problem)))
    columns[np.arange(len(problem)), owner, 0] = 1.0
    labels = tuple(f"channel {name}" for name in names)
    return Carrier(READINGS, columns, labels)


def _scaled(columns: Array) -> Array:
    """Columns (N, c, J) with a root mean square of 1 on average."""
    mean_square = float((columns**2).sum(axis=2).mean())
    return np.asarray(columns / math.sqrt(mean_square)) if mean_square else columns


def _joint_slopes(problem: GapProblem) -> Array:
    """Slopes (N, nq, J) of the readings over the joints, over the noise, per SI unit."""
    parts = []
    most = _most_poses(problem)
    for series, response in zip(problem.series, problem.responses, strict=True):
        at_pose = response.joints
        count, width = at_pose[0][..., 0].size, at_pose[0].shape[-1]
        part = np.zeros((count, width, most))
        for k, j in enumerate(_moving_poses(series)):
            part[:, :, k] = at_pose[j].reshape(count, -1)
        parts.append(part)
    return problem.noise_units(np.concatenate(parts))


def values_of_poses(problem: GapProblem, values: Sequence[Array]) -> Array:
    """Values (m, ...) at the poses of each series, as the readings see them (N, J, ...).

    First comes the pose read, then what it is read against. The last repeats where a
    reading sees fewer poses than others.
    """
    parts = []
    most = _most_poses(problem)
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
    """Columns of its index that are no taught pose, which all readings share."""
    places = enumerate(series.index.T)
    return [j for j, coordinate in places if j == 0 or len(np.unique(coordinate)) > 1]


def _most_poses(problem: GapProblem) -> int:
    return max(len(_moving_poses(series)) for series in problem.series)


#: reaches of the kernels: over the session and the travels, from -1 to 1, and over the
#: unit circle of the phase
REACHES = {"time": (0.2, 1.0), "place": (0.3, 1.0), "phase": (0.3, 1.0)}
VARIANCE_SHARE = 0.98  #: share of its variance that a term's columns have
MAX_MODES = 36  #: columns of a term on one part of its carrier, at most
MAX_COLUMNS = 72  #: most columns of a term, those of all parts of its carrier together
MIN_RUN_READINGS = 8  #: readings that a run must have to be a term by itself

OVER_TIME = "over time"  #: kind of what varies over the session
OVER_WORKSPACE = "over the workspace"  #: kind of what depends on the pose alone
IN_A_RUN = "in a run"  #: kind of what acts in one run alone
ALONG_RUNS = "along the runs"  #: kind of what acts along all runs
WITH_DIRECTION = "with the direction"  #: kind of what acts with the direction of runs

#: covariate that a listed effect of each kind needs first
CONDITIONS = {
    OVER_TIME: "time",
    OVER_WORKSPACE: "",
    WITH_DIRECTION: "direction",
    "with the payload": "payload",
    "with the feed": "feed",
}

#: values (N, J) or (N, J, d) of a coordinate or a factor at the poses readings see
Values = Array


@dataclasses.dataclass(frozen=True, eq=False)
class TermPart:
    """Columns of one term on one column of its carrier."""

    column: int  #: number of the carrier's column
    block: Block  #: the columns
    sign: float = 1.0  #: of the columns driven the other way


@dataclasses.dataclass(frozen=True)
class Term:
    """One kind of discrepancy at one reach."""

    name: str  #: of the kind: what it comes with
    about: str  #: in words
    carrier: Carrier  #: what it acts on
    #: on each of the carrier's columns; terms may have parts in common
    parts: tuple[TermPart, ...]
    reach: float  #: of its kernel
    timed: bool = False  #: whether it varies with the time or a temperature

    @property
    def is_visible(self) -> bool:
        """Whether it changes a reading."""
        blocks = [part.block for part in self.parts]
        return any(bool(b.weights.any() and b.values.any()) for b in blocks)

    def beside(self, other: "Term", about: str) -> "Term":
        """The parts of two terms on the same carrier together."""
        parts = sorted([*self.parts, *other.parts], key=lambda part: part.column)
        return dataclasses.replace(self, about=about, parts=tuple(parts))


def log_shares(discrepancy: Library, listed: Library) -> Array:
    """Log prior probability (atoms,) of the kind of each atom of a discrepancy.

    What no list has comes under the conditions under which listed effects come: a kind
    has one more than their number (Laplace's rule of succession).
    """
    counts = {kind: 1 for kind in discrepancy.effects}
    for kind in counts.keys() & CONDITIONS.keys():
        counts[kind] += listed.by_condition.get(CONDITIONS[kind], 0)
    total = sum(counts.values())
    return np.log([counts[atom.effect] / total for atom in discrepancy.atoms])


def build(problem: GapProblem) -> Library:
    """The discrepancy's terms as atoms, with their prior probability within a kind."""
    atoms: list[Atom] = []
    labels: list[str] = []
    columns_of: dict[TermPart, Index] = {}
    for kind in _terms_by_kind(problem):
        visible = [term for term in kind if term.is_visible]
        for term in visible:
            constants = {"reach": term.reach} if term.reach else {}
            for part in term.parts:
                if part not in columns_of:
                    width = part.block.width
                    columns_of[part] = len(labels) + np.arange(width)
                    labels += [term.carrier.labels[part.column]] * width
            widths = [part.block.width for part in term.parts]
            owner = np.repeat([part.column for part in term.parts], widths)
            reversal = np.repeat([part.sign for part in term.parts], widths)
            numbers = np.concatenate([columns_of[part] for part in term.parts])
            for choice, share in _choices(term.carrier, owner):
                log_weight = math.log(share) - math.log(len(visible))
                form = numbers[choice], log_weight, term.about, term.timed
                atoms.append(Atom(term.name, constants, *form, reversal[choice]))
    blocks = [part.block for part in columns_of]
    return Library(Columns(len(problem), blocks), tuple(atoms), tuple(labels))


def _choices(carrier: Carrier, owner: Index) -> list[tuple[Index, float]]:
    """Columns of all parts of a carrier together and of each alone, with shares."""
    everything = np.arange(len(owner), dtype=np.intp)
    parts = len(carrier.labels)
    if not carrier.separable:
        return [(everything, 1.0)]
    single = [np.flatnonzero(owner == c) for c in range(parts)]
    return [
        (everything, 1.0 - ALONE_SHARE),
        *((part, ALONE_SHARE / parts) for part in single),
    ]


def _terms_by_kind(problem: GapProblem) -> Iterator[list[Term]]:
    """The terms of each kind that these readings can have."""
    every = carriers_of(problem)
    session = 2.0 * _covariate(problem, "session_progress") - 1.0
    travel = _covariate(problem, "travel")
    over_session = [_Places(c, session[:, :, None]) for c in every]
    over_workspace = [_Places(c, travel, by_column=c.name == JOINTS) for c in every]
    yield [
        Term(OVER_TIME, f"drift of {p.carrier.name}", p.carrier, parts, reach, True)
        for p in over_session
        for reach, parts in p.parts(REACHES["time"])
    ]
    steady: list[Term] = []
    for name, ending, common, by_joint, timed in _factors(problem):
        sign = -1.0 if name == WITH_DIRECTION else 1.0
        terms = [
            Term(
                name,
                f"an error of {p.carrier.name} over the workspace{ending}",
                p.carrier,
                parts,
                reach,
                timed,
            )
            for p in over_workspace
            for reach, parts in p.parts(
                REACHES["place"], by_joint if p.by_column else common, sign
            )
        ]
        steady = steady or terms
        yield _with_both_ways(terms, steady) if name == WITH_DIRECTION else terms
    yield list(_run_terms(problem, every))
    single = list(_single_run_terms(problem, every[0]))
    if len(single) > 1:
        yield single


class _Places:
    """Where a carrier is: its kernel's coordinates at the poses that readings see."""

    def __init__(self, carrier: Carrier, at: Array, by_column: bool = False) -> None:
        """Coordinates (N, J, d), or (N, J, c) one of each column if `by_column`."""
        self.carrier, self.by_column, self._at = carrier, by_column, at
        self._modes: dict[float, list[Array]] = {}

    def parts(
        self, reaches: Sequence[float], factor: Array | None = None, sign: float = 1.0
    ) -> list[tuple[float, tuple[TermPart, ...]]]:
        """Each reach with its forms, times a factor (N, J), or (N, J, c) of each column.

        sign  of the forms driven the other way
        """
        weights = self.carrier.columns
        if factor is not None:
            by_column = factor[:, None] if factor.ndim == 2 else factor.swapaxes(1, 2)
            weights = weights * by_column
        results = []
        for reach in reaches:
            if reach not in self._modes:
                forms = list(self._forms(reach))
                width = max(form.shape[2] for form in forms)
                # parts as wide as one another: terms are compared by their width
                pads = [((0, 0), (0, 0), (0, width - f.shape[2])) for f in forms]
                pairs = zip(forms, pads, strict=True)
                self._modes[reach] = [np.pad(f, p) if p[2][1] else f for f, p in pairs]
            parts = tuple(
                TermPart(c, Block(weights[:, c], modes), sign)
                for c, modes in enumerate(self._modes[reach])
            )
            results.append((reach, parts))
        return results

    def _forms(self, reach: float) -> Iterator[Array]:
        """Modes (N, J, k) on each of the carrier's columns, which may share them."""
        columns = self.carrier.columns
        count = columns.shape[1]
        most = min(MAX_MODES, MAX_COLUMNS // count)
        acting = [np.asarray(columns[:, c].any(axis=1)) for c in range(count)]
        form = np.zeros((0, 0, 1))
        for c, rows in enumerate(acting):
            if c == 0 or self.by_column or (rows != acting[c - 1]).any():
                values = np.zeros((0, columns.shape[2], 1))
                if rows.any():
                    at = self._at[:, :, c, None] if self.by_column else self._at
                    values = modes(at[rows], reach, most)
                form = np.zeros((len(rows), *values.shape[1:]))
                form[rows] = values
            yield form


def _with_both_ways(terms: Sequence[Term], steady: Sequence[Term]) -> list[Term]:
    """Terms that turn with the direction, and errors that differ each way."""
    results = []
    for term, alike in zip(terms, steady, strict=True):
        if not term.is_visible:  # no direction is known
            continue
        about = f"an error of {term.carrier.name} over the workspace"
        both = alike.beside(term, f"{about}, different each way")
        results += [term, dataclasses.replace(both, name=term.name)]
    return results


def _factors(problem: GapProblem) -> Iterator[tuple[str, str, Values, Values, bool]]:
    """What an error over the workspace may come with: name, words, factors, and whether
    these vary with the time.

    The factors are (N, J), common to all joints, and those of joints (N, J), or
    (N, J, nq) one of each.
    """
    direction = known_values(_covariate(problem, "direction"))
    ones = np.ones_like(direction)
    yield OVER_WORKSPACE, "", ones, ones, False
    sense = _covariate(problem, "motion_sign")
    yield WITH_DIRECTION, f", {WITH_DIRECTION}", direction, sense, False
    for name in ("payload", "feed"):
        factor = _centred(_covariate(problem, name))
        if factor.any():
            yield f"with the {name}", f", with the {name}", factor, factor, False
    for body in sorted({b for s in problem.states for b in s.temperature}):
        read = [
            s.temperature.get(body, np.full(len(s), np.nan)) for s in problem.states
        ]
        rise = _centred(values_of_poses(problem, read))
        if rise.any():
            ending = f", with the temperature of {body}"
            yield ending[2:], ending, rise, rise, True


def _covariate(problem: GapProblem, name: str) -> Values:
    return values_of_poses(problem, [getattr(s, name) for s in problem.states])


def known_values(values: Array) -> Array:
    """Values, 0 where unknown."""
    return np.where(np.isfinite(values), values, 0.0)


def _centred(values: Array) -> Array:
    """Values about the middle of their span, from -1 to 1; 0 where unknown."""
    finite = values[np.isfinite(values)]
    if not finite.size or np.ptp(finite) <= 1e-9 * np.abs(finite).max():
        return np.zeros_like(values)
    middle = 0.5 * (finite.min() + finite.max())
    return known_values((values - middle) / (0.5 * np.ptp(finite)))


def _circle(problem: GapProblem) -> Array:
    """Cosine and sine (N, J, 2) of the phase."""
    phase = known_values(_covariate(problem, "phase"))
    return np.stack([np.cos(phase), np.sin(phase)], axis=2)


def _run_terms(problem: GapProblem, every: Sequence[Carrier]) -> Iterator[Term]:
    """Errors along the runs, the same both ways and with the direction."""
    circle = _circle(problem)
    sense = known_values(_covariate(problem, "direction"))
    for carrier in every:
        if carrier.name == JOINTS:
            continue
        about = f"an error of {carrier.name} along the runs"
        places = _Places(carrier, circle)
        reaches = REACHES["phase"]
        turned = places.parts(reaches, sense, sign=-1.0)
        for (reach, parts), (_, others) in zip(
            places.parts(reaches), turned, strict=True
        ):
            alike = Term(ALONG_RUNS, about, carrier, parts, reach)
            yield alike.beside(Term(ALONG_RUNS, about, carrier, others, reach), about)


def _single_run_terms(problem: GapProblem, readings: Carrier) -> Iterator[Term]:
    """An error of the readings in one run, a smooth one along it."""
    circle = _circle(problem)
    reach = REACHES["phase"][-1]
    for members in problem.members:
        if len(members) < MIN_RUN_READINGS:
            continue
        inside = np.zeros(len(problem))
        inside[members] = 1.0
        columns = readings.columns * inside[:, None, None]
        touched = columns.any(axis=(0, 2))
        rows = problem.rows.iloc[int(members[0])]
        label = f"run {rows['setup']} {rows['run']}"
        carrier = Carrier(label, columns[:, touched], (label,) * int(touched.sum()))
        parts = _Places(carrier, circle).parts((reach,))[0][1]
        yield Term(IN_A_RUN, "an error in one run", carrier, parts, 0.0, True)


def modes(places: Array, reach: float, most: int) -> Array:
    """Columns (N, J, k), `most` at most, of Matern's kernel at places (N, J, d)."""
    flat = places.reshape(-1, places.shape[-1])
    factor = field_modes(
        flat, correlation_length=reach, energy_share=VARIANCE_SHARE, count=most
    )
    return factor.reshape(*places.shape[:2], -1)
