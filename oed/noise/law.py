"""The noise law: how the errors of readings in one run are related.

In units of the stated noise, the readings of a run have the covariance

    level^2 [ V^1/2 B V^1/2 + run^2 1 1^T + seat^2 c c^T
              + ar1^2 exp(-|k - l| / length) ],

B the instrument's own correlation (often 1), V the variances of single readings (often
1), `run` how well a run's level repeats, c the slopes over the unknowns that a run seats
anew (a magnetic cup, ISO 230-4) and `seat` their size, `ar1` an error that is carried
along a run over `length` readings, each channel's its own. It is one of the laws of
`oed.noise.process`, written out run by run.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index
from oed.noise.process import Laws
from oed.noise.runs import RunBatch, Runs

#: share of the stated noise from which a part of a law is described
WORTH_SAYING = 0.2


@dataclasses.dataclass(frozen=True)
class NoiseLaw:
    """A noise law, in units of the stated noise.

    run_sd, ar1_sd, ar1_length, seat_sd   see the module; length in readings
    variance (N,)           of single readings over the level's; ones where they are
                            alike
    channel_ratio (N,)      noise of each reading's channel over the first one's, both
                            over the stated; None: ones
    level                   factor on everything; 1 where it is marginalised elsewhere
    student_dof             degrees of freedom of the readings' Student t, inf where
                            they are normal
    outlier_share           share of readings that are far off, where the others are
                            normal
    """

    run_sd: float
    ar1_sd: float
    ar1_length: float
    variance: Array
    level: float = 1.0
    student_dof: float = np.inf
    outlier_share: float = 0.0
    channel_ratio: Array | None = None
    seat_sd: float = 0.0

    def block(self, runs: Runs, number: int, rows: Index | None = None) -> Array:
        """Covariance (k, k) of a run's readings, or of those of its `rows` (positions
        within the run).
        """
        batch = runs.batch(number)
        return np.asarray(
            self.covariances(batch if rows is None else batch.take(rows))[0]
        )

    def covariances(self, batch: RunBatch) -> Array:
        """Covariances (B, k, k) of the runs of a batch."""
        members = batch.members
        root = np.sqrt(self.variance[members])
        covariance = batch.stated_correlation * (root[:, :, None] * root[:, None, :])
        related = (
            self.run_sd**2 * batch.level
            + self.ar1_sd**2 * np.exp(batch.distance * (-1.0 / self.ar1_length))
            + self.seat_sd**2 * batch.seat
        )
        covariance += np.where(batch.same_channel, related, 0.0)
        if self.channel_ratio is not None:
            ratio = self.channel_ratio[members]
            covariance *= ratio[:, :, None] * ratio[:, None, :]
        return np.asarray(self.level**2 * covariance)


def stated_law(runs: Runs) -> NoiseLaw:
    """The stated noise and nothing else."""
    return NoiseLaw(0.0, 0.0, 1.0, np.ones(len(runs)))


class Whitener:
    """W with W Sigma W^T = 1 for a law's covariance, and log |Sigma|. Runs of one
    length are done at once.
    """

    def __init__(self, runs: Runs, law: NoiseLaw, rows: Index | None = None) -> None:
        """`rows`: the readings that count (all by default); vectors given are still of
        all N readings.
        """
        self._parts: list[tuple[Index, Array]] = []
        self.log_det = 0.0
        for members, covariance in _blocks(runs, law, rows):
            factor = np.linalg.cholesky(covariance)
            self.log_det += 2.0 * float(
                np.log(np.diagonal(factor, axis1=1, axis2=2)).sum()
            )
            self._parts.append(
                (members, np.asarray(np.linalg.inv(factor), dtype=float))
            )
        self.size = sum(members.size for members, _ in self._parts)

    def whiten(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened."""
        wide = values[:, None] if values.ndim == 1 else values
        done = [
            (inverse @ wide[members]).reshape(members.size, wide.shape[1])
            for members, inverse in self._parts
        ]
        white = np.concatenate(done)
        return white[:, 0] if values.ndim == 1 else white


def _blocks(runs: Runs, law: NoiseLaw, rows: Index | None) -> list[tuple[Index, Array]]:
    """Members (B, k) and covariances (B, k, k) of the runs, those of one length
    together.
    """
    if rows is None:
        return [(batch.members, law.covariances(batch)) for batch in runs.batches]
    counted = np.zeros(len(runs), dtype=bool)
    counted[rows] = True
    batches: dict[int, tuple[list[Index], list[Array]]] = {}
    for k, members in enumerate(runs.members):
        mine = np.flatnonzero(counted[members])
        if mine.size:
            batch = batches.setdefault(mine.size, ([], []))
            batch[0].append(members[mine])
            batch[1].append(law.block(runs, k, mine))
    return [
        (np.array(members), np.array(blocks)) for members, blocks in batches.values()
    ]


def law_of(laws: Laws, row: int, channel: Index) -> NoiseLaw:
    """One of some laws, for readings whose channels (N,) have a scale each."""
    carried = float(laws.carried[row])
    return NoiseLaw(
        run_sd=float(laws.level[row]),
        ar1_sd=float(np.sqrt(carried)),
        ar1_length=float(laws.reach[row]),
        variance=np.full(len(channel), 1.0 - carried),
        channel_ratio=laws.scale[row, channel],
        seat_sd=float(laws.seat[row]),
    )


def describe(law: NoiseLaw) -> tuple[str, ...]:
    """A law as a person reads it."""
    sentences = [f"single readings scatter by {law.level:.2g} times the stated noise"]
    if law.run_sd > WORTH_SAYING:
        sentences.append(
            f"a run repeats to {law.level * law.run_sd:.2g} times the stated noise"
        )
    if law.seat_sd > WORTH_SAYING:
        sentences.append(
            f"what a run seats anew repeats to {law.level * law.seat_sd:.2g} times the"
            " stated noise"
        )
    if law.ar1_sd > WORTH_SAYING:
        sentences.append(
            f"an error of {law.level * law.ar1_sd:.2g} times the stated noise is"
            f" carried along over about {law.ar1_length:.0f} readings"
        )
    if np.isfinite(law.student_dof):
        sentences.append(
            f"readings far off are frequent (Student t with {law.student_dof:.2g}"
            " degrees of freedom)"
        )
    if law.outlier_share > 0.0:
        sentences.append(
            f"about {100.0 * law.outlier_share:.2g} % of the readings are far off"
        )
    return tuple(sentences)
