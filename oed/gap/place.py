"""Where the gap lies: the posterior's split of its energy over places.

What acts is G beta, with the forms G and the coefficients beta of the diagnosis'
posterior. Calibration leaves z = G beta - H theta of each draw of it, with theta what
the parameters absorb. Its energy is the sum over readings n, or over the columns of
every leg,

    e_n = z_n^2,        e_leg = |z_leg|^2,    z_leg = G_leg beta_leg - H theta_leg.

A place holds its share of the sum. Where all readings, or all legs, have as much, it
has its even share; it stands out where few draws have no more than that.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from scipy import linalg, special

from oed.arrays import Array, Index
from oed.gap.data.diagnosis import Block
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw

#: draws of the posterior
DRAWS = 400
#: cells of the session and of the phase that stretches are made of
CELLS, SECTORS = 48, 12
#: places that a run must have for its phase to mean something
PLACES = 8
#: runs that are reported; beyond the first only those that stand out
RUNS, STANDS_OUT = 4, 0.05
#: nats by which a stretch must confine the gap to be reported
WORTH = 0.1


@dataclasses.dataclass(frozen=True)
class LikelyForms:
    """Forms that what acts may have.

    share      posterior probability of these forms
    columns    (N, k) with coefficients N(0, 1), in units of the stated noise
    labels     (k,) `leg 1`, `set-up bar` or "", what each column belongs to
    """

    share: float
    columns: Array
    labels: Sequence[str]


@dataclasses.dataclass(frozen=True)
class _Draws:
    """Energy of what acts, in units of the stated noise, in D draws.

    acting       (N, D) in each reading, before the parameters absorb
    remaining    (N, D) as calibration leaves it
    parts        {label: (D,)} of the columns of each label, as calibration leaves them
    """

    acting: Array
    remaining: Array
    parts: dict[str, Array]


def locate(
    problem: GapProblem,
    law: NoiseLaw,
    models: Sequence[LikelyForms],
    rng: np.random.Generator,
    draws: int = DRAWS,
) -> tuple[Block, ...]:
    """Places of the gap: those that stand out, and confine it best, first.

    All legs, or set-ups, that a form has columns of; the best runs; one stretch of the
    session and one of the phase; both directions. `p_value` is the posterior
    probability that the place holds no more than its even share, `strength` its mean
    share.
    """
    drawn = _draw(problem, law, models, rng, draws)
    places = [
        *_labelled(problem, drawn),
        *_runs(problem, drawn),
        *_stretch_of_time(problem, drawn),
        *_stretch_of_phase(problem, drawn),
        *_directions(problem, drawn),
    ]
    return tuple(place.block for place in sorted(places, key=_rank))


# -- the posterior ---------------------------------------------------------------------


def _draw(
    problem: GapProblem,
    law: NoiseLaw,
    models: Sequence[LikelyForms],
    rng: np.random.Generator,
    draws: int,
) -> _Draws:
    metric = Metric(problem, law)
    shares = np.array([model.share for model in models])
    counts = rng.multinomial(draws, shares / shares.sum())
    drawn = [
        _of_model(problem, metric, model, rng.standard_normal((len(model.labels), n)))
        for model, n in zip(models, counts, strict=True)
        if n
    ]
    labels = dict.fromkeys(label for part in drawn for label in part.parts)
    return _Draws(
        acting=np.hstack([part.acting for part in drawn]),
        remaining=np.hstack([part.remaining for part in drawn]),
        parts={
            label: np.concatenate(
                [
                    part.parts.get(label, np.zeros(part.remaining.shape[1]))
                    for part in drawn
                ]
            )
            for label in labels
        },
    )


def _of_model(
    problem: GapProblem, metric: Metric, model: LikelyForms, normal: Array
) -> _Draws:
    """Draws of one model from standard normal values (k, D)."""
    columns = model.columns
    precision = metric.gram(columns, columns) + np.eye(columns.shape[1])
    b = metric.gram(columns, problem.residual[:, None])
    root = linalg.cholesky(precision, lower=True)
    spread = linalg.solve_triangular(root, normal, lower=True, trans="T")
    beta = linalg.cho_solve((root, True), b) + spread
    remaining = columns - problem.slopes @ metric.fit(columns)
    labels = np.array(model.labels)
    parts = {}
    for label in dict.fromkeys(model.labels):
        at = labels == label
        parts[label] = np.sum((remaining[:, at] @ beta[at]) ** 2, axis=0)
    return _Draws((columns @ beta) ** 2, (remaining @ beta) ** 2, parts)


# -- places ----------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True)
class _Place:
    """A place as reported, and its even share."""

    block: Block
    even: float

    @property
    def confines(self) -> float:
        """Nats by which the gap is confined: of its share, relative to the even one."""
        held, even = self.block.strength, self.even
        inside = special.rel_entr(held, even)
        return float(inside + special.rel_entr(1.0 - held, 1.0 - even))


def _rank(place: _Place) -> tuple[bool, float, float]:
    """Places that stand out come first, by how well they confine; others by p-value."""
    p_value = place.block.p_value
    if p_value < STANDS_OUT:
        return False, -place.confines, p_value
    return True, p_value, 0.0


def _place(name: str, energy: Array, total: Array, even: float) -> _Place:
    """A place with energies (D,) of a total (D,), and its even share."""
    share = energy / np.maximum(total, 1e-300)
    p_value = (1.0 + np.sum(share <= even)) / (len(share) + 1.0)
    return _Place(Block(name, float(p_value), float(share.mean())), even)


def _labelled(problem: GapProblem, drawn: _Draws) -> Iterator[_Place]:
    """Legs and set-ups by their columns, of what has columns of legs or set-ups."""
    setups = problem.rows["setup"].nunique()
    for kind, count in (("leg", len(problem.states[0].limbs)), ("set-up", setups)):
        labels = [label for label in drawn.parts if label.startswith(f"{kind} ")]
        total = sum((drawn.parts[label] for label in labels), np.zeros(1))
        if count > 1:
            for label in labels:
                yield _place(label, drawn.parts[label], total, 1.0 / count)


def _of_readings(name: str, rows: Index, energy: Array) -> _Place:
    """A place that holds some readings, by the energy (N, D) of all."""
    total = energy.sum(axis=0)
    return _place(name, energy[rows].sum(axis=0), total, len(rows) / len(energy))


def _runs(problem: GapProblem, drawn: _Draws) -> list[_Place]:
    if len(problem.members) < 2:
        return []
    names = zip(_run_names(problem), problem.members, strict=True)
    places = [_of_readings(name, rows, drawn.remaining) for name, rows in names]
    places.sort(key=_rank)
    clear = [p for p in places[1:RUNS] if p.block.p_value < STANDS_OUT]
    return [places[0], *clear]


def _run_names(problem: GapProblem) -> list[str]:
    first = [members[0] for members in problem.members]
    labels = problem.rows[["setup", "run"]].iloc[first].astype(str)
    ambiguous = labels["run"].duplicated(keep=False)
    setup = (labels["setup"] + " ").where(ambiguous, "")
    return list("run " + setup + labels["run"])


def _stretch_of_time(problem: GapProblem, drawn: _Draws) -> Iterator[_Place]:
    """The stretch of the session that is densest in what acts.

    It ends halfway between its readings and those beside it.
    """
    if "time" not in problem.rows.columns:
        return
    times = problem.rows["time"].to_numpy(dtype=float)
    known = np.flatnonzero(np.isfinite(times))
    cells = np.array_split(np.unique(times[known]), CELLS)
    starts = np.array([cell[0] for cell in cells if len(cell)])
    if len(starts) < 2:
        return
    number = np.searchsorted(starts, times[known], side="right") - 1
    inside = np.isin(number, _densest(number, drawn.acting[known], len(starts)))
    rows = known[inside]
    first, last = times[rows].min(), times[rows].max()
    before, after = times[times < first], times[times > last]
    begin = 0.5 * (first + before.max()) if before.size else first
    end = 0.5 * (last + after.min()) if after.size else last
    name = f"time {_number(begin)}-{_number(end)}"
    stretch = _of_readings(name, rows, drawn.acting)
    if stretch.confines > WORTH:
        yield stretch


def _number(value: float) -> str:
    return f"{value:.1f}".removesuffix(".0")


def _stretch_of_phase(problem: GapProblem, drawn: _Draws) -> Iterator[_Place]:
    """The part of all runs that is densest in what acts."""
    phase = problem.rows["phase"].to_numpy(dtype=float)
    long = [m for m in problem.members if len(np.unique(phase[m].round(9))) >= PLACES]
    if not long:
        return
    rows = np.concatenate(long)
    number = (phase[rows] / (2.0 * np.pi) * SECTORS).astype(int) % SECTORS
    cells = _densest(number, drawn.remaining[rows], SECTORS, around=True)
    begin, end = 360 * cells[0] // SECTORS, 360 * (cells[-1] + 1) // SECTORS
    inside = rows[np.isin(number, cells)]
    stretch = _of_readings(f"phase {begin}-{end}", inside, drawn.remaining)
    if stretch.confines > WORTH:
        yield stretch


def _directions(problem: GapProblem, drawn: _Draws) -> Iterator[_Place]:
    if "direction" not in problem.rows.columns:
        return
    direction = np.sign(problem.rows["direction"].to_numpy(dtype=float))
    if (direction > 0.0).any() and (direction < 0.0).any():
        for sign in (1, -1):
            rows = np.flatnonzero(direction == sign)
            yield _of_readings(f"direction {sign:+d}", rows, drawn.remaining)


def _densest(number: Index, energy: Array, count: int, around: bool = False) -> Index:
    """Cells, one beside the other, in which the mean energy is highest beyond chance.

    number    (n,) cell of each reading
    energy    (n, D) of each
    around    whether the last cell is beside the first; then up to half of them count

    The scan statistic of Kulldorff (1997), of densities inside and outside.
    """
    readings = np.bincount(number, minlength=count)
    amount = np.bincount(number, energy.mean(axis=1), minlength=count)
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
    return np.asarray(energy * np.log(np.maximum(energy, least) / np.maximum(count, 1)))
