"""Candidates of a plan: readings of a measurement as blocks, with their noise,
unknowns, time and place.

A candidate is one reading with all its channels, or a whole run (a circle) with the
covariance of its readings. The readings of a run may share an error e, that of the
reference they are told against (`Channel.shared`):

    y_i = h_i theta + sigma e_i + shared sigma e        with e ~ N(0, 1).

Chosen one by one they are no longer independent candidates; but e is just one more
unknown with prior variance 1. It gets a column of its own, which every criterion
profiles out: whitened row [h_i / sigma, shared], prior information 1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.design.criterion import Criterion, Determinant, Variance, Worst, named
from oed.design.rules import Rules
from oed.information import Scaling, column_scale
from oed.measurement import Measurement, Series


@dataclasses.dataclass(frozen=True, eq=False)
class Candidates:
    """Candidates of a plan.

    blocks      (C, k, n + r): n free parameters in the stated scaling, then r errors
                shared by runs
    columns     n
    held        (n + r, n + r) information held: on the shared errors, and the prior and
                kept readings where given
    members     (C, 2) first reading of each candidate among all readings of all series,
                and the number of readings
    setup       (C,) position in `setups`;  place (C, d) commands, SI
    cost        (C,) time of a candidate, s;  setup_cost (S,) time to mount each set-up,
                s
    """

    measurement: Measurement
    series: tuple[Series, ...]
    blocks: Array
    columns: int
    held: Array
    members: Index
    setups: tuple[str, ...]
    setup: Index
    place: Array
    cost: Array
    setup_cost: Array

    def __len__(self) -> int:
        return len(self.blocks)

    @property
    def prior(self) -> Array | None:
        """Information held, None where there is none."""
        return self.held if self.held.any() else None

    @property
    def shared(self) -> int:
        """Errors shared by runs."""
        return int(self.blocks.shape[2]) - self.columns

    def with_prior(self, information: Array) -> Candidates:
        """With information (n, n) about the parameters held besides."""
        held = self.held.copy()
        held[: self.columns, : self.columns] += information
        return dataclasses.replace(self, held=held)

    def criterion(
        self,
        name: str,
        *,
        interest: Array | None = None,
        factor: Array | None = None,
        factors: Array | None = None,
    ) -> Criterion:
        """A criterion about the parameters, with the shared errors profiled out.

        interest (n, s), factor (r, n), factors (J, r, n) are in the scaled columns.
        Raises ValueError for criteria of eigenvalues where errors are shared: they know
        no profiling.
        """
        n, r = self.columns, self.shared
        if not r:
            return named(name, n, interest=interest, factor=factor, factors=factors)
        if name in ("D", "O1", "Ds"):
            wanted = np.eye(n) if interest is None or name != "Ds" else interest
            return Determinant(
                n + r, np.vstack([wanted, np.zeros((r, wanted.shape[1]))]), name
            )
        if name == "A":
            return Variance(np.eye(n, n + r), "A")
        if name in ("I", "c") and factor is not None:
            return Variance(np.hstack([factor, np.zeros((len(factor), r))]), name)
        if name == "G" and factors is not None:
            return Worst(
                np.concatenate([factors, np.zeros((*factors.shape[:2], r))], axis=2)
            )
        raise ValueError(
            f"{name} does not profile out the error that a run's readings share: choose"
            " D, A, c, I or G, or whole runs"
        )

    def rules(
        self,
        *,
        size: int | None = None,
        budget: float | None = None,
        most_setups: int | None = None,
        apart: Array | None = None,
        mounting: bool = True,
    ) -> Rules:
        """Rules over these candidates; apart (d,) is the least distance along each
        command coordinate, SI: two readings of a set-up are too near where they are
        nearer in the norm of the coordinates over `apart`.
        """
        place = (
            None if apart is None else self.place / np.where(apart > 0, apart, np.inf)
        )
        return Rules(
            size=size,
            budget=budget,
            cost=self.cost if budget is not None else None,
            setup=self.setup,
            setup_cost=self.setup_cost if budget is not None and mounting else None,
            most_setups=most_setups,
            place=place,
            apart=0.0 if apart is None else 1.0,
        )

    def take(self, chosen: Index) -> tuple[Series, ...]:
        """The chosen candidates' readings as series, in the order of the candidates."""
        taken, start = [], 0
        for s in self.series:
            mine = [m for m in self.members[chosen] if start <= m[0] < start + len(s)]
            rows = [
                np.arange(first - start, first - start + count) for first, count in mine
            ]
            start += len(s)
            if rows:
                taken.append(s.take(np.concatenate(rows).astype(np.intp)))
        return tuple(taken)


def of(
    measurement: Measurement,
    series: Sequence[Series],
    at: Array,
    scaling: Scaling,
    *,
    whole_runs: bool = False,
) -> Candidates:
    """Candidates from all readings of the series at theta `at` (n,); whole runs stay
    together where asked.

    Raises ValueError where a series has no readings.
    """
    free = measurement.free
    parts = [_blocks(measurement, s, at, scaling, whole_runs) for s in series]
    runs = sum(p[1].shape[2] for p in parts)
    n = int(free.sum())
    most = max(min(p[0].shape[1], n + runs) for p in parts)
    blocks, members, setup, start, column = [], [], [], 0, n
    names = tuple(dict.fromkeys(s.setup for s in series))
    for s, (rows, shared, counts) in zip(series, parts, strict=True):
        wide = np.zeros((*rows.shape[:2], n + runs))
        wide[:, :, :n] = rows[:, :, free]
        wide[:, :, column : column + shared.shape[2]] = shared
        column += shared.shape[2]
        blocks.append(_padded(wide, most))
        first = np.concatenate([[0], np.cumsum(counts)[:-1]]) + start
        members.append(np.column_stack([first, counts]))
        setup.append(np.full(len(counts), names.index(s.setup)))
        start += len(s)
    held = np.zeros((n + runs, n + runs))
    held[range(n, n + runs), range(n, n + runs)] = 1.0
    where = np.concatenate(members)
    commands = np.vstack([s.commands() for s in series])
    seconds = np.concatenate(
        [np.full(len(s), reading_time(measurement, s.setup)) for s in series]
    )
    return Candidates(
        measurement=measurement,
        series=tuple(series),
        blocks=np.concatenate(blocks),
        columns=n,
        held=held,
        members=where,
        setups=names,
        setup=np.concatenate(setup),
        place=commands[where[:, 0]],
        cost=np.array([seconds[first : first + count].sum() for first, count in where]),
        setup_cost=np.array(
            [measurement.setups[name].instrument.cost.setup for name in names]
        ),
    )


def reading_time(measurement: Measurement, setup: str) -> float:
    """Time, s, of one planned reading with all passes that are averaged into it."""
    chosen = measurement.setups[setup]
    passes = len(chosen.protocol.passes) if chosen.protocol.average else 1
    return chosen.instrument.cost.reading * passes


def _blocks(
    measurement: Measurement,
    series: Series,
    at: Array,
    scaling: Scaling,
    whole_runs: bool,
) -> tuple[Array, Array, Index]:
    """Blocks (C, k, all parameters), columns (C, k, r) of shared errors, and the
    readings in each candidate.
    """
    channels = measurement.setups[series.setup].instrument.channels
    k, count = len(channels), len(series)
    rows = (
        measurement.jacobian([series], at) * column_scale(measurement, scaling)
    ).reshape(count, k, -1)
    whiten = scaling == "tolerance"
    if not whiten:
        rows = (
            rows * measurement.reading_lengths([series]).reshape(count, k, 1)
            if scaling == "length"
            else rows
        )
    if whole_runs:
        flat = (
            measurement.noise([series]).whiten(rows.reshape(count * k, -1))
            if whiten
            else rows.reshape(count * k, -1)
        )
        return _runs(series, flat.reshape(count, k, -1))
    if not whiten:
        return rows, np.zeros((count, k, 0)), np.ones(count, dtype=np.intp)
    factor = np.linalg.inv(np.linalg.cholesky(measurement.own_noise(series)))
    sigma = np.asarray(measurement.setups[series.setup].sigma)
    shared = [c for c in range(k) if channels[c].shared > 0]
    labels = list(dict.fromkeys(series.run))
    columns = np.zeros((count, k, len(labels) * len(shared)))
    for j, label in enumerate(labels):
        for i, c in enumerate(shared):
            columns[series.run == label, c, j * len(shared) + i] = (
                channels[c].shared * sigma[c]
            )
    return factor @ rows, factor @ columns, np.ones(count, dtype=np.intp)


def _runs(series: Series, rows: Array) -> tuple[Array, Array, Index]:
    """Whole runs as candidates, padded with empty rows to the longest. A run's readings
    follow each other.
    """
    labels = list(dict.fromkeys(series.run))
    counts = np.array([int(np.sum(series.run == x)) for x in labels], dtype=np.intp)
    if not (np.repeat(np.array(labels), counts) == series.run).all():
        raise ValueError(
            f"the readings of a run of set-up {series.setup} do not follow each other"
        )
    k, n = rows.shape[1:]
    blocks = np.zeros((len(labels), int(counts.max()) * k, n))
    start = 0
    for j, c in enumerate(counts):
        blocks[j, : c * k] = rows[start : start + c].reshape(c * k, n)
        start += c
    return blocks, np.zeros((*blocks.shape[:2], 0)), counts


def _padded(blocks: Array, most: int) -> Array:
    """Blocks of at most `most` rows: longer ones as the triangle of their QR, shorter
    ones with empty rows.
    """
    if blocks.shape[1] > most:
        return np.asarray(np.linalg.qr(blocks, mode="r"), dtype=float)[:, :most]
    return np.pad(blocks, ((0, 0), (0, most - blocks.shape[1]), (0, 0)))
