"""The noise law: how the errors of readings in one run are related.

In units of the stated noise, the readings of a run have the covariance

    level^2 [ U (v D^2 + ar1^2 exp(-|k - l| / length)) U^T + v S S^T
              + run^2 1 1^T + seat^2 c c^T ],

R = U D and S the instrument's own errors (`oed.noise.stated`, often 1 and 0), U of unit
diagonal, v the variance of single readings (often 1), `run` how well a run's level
repeats, c the slopes over the unknowns that a run seats anew (a magnetic cup, ISO 230-4)
and `seat` their size, `ar1` an error that is carried along a run over `length` readings,
each channel's its own. It is one of the laws of `oed.noise.process`, written out run by
run.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base.arrays import Array, Index
from oed.noise.factor import Errors, LinearFactor
from oed.noise.prior import LEAST_SHARE
from oed.noise.process import Laws
from oed.noise.runs import RunLayout, Runs

#: share of the stated noise from which a part of a law is described
WORTH_SAYING = 0.2
#: share of the longest run beyond which its readings do not show where an error ends
SHOWN_REACH = 0.5


@dataclasses.dataclass(frozen=True)
class NoiseLaw:
    """A noise law, in units of the stated noise.

    run_sd, ar1_sd, ar1_length, seat_sd   see the module; length in readings
    variance                of single readings over the level's
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
    variance: float = 1.0
    level: float = 1.0
    student_dof: float = np.inf
    outlier_share: float = 0.0
    channel_ratio: Array | None = None
    seat_sd: float = 0.0

    def factor(self, runs: Runs, rows: Index | None = None) -> LinearFactor:
        """Root of the covariance of all readings, or of the readings `rows`."""
        layout = runs.layout if rows is None else runs.layout_of(rows)
        return LinearFactor(self.errors(runs, layout))

    def errors(self, runs: Runs, layout: RunLayout) -> Errors:
        """What the covariance consists of, for readings in an order.

        Either the law carries an error along or the instrument does.
        """
        order, stated = layout.order, runs.stated
        shared = self.shared(runs, order) * self.shared_sizes(runs, order)
        single = np.full(len(order), self.variance)
        carried = np.full(len(order), self.ar1_sd**2)
        scale = np.full(len(order), self.level)
        if self.channel_ratio is not None:
            scale = scale * self.channel_ratio[order]
        decay = layout.decay(runs.position, self.ar1_length)
        if stated is not None and stated.carried:
            carried = single * min(stated.carried, 1.0 - LEAST_SHARE)
            single = single - carried
            decay = layout.decay(stated.place, stated.reach)
        return Errors(
            order=order,
            starts=layout.starts,
            before=layout.before,
            decay=decay if carried.any() else np.zeros(len(order)),
            single=single * layout.unit**2,
            carried=carried,
            shared=shared[:, shared.any(axis=0)],
            scale=scale,
            unmix=layout.unmix,
        )

    def shared(self, runs: Runs, order: Index) -> Array:
        """Errors (k, K) of unit size that the readings of a segment share.

        Levels and seats by channel, then what is stated.
        """
        channel = runs.channel[order]
        lines = (channel[:, None] == np.unique(channel)).astype(float)
        columns = [runs.levels[order, None] * lines]
        columns += [s[:, None] * lines for s in runs.seat[order].T]
        if runs.stated is not None:
            columns.append(np.sqrt(self.variance) * runs.stated.shared[order])
        return np.hstack(columns)

    def shared_sizes(self, runs: Runs, order: Index) -> Array:
        """Sizes (K,) of the columns of `shared`."""
        channels = len(np.unique(runs.channel[order]))
        stated = 0 if runs.stated is None else runs.stated.shared.shape[1]
        counts = (channels, channels * runs.seat.shape[1], stated)
        return np.repeat([self.run_sd, self.seat_sd, 1.0], counts)


#: the stated noise and nothing else
STATED_LAW = NoiseLaw(0.0, 0.0, 1.0)


def law_of(laws: Laws, row: int, channel: Index) -> NoiseLaw:
    """One of some laws, for readings whose channels (N,) have a scale each."""
    carried = float(laws.carried[row])
    return NoiseLaw(
        run_sd=float(laws.level[row]),
        ar1_sd=float(np.sqrt(carried)),
        ar1_length=float(laws.reach[row]),
        variance=1.0 - carried,
        channel_ratio=laws.scale[row, channel],
        seat_sd=float(laws.seat[row]),
    )


def reach_words(reach: float, longest: float) -> str:
    """How far an error is carried along a run, as far as its readings can show it.

    reach, longest  in readings; of the error, and of the longest run
    """
    if reach > SHOWN_REACH * longest:
        return f"over whole runs of up to {longest:.0f} readings"
    if reach < 1.5:
        return "to the next reading"
    return f"over about {reach:.0f} readings"


def describe(law: NoiseLaw, longest: float = np.inf) -> tuple[str, ...]:
    """A law as a person reads it.

    longest  number of readings of the longest run
    """
    sentences = [f"single readings scatter by {law.level:.2g} times the stated noise"]
    if law.run_sd > WORTH_SAYING:
        sentences.append(
            f"a run repeats to {law.level * law.run_sd:.2g} times the stated noise"
        )
    if law.seat_sd > WORTH_SAYING:
        sentences.append(
            "what a run seats anew, such as a cup on its magnet, repeats to"
            f" {law.level * law.seat_sd:.2g} times the stated noise"
        )
    if law.ar1_sd > WORTH_SAYING:
        sentences.append(
            f"an error of {law.level * law.ar1_sd:.2g} times the stated noise is"
            f" carried along {reach_words(law.ar1_length, longest)}"
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
