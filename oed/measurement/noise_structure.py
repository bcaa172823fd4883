"""How the readings of a measurement hang together: runs, chains, renewed unknowns.

A course through the session is what the readings of a channel share over all runs: a
cup creeps, a frame warms, a zero wanders. With the session's progress t from 0 to 1 the
course is a Wiener process, by its first Karhunen-Loeve terms

    sum_k  x_k sqrt(2) sin(w_k t) / w_k,    w_k = (k - 1/2) pi,    x_k ~ N(0, 1),

of variance t. A straight drift is nearly the first term, and what is faster than the last
one is left to what runs share and carry along.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import scipy

from oed.base import Array, Index
from oed.measurement.measurement import Measurement, Series
from oed.measurement.setup_readings import decoupling
from oed.noise import NOTHING_STATED, NoiseStatement, ReadingStructure, SharedError


def reading_structure(
    measurement: Measurement, series: Sequence[Series], theta: Array
) -> ReadingStructure:
    """Structure of readings, with the Jacobian of renewed unknowns taken at theta (n,)."""
    names: dict[str, int] = {}
    parts: list[dict[str, Array]] = []
    blocks: list[scipy.sparse.csr_array] = []
    runs = 0
    for s in series:
        setup = measurement.setups[s.setup]
        channels = setup.instrument.channels
        labels = [f"{s.setup}.{c.name}" for c in channels]
        groups = [names.setdefault(label, len(names)) for label in labels]
        number = {label: runs + k for k, label in enumerate(dict.fromkeys(s.run))}
        run = np.array([number[label] for label in s.run])
        count = len(channels)
        common = [c.shared * sd for c, sd in zip(channels, setup.sigma, strict=True)]
        stated = [c.name in setup.statement.levels for c in channels]
        parts.append(
            {
                "run": np.repeat(run, count),
                "channel": np.tile(np.arange(count), len(s)),
                "group": np.tile(groups, len(s)),
                "position": np.repeat(_places(run), count),
                "shared": np.tile(common, len(s)),
                "stated": np.tile(stated, len(s)),
            }
        )
        blocks.append(decoupling(measurement.of(s).reading_covariances(s)))
        runs += len(number)
    of_reading = {key: np.concatenate([p[key] for p in parts]) for key in parts[0]}
    run = of_reading["run"]
    pairs, chain = np.unique(
        np.column_stack([run, of_reading["channel"]]), axis=0, return_inverse=True
    )
    decouple = scipy.sparse.csr_array(scipy.sparse.block_diag(blocks))
    diagonal = decouple.diagonal()
    independent = decouple.nnz == len(run)
    renewed = seats_jacobian(measurement, series, theta, stated=False)
    seated = seats_jacobian(measurement, series, theta, stated=True)
    columns, kinds = _run_errors(
        of_reading, decouple, renewed / diagonal[:, None], seated
    )
    group = of_reading["group"].astype(np.intp)
    statement = common_statement(measurement, series)
    return ReadingStructure(
        names=tuple(names),
        group=group,
        chain=chain.ravel().astype(np.intp),
        run=pairs[:, 0].astype(np.intp),
        position=of_reading["position"].astype(float),
        unit=1.0 / diagonal,
        decouple=None if independent else decouple,
        columns=columns,
        kinds=kinds,
        course=_course(measurement, series, group, statement),
        statement=statement,
    )


def _course(
    measurement: Measurement,
    series: Sequence[Series],
    group: Index,
    statement: NoiseStatement,
) -> Array:
    """Terms (N, c) of a course through the session, in the order of the series."""
    if statement.is_assumed or not statement.has_course:
        return np.zeros((len(group), 0))
    channels = [len(measurement.setups[s.setup].instrument.channels) for s in series]
    count = sum(len(s) for s in series)
    number = np.arange(count) / max(count - 1, 1)
    of_series = np.split(number, np.cumsum([len(s) for s in series])[:-1])
    pairs = zip(of_series, channels, strict=True)
    progress = np.concatenate([np.repeat(part, n) for part, n in pairs])
    return course_terms(group, progress)


def common_statement(
    measurement: Measurement, series: Sequence[Series]
) -> NoiseStatement:
    """What all set-ups state of the noise. Raises ValueError where it differs."""
    used = [measurement.setups[s.setup].statement for s in series]
    common = {
        dataclasses.replace(s, levels=frozenset(), seating=None) for s in used
    } or {NOTHING_STATED}
    if len(common) > 1:
        raise ValueError(
            "one law holds for all readings: give each set-up the same carried share,"
            " reach and tails"
        )
    return common.pop()


def _places(run: Index) -> Index:
    """Number of each reading within its run."""
    position = np.empty(len(run), dtype=np.intp)
    for number in np.unique(run):
        members = np.flatnonzero(run == number)
        position[members] = np.arange(len(members))
    return position


def seats_jacobian(
    measurement: Measurement, series: Sequence[Series], theta: Array, *, stated: bool
) -> Array:
    """Jacobian (N, s) over what runs seat anew, by name: of the set-ups that state their
    seating, times it, SI, or of the others.
    """
    columns: dict[str, list[tuple[int, float]]] = {}
    for name in dict.fromkeys(s.setup for s in series):
        setup = measurement.setups[name]
        seating = setup.statement.seating
        if (seating is not None) != stated:
            continue
        size = 1.0 if seating is None else seating
        for unknown in setup.instrument.renewed:
            full = measurement.names.index(f"{setup.owner}.{unknown}")
            columns.setdefault(unknown, []).append((full, size))
    if not columns:
        return np.zeros((len(measurement.setup_of_readings(series)), 0))
    jacobian = measurement.jacobian(series, theta)
    summed = [
        np.sum([size * jacobian[:, k] for k, size in members], axis=0)
        for members in columns.values()
    ]
    return np.column_stack(summed)


def _run_errors(
    of_reading: Mapping[str, Array],
    decouple: scipy.sparse.csr_array,
    renewed: Array,
    seated: Array,
) -> tuple[Array, Index]:
    """Errors common to a run (N, K), and their kinds (K,).

    of_reading       channel (N,), error `shared` (N,) of a run's level, SI, and whether it is
                     `stated`, and is all that the level moves by
    renewed, seated  (N, s) Jacobian of what runs seat anew, in stated noise, and times the
                     stated seating, SI; what one set-up does not have is 0
    """
    channel = of_reading["channel"]
    stated = np.asarray(of_reading["stated"], dtype=bool)[:, None]
    of_channel = (channel[:, None] == np.arange(channel.max() + 1)).astype(float)
    level = of_channel * of_reading["shared"][:, None]
    errors = (
        (SharedError.KNOWN, level * ~stated),
        (SharedError.RENEWED, renewed),
        (SharedError.STATED_LEVEL, level * stated),
        (SharedError.STATED_SEAT, seated),
    )
    blocks = [(of_channel * ~stated, SharedError.LEVEL)]
    for kind, values in errors:
        if values.any():
            blocks.append((decouple @ values, kind))
    columns = np.hstack([values for values, _ in blocks])
    kinds = np.concatenate([np.full(v.shape[1], kind) for v, kind in blocks])
    used = columns.any(axis=0)
    return columns[:, used], kinds[used].astype(np.intp)


MAX_COURSE_TERMS = 4  #: most terms; they leave a twentieth of the variance
READINGS_PER_TERM = 5  #: readings of a channel for each term


def course_terms(group: Index, progress: Array) -> Array:
    """Terms (N, c) of the course of each group of readings, few of a small group.

    group     (N,) numbers of the groups
    progress  (N,) of the session at each reading, 0 to 1
    """
    frequency = (np.arange(MAX_COURSE_TERMS) + 0.5) * np.pi
    terms = np.sqrt(2.0) * np.sin(progress[:, None] * frequency) / frequency
    columns = [np.zeros((len(group), 0))]
    for number, count in enumerate(np.bincount(group)):
        few = min(MAX_COURSE_TERMS, count // READINGS_PER_TERM)
        columns.append(terms[:, :few] * (group == number)[:, None])
    return np.hstack(columns)
