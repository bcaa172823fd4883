"""The noise that real readings have, and the metric in which what the parameters absorb
no longer counts.

In units of the stated noise, the readings of a run have the covariance

    level^2 [ V^1/2 B V^1/2 + repeat^2 1 1^T + sway^2 cos(phi_k - phi_l) + wander^2
    exp(-|k - l| / reach) ],

B the instrument's own correlation (often 1), V the variances of single readings (often
1), `repeat` how well a run's level repeats and `sway` its first harmonic (a bar set up
anew is centred anew, ISO 230-4), `wander` an error that is carried along a run over
`reach` readings. Channels of one reading wander apart.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import linalg

from oed.batch import Array
from oed.gap.data.problem import Index, Pack, Problem


@dataclasses.dataclass(frozen=True)
class Law:
    """A noise law, in units of the stated noise.

    repeat, wander, reach, sway   see the module; reach in readings
    variance (N,)           of single readings over the level's; ones where they are
                            alike
    ratio (N,)              noise of each reading's channel over the first one's, both
                            over the stated; None: ones
    level                   factor on everything; 1 where it is marginalised elsewhere
    tails                   degrees of freedom of the readings' Student t, inf where
                            they are normal
    strays                  share of readings that are far off, where the others are
                            normal
    """

    repeat: float
    wander: float
    reach: float
    variance: Array
    level: float = 1.0
    tails: float = np.inf
    strays: float = 0.0
    ratio: Array | None = None
    sway: float = 0.0

    def block(self, problem: Problem, number: int, rows: Index | None = None) -> Array:
        """Covariance (k, k) of a run's readings, or of those of its `rows` (positions
        within the run).
        """
        pack = problem.pack(number)
        return np.asarray(
            self.covariances(pack if rows is None else pack.take(rows))[0]
        )

    def covariances(self, pack: Pack) -> Array:
        """Covariances (B, k, k) of the runs of a pack."""
        members = pack.members
        root = np.sqrt(self.variance[members])
        covariance = pack.base * (root[:, :, None] * root[:, None, :])
        related = (
            self.repeat**2
            + self.wander**2 * np.exp(pack.gap * (-1.0 / self.reach))
            + self.sway**2 * pack.turn
        )
        covariance += np.where(pack.same, related, 0.0)
        if self.ratio is not None:
            ratio = self.ratio[members]
            covariance *= ratio[:, :, None] * ratio[:, None, :]
        return np.asarray(self.level**2 * covariance)


def plain(problem: Problem) -> Law:
    """The stated noise and nothing else."""
    return Law(0.0, 0.0, 1.0, np.ones(len(problem)))


class Whitener:
    """W with W Sigma W^T = 1 for a law's covariance, and log |Sigma|. Runs of one
    length are done at once.
    """

    def __init__(self, problem: Problem, law: Law, rows: Index | None = None) -> None:
        """`rows`: the readings that count (all by default); vectors given are still of
        all N readings.
        """
        self._parts: list[tuple[Index, Array]] = []
        self.log_det = 0.0
        for members, covariance in _blocks(problem, law, rows):
            factor = np.linalg.cholesky(covariance)
            self.log_det += 2.0 * float(
                np.log(np.diagonal(factor, axis1=1, axis2=2)).sum()
            )
            self._parts.append(
                (members, np.asarray(np.linalg.inv(factor), dtype=float))
            )
        self.size = sum(members.size for members, _ in self._parts)

    def white(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened."""
        wide = values[:, None] if values.ndim == 1 else values
        done = [
            (inverse @ wide[members]).reshape(members.size, wide.shape[1])
            for members, inverse in self._parts
        ]
        white = np.concatenate(done)
        return white[:, 0] if values.ndim == 1 else white


def _blocks(
    problem: Problem, law: Law, rows: Index | None
) -> list[tuple[Index, Array]]:
    """Members (B, k) and covariances (B, k, k) of the runs, those of one length
    together.
    """
    if rows is None:
        return [(pack.members, law.covariances(pack)) for pack in problem.packs]
    counted = np.zeros(len(problem), dtype=bool)
    counted[rows] = True
    found: dict[int, tuple[list[Index], list[Array]]] = {}
    for k, members in enumerate(problem.blocks):
        mine = np.flatnonzero(counted[members])
        if mine.size:
            pack = found.setdefault(mine.size, ([], []))
            pack[0].append(members[mine])
            pack[1].append(law.block(problem, k, mine))
    return [(np.array(members), np.array(blocks)) for members, blocks in found.values()]


class Metric:
    """Inner products of changes of the readings after the parameters have absorbed what
    they can.

    u, v (N, k) in units of the stated noise: <u, v> = u^T M v with M = (Sigma + H
    Lambda H^T)^-1.
    """

    def __init__(self, problem: Problem, law: Law, rows: Index | None = None) -> None:
        """`rows`: the readings that count (all by default); vectors given are still of
        all N readings.
        """
        self._whitener = Whitener(problem, law, rows)
        self.size = self._whitener.size
        white = self.white(problem.slopes)
        inner = np.eye(white.shape[1]) + white.T @ white
        self._root = linalg.cholesky(inner, lower=True, check_finite=False)
        self._absorb = linalg.solve_triangular(
            self._root, white.T, lower=True, check_finite=False
        )
        #: log determinant of Sigma + H Lambda H^T
        self.log_det = self._whitener.log_det + 2.0 * float(
            np.log(np.diag(self._root)).sum()
        )

    def white(self, values: Array) -> Array:
        """Values (N,) or (N, k) whitened by the noise alone, run after run."""
        return self._whitener.white(values)

    def parts(self, values: Array) -> tuple[Array, Array]:
        """What inner products need of values (N, k): <u, v> = u0^T v0 - u1^T v1."""
        white = self.white(values)
        return white, self._absorb @ white

    def fitted(self, values: Array) -> Array:
        """Parameters (n,), in prior standard deviations, that explain values (N,) best."""
        _, absorbed = self.parts(values)
        return np.asarray(
            linalg.solve_triangular(
                self._root, absorbed, lower=True, trans="T", check_finite=False
            )
        )

    def gram(self, u: Array, v: Array) -> Array:
        """Inner products (k, l) of (N, k) and (N, l)."""
        (u0, u1), (v0, v1) = self.parts(u), self.parts(v)
        return np.asarray(u0.T @ v0 - u1.T @ v1)
