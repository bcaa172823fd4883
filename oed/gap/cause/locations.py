"""Where the gap lies: the posterior's split of its energy over places.

What acts is G beta, with the forms G and the coefficients beta of the diagnosis'
posterior. Calibration leaves z = G beta - H theta of each draw of it, with theta what
the parameters absorb. Its energy is the sum over readings n, or over the columns of
every leg,

    e_n = z_n^2,        e_leg = |z_leg|^2,    z_leg = G_leg beta_leg - H theta_leg.

A place holds its share of the sum. Where all readings, or all legs, have as much, it
has its even share; it stands out where few draws have no more than that.

What acts alike at all times is in no stretch of time, though it may show most while a
set-up that sees it was read: times are places of what varies with time or temperature
alone. What acts alike both ways is in no direction: its energy is compared as if all
readings had been driven one way, and the other, so that even shares are halves. A set-up
is a place of what belongs to set-ups: errors of their readings, bars, mounts.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from msgspec.structs import replace
from scipy import linalg, special

from oed.base import Array, Index, Mask
from oed.effect_model import Effect
from oed.gap.cause.search import Hypothesis
from oed.gap.data.problem import GapProblem, Metric, reversed_runs
from oed.gap.forms import discrepancy
from oed.gap.forms import library as libraries
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw
from oed.result import PlaceRecord


# Energy of what acts in each reading, in draws of the posterior over likely forms.
#
# `ReversedForms` has the columns as if every run had been driven the other way, at the same
# poses.
@dataclasses.dataclass(frozen=True)
class LikelyForms:
    """Forms that what acts may have."""

    share: float  #: posterior probability of these forms
    columns: Array  #: (N, k) with coefficients N(0, 1), in units of the stated noise
    #: (k,) `leg 1`, `set-up bar`, `channel dz in bar` or "", what each column belongs
    #: to
    labels: Sequence[str]
    #: (k,) which columns vary with time or temperature; all by default
    timed: Mask | None = None
    #: (N, k) the columns in runs that are driven the other way; None where that is not
    #: known
    other_way: Array | None = None


@dataclasses.dataclass(frozen=True)
class DrawnEnergy:
    """Energy z^2 of N readings in D draws z of columns (N, k) times coefficients (k, d)."""

    parts: list[tuple[Array, Array]]

    def sums(self, rows: Mask | slice = slice(None)) -> Array:
        """Sum (D,) over some readings, all by default."""
        pairs = [(columns[rows], beta) for columns, beta in self.parts]
        sums = [((c.T @ c @ beta) * beta).sum(axis=0) for c, beta in pairs]
        return np.asarray(np.maximum(np.concatenate(sums), 0.0))

    def mean(self) -> Array:
        """Mean (N,) over the draws."""
        sums = [((c @ (beta @ beta.T)) * c).sum(axis=1) for c, beta in self.parts]
        count = sum(beta.shape[1] for _, beta in self.parts)
        return np.asarray(np.maximum(sum(sums), 0.0) / count)


@dataclasses.dataclass(frozen=True)
class Draws:
    """Energy of what acts, in units of the stated noise, in D draws."""

    timed: DrawnEnergy  #: of what varies with time, before the parameters absorb
    acting: DrawnEnergy
    #: of all that acts, and `acting` with the runs as they were driven; None where the
    #: other way is not known
    other_way: DrawnEnergy | None
    remaining: DrawnEnergy  #: as calibration leaves it
    #: {label: (D,)} of the columns of each label, as calibration leaves them
    parts: dict[str, Array]


def draw_energies(
    problem: GapProblem,
    law: NoiseLaw,
    models: Sequence[LikelyForms],
    rng: np.random.Generator,
    draws: int,
) -> Draws:
    """Draws of which each model has its share."""
    metric = Metric(problem, law)
    shares = np.array([model.share for model in models])
    counts = rng.multinomial(draws, shares / shares.sum())
    drawn = [(model, n) for model, n in zip(models, counts, strict=True) if n]
    names = list(dict.fromkeys(label for model, _ in drawn for label in model.labels))
    timed, acting, other_way, remaining = (DrawnEnergy([]) for _ in range(4))
    parts: dict[str, list[Array]] = {name: [] for name in names}
    for model, n in drawn:
        mean, precision = metric.posterior(model.columns, problem.residual)
        root = linalg.cholesky(precision, lower=True)
        normal = rng.standard_normal((len(mean), n))
        spread = linalg.solve_triangular(root, normal, lower=True, trans="T")
        beta = mean[:, None] + spread
        left = model.columns - problem.slopes @ metric.fit(model.columns)
        of_time = slice(None) if model.timed is None else model.timed
        turned = model.columns if model.other_way is None else model.other_way
        timed.parts.append((model.columns[:, of_time], beta[of_time]))
        acting.parts.append((model.columns, beta))
        other_way.parts.append((turned, beta))
        remaining.parts.append((left, beta))
        labels = np.array(model.labels)
        for name, energies in parts.items():
            own = labels == name
            energies.append(DrawnEnergy([(left[:, own], beta[own])]).sums())
    is_known = all(model.other_way is not None for model, _ in drawn)
    return Draws(
        timed=timed,
        acting=acting,
        other_way=other_way if is_known else None,
        remaining=remaining,
        parts={name: np.concatenate(energies) for name, energies in parts.items()},
    )


class ReversedForms:
    """Columns of effects and of discrepancies in runs that are driven the other way."""

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        effects: Sequence[Effect],
    ) -> None:
        self._problem, self._library, self._processes = problem, library, processes
        self._effects = {effect.name: effect for effect in effects}
        self._known: dict[int, Array] = {}

    def columns(self, h: Hypothesis, factor: float) -> Array | None:
        """Columns (N, k) at sizes times a factor; None if driven one way only."""
        if not self._both_ways:
            return None
        parts = [np.zeros((len(self._problem), 0))]
        for atom, size in zip(h.atoms, h.sizes, strict=True):
            if atom not in self._known:
                self._known[atom] = self._rebuilt(atom)
            parts.append(factor * size * self._known[atom])
        if h.process is not None:
            reversal = self._processes.atoms[h.process].reversal
            size = factor * h.process_size
            columns = self._processes.scaled_columns(h.process, size)
            parts.append(columns if reversal is None else columns * reversal)
        return np.hstack(parts)

    @functools.cached_property
    def _both_ways(self) -> bool:
        rows = self._problem.rows
        if "direction" not in rows.columns:
            return False
        direction = rows["direction"].to_numpy(dtype=float)
        return bool((direction > 0.0).any() and (direction < 0.0).any())

    def _rebuilt(self, atom: int) -> Array:
        form = self._library.atoms[atom]
        effect = self._effects[form.effect]
        fixed = {name: (value,) for name, value in form.constants.items()}
        alone = dataclasses.replace(effect, constants=fixed)
        library = libraries.build(self._reversed, [alone])
        number_of = {name: k for k, name in enumerate(library.names)}
        columns = np.zeros((len(self._problem), len(form.columns)))
        for k, column in enumerate(form.columns):
            name = self._library.names[column]
            if name in number_of:
                number = np.array([number_of[name]])
                columns[:, k] = library.columns.take(number)[:, 0]
        return columns

    @functools.cached_property
    def _reversed(self) -> GapProblem:
        """The readings with the order of each run counted from its end."""
        rows = self._problem.covariates
        other_way = reversed_runs(rows).assign(direction=-rows["direction"])
        return self._problem.with_covariates(other_way)


N_CELLS = 48  #: cells of the session that stretches of time are made of
N_SECTORS = 12  #: sectors of the phase that stretches of runs are made of
MIN_PHASES = 8  #: places that a run must have for its phase to mean something
STANDING_OUT = 0.05  #: p-value below which a location stands out
#: departure of a direction's share from a half that is none: which way a joint arrives at
#: the ends of a run is not known of runs that were driven the other way
EVEN_TOLERANCE = 0.05
#: share of the readings of two locations that both have, from which they are the same
SAME_SHARE = 0.9
STILL_SHARE = 1e-3  #: share of a joint's extent by which it is off its middle position
MIN_CONFINEMENT = 0.1  #: nats by which a stretch must confine the gap to be reported


def locate(
    problem: GapProblem,
    law: NoiseLaw,
    models: Sequence[LikelyForms],
    rng: np.random.Generator,
    draws: int = 400,
) -> tuple[PlaceRecord, ...]:
    """Places of the gap: those that stand out, and confine it best, first.

    All legs, or set-ups, that a form has columns of; the best runs; one stretch of the
    session and one of the phase; both directions. `p_value` is the posterior
    probability that the place holds no more than its even share, `strength` its mean
    share.
    """
    drawn = draw_energies(problem, law, models, rng, draws)
    readings = _readings_of_places(problem)
    places = [
        *_labelled(problem, drawn),
        *_runs(readings, drawn),
        *_stretch_of_time(problem, drawn),
        *_stretch_of_phase(problem, drawn),
        *_directions(problem, drawn),
    ]
    ranked = sorted(places, key=_rank)
    return tuple(_add_same_readings(problem, location, readings) for location in ranked)


# -- places ----------------------------------------------------------------------------
@dataclasses.dataclass(frozen=True, slots=True)
class _Place:
    """A place as reported, its mean share of the gap, its even share, its readings (N,)."""

    block: PlaceRecord
    share: float
    even: float
    readings: Mask | None = None

    @property
    def confines(self) -> float:
        """Nats by which the gap is confined: of its share, relative to the even one."""
        share, even = self.share, self.even
        inside = special.rel_entr(share, even)
        return float(inside + special.rel_entr(1.0 - share, 1.0 - even))


def _rank(location: _Place) -> tuple[bool, float, float, str]:
    """Places that stand out, by how well they confine; others by p-value, then name."""
    name, p_value = location.block.block, location.block.p_value
    if p_value < STANDING_OUT:
        return False, -location.confines, p_value, name
    return True, p_value, 0.0, name


def _place(name: str, energy: Array, total: Array, even: float) -> _Place:
    """A place with energies (D,) of a total (D,), and its even share."""
    share = energy / np.maximum(total, 1e-300)
    p_value = (1.0 + np.sum(share <= even)) / (len(share) + 1.0)
    mean = float(share.mean())
    return _Place(PlaceRecord(name, float(p_value), mean), mean, even)


def _labelled(problem: GapProblem, drawn: Draws) -> Iterator[_Place]:
    """Legs and set-ups by their columns, of what has columns of legs or set-ups."""
    legs = [f"leg {i + 1}" for i in problem.states[0].limbs]
    by_leg = {leg: (leg, 1.0 / len(legs)) for leg in legs}
    by_setup = {}
    rows = problem.rows
    shares = rows["setup"].value_counts(normalize=True)
    for setup, channel in rows[["setup", "channel"]].drop_duplicates().to_numpy():
        location = f"set-up {setup}", float(shares[setup])
        by_setup[location[0]] = by_setup[f"channel {channel} in {setup}"] = location
    for by_label in (by_leg, by_setup):
        energies: dict[tuple[str, float], Array] = {}
        for label in by_label.keys() & drawn.parts.keys():
            energy = energies.get(by_label[label], np.zeros(1))
            energies[by_label[label]] = energy + drawn.parts[label]
        total = sum(energies.values(), np.zeros(1))
        if len(set(by_label.values())) > 1:
            for (name, even), energy in energies.items():
                yield _place(name, energy, total, even)


def _location_of_readings(name: str, inside: Mask, energy: DrawnEnergy) -> _Place:
    """A place that holds some readings (N,), by the energy of all."""
    even = float(inside.mean())
    location = _place(name, energy.sums(inside), energy.sums(), even)
    return dataclasses.replace(location, readings=inside)


def _runs(readings: Mapping[str, Mask], drawn: Draws) -> list[_Place]:
    """The run that has most, and others that stand out."""
    runs = [name for name in readings if name.startswith("run ")]
    if len(runs) < 2:
        return []
    places = [
        _location_of_readings(name, readings[name], drawn.remaining) for name in runs
    ]
    places.sort(key=_rank)
    clear = [p for p in places[1:4] if p.block.p_value < STANDING_OUT]
    return [places[0], *clear]


def _times(problem: GapProblem) -> Array:
    """Time (N,) of each reading; NaN where it is not known."""
    times = problem.rows.get("time", default=np.full(len(problem), np.nan))
    return np.asarray(times, dtype=float)


def _stretch_of_time(problem: GapProblem, drawn: Draws) -> Iterator[_Place]:
    """The stretch of the session that is densest in what acts."""
    times = _times(problem)
    timed = np.flatnonzero(np.isfinite(times))
    cells = np.array_split(np.unique(times[timed]), N_CELLS)
    starts = np.array([cell[0] for cell in cells if len(cell)])
    energy = drawn.timed.mean()
    if len(starts) < 2 or not energy.any():
        return
    number = np.searchsorted(starts, times[timed], side="right") - 1
    cells_inside = _densest(number, energy[timed], len(starts))
    inside = np.zeros(len(times), dtype=bool)
    inside[timed] = np.isin(number, cells_inside)
    name = f"time {_extent(times, times[inside])}"
    stretch = _location_of_readings(name, inside, drawn.timed)
    if stretch.confines > MIN_CONFINEMENT:
        yield stretch


def _add_same_readings(
    problem: GapProblem, location: _Place, readings: Mapping[str, Mask]
) -> PlaceRecord:
    """The place with one of another kind that has the same readings, if any.

    readings  (N,) those of each set-up, run and leg by its name

    A set-up that was read in one stretch of the session is that stretch as well, one that
    was read in one run is that run, and a leg that moved in one run alone is that run.
    """
    block = location.block
    inside = readings.get(block.block, location.readings)
    if inside is None or inside.all():
        return block
    kind = block.block.partition(" ")[0]
    for name, others in readings.items():
        is_same = (inside & others).sum() >= SAME_SHARE * (inside | others).sum()
        if name.partition(" ")[0] != kind and is_same:
            return replace(block, same_as=name)
    times = _times(problem)
    if kind == "time" or not np.isfinite(times).all():
        return block
    within, outside = times[inside], times[~inside]
    if ((outside >= within.min()) & (outside <= within.max())).any():
        return block
    return replace(block, same_as=f"time {_extent(times, within)}")


def _readings_of_places(problem: GapProblem) -> dict[str, Mask]:
    """Readings (N,) of each set-up, run and leg by its name.

    Those of a leg are those off its middle position: a constant error of the leg is one
    of the geometry.
    """
    setup, run = problem.rows["setup"].to_numpy(), problem.rows["run"].astype(str)
    masks = {f"set-up {name}": np.asarray(setup == name) for name in np.unique(setup)}
    first = [members[0] for members in problem.members]
    names = run.iloc[first]
    ambiguous = names.duplicated(keep=False)
    prefix = problem.rows["setup"].iloc[first].astype(str) + " "
    names = "run " + prefix.where(ambiguous, "") + names
    for name, members in zip(names, problem.members, strict=True):
        masks[name] = np.isin(np.arange(len(problem)), members)
    driven = [state.joints for state in problem.states]
    joints = discrepancy.values_of_poses(problem, driven)[:, 0]
    off = np.abs(joints - np.median(joints, axis=0))
    moved = off > STILL_SHARE * np.ptp(joints, axis=0)
    return masks | {f"leg {i + 1}": moved[:, i] for i in problem.states[0].limbs}


def _extent(times: Array, inside: Array) -> str:
    """`A-B` of some times (n,) among all (N,), to halfway to those before and after."""
    first, last = inside.min(), inside.max()
    before, after = times[times < first], times[times > last]
    begin = 0.5 * (first + before.max()) if before.size else first
    end = 0.5 * (last + after.min()) if after.size else last
    return "-".join(f"{value:.1f}".removesuffix(".0") for value in (begin, end))


def _stretch_of_phase(problem: GapProblem, drawn: Draws) -> Iterator[_Place]:
    """The part of all runs that is densest in what acts."""
    phase = problem.rows["phase"].to_numpy(dtype=float)
    long = [
        m for m in problem.members if len(np.unique(phase[m].round(9))) >= MIN_PHASES
    ]
    if not long:
        return
    rows = np.concatenate(long)
    number = (phase[rows] / (2.0 * np.pi) * N_SECTORS).astype(int) % N_SECTORS
    energy = drawn.remaining.mean()[rows]
    cells = _densest(number, energy, N_SECTORS, around=True)
    begin, end = 360 * cells[0] // N_SECTORS, 360 * (cells[-1] + 1) // N_SECTORS
    inside = np.isin(np.arange(len(phase)), rows[np.isin(number, cells)])
    stretch = _location_of_readings(f"phase {begin}-{end}", inside, drawn.remaining)
    if stretch.confines > MIN_CONFINEMENT:
        yield stretch


def _directions(problem: GapProblem, drawn: Draws) -> Iterator[_Place]:
    """Both directions, by what acts in all readings as if driven one way alone."""
    if drawn.other_way is None:  # as where runs were driven one way alone
        return
    forward = np.sign(problem.rows["direction"].to_numpy(dtype=float))
    energy = {}
    for sign in (1, -1):
        energy[sign] = drawn.acting.sums(forward == sign)
        energy[sign] += drawn.other_way.sums(forward == -sign)
    total = energy[1] + energy[-1]
    for sign, amount in energy.items():
        even = np.abs(amount - 0.5 * total) <= EVEN_TOLERANCE * total
        rounded = np.where(even, 0.5 * total, amount)
        yield _place(f"direction {sign:+d}", rounded, total, 0.5)


def _densest(number: Index, energy: Array, count: int, around: bool = False) -> Index:
    """Cells, one beside the other, in which the mean energy is highest beyond chance.

    number    (n,) cell of each reading
    energy    (n,) mean of each
    around    whether the last cell is beside the first; then up to half of them count

    The scan statistic of Kulldorff (1997), of densities inside and outside.
    """
    readings = np.bincount(number, minlength=count)
    amount = np.bincount(number, energy, minlength=count)
    repeated = 2 if around else 1
    n = np.concatenate([[0.0], np.cumsum(np.tile(readings, repeated))])
    e = np.concatenate([[0.0], np.cumsum(np.tile(amount, repeated))])
    longest = count // 2 if around else count - 1
    first, length = np.mgrid[0:count, 1 : longest + 1]
    allowed = around | (first + length <= count)
    first, length = first[allowed], length[allowed]
    inside = n[first + length] - n[first], e[first + length] - e[first]
    outside = readings.sum() - inside[0], amount.sum() - inside[1]
    gain = _times_log_density(*inside) + _times_log_density(*outside)
    denser = inside[1] * outside[0] > outside[1] * inside[0]
    best = int(np.argmax(np.where(denser, gain, -np.inf)))
    return np.asarray((first[best] + np.arange(length[best])) % count)


def _times_log_density(count: Array, energy: Array) -> Array:
    """energy log(energy / count), 0 where there is none."""
    least = 1e-300
    return energy * np.log(np.maximum(energy, least) / np.maximum(count, 1))
