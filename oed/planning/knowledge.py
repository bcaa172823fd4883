"""Knowledge of a machine between two stages: one covariance, or a mixture of many.

While no reading is lost, one covariance S describes the machine. Where readings can be
lost, machines are drawn, and each of them carries

* its own covariance: what the controller concludes from the readings of this machine;
* its own error: how far its true parameters are from those believed.

A machine loses readings because it is far off. Its error is then larger than its
covariance says, and decides about later losses and about accuracy.
"""

import dataclasses

import numpy as np

from oed.base import Array, Index, Mask
from oed.linear_algebra import symmetric_root


@dataclasses.dataclass(frozen=True, eq=False)
class Knowledge:
    """Equally likely machines (P), in units of the parameters' tolerances.

    Machines with the same losses share a covariance: it is held, and worked with, once.
    """

    covariances: Array  #: (Q, n, n) distinct ones
    covariance_of: Index  #: (P,) covariance of each machine
    #: (P, n) true minus believed parameters; None: N(0, covariance)
    errors: Array | None
    lost_readings: Mask  #: (P,) which machines have lost readings
    mean_square_error: Array  #: (n, n) over all machines; accuracy is judged by it

    @property
    def machines(self) -> int:
        """Number of machines P."""
        return len(self.covariance_of)

    @property
    def columns(self) -> int:
        """Number of parameters n."""
        return int(self.covariances.shape[1])

    def repeat(self, times: int) -> "Knowledge":
        """The same knowledge with every machine repeated in place."""
        errors = self.errors
        if errors is not None:
            errors = np.repeat(errors, times, axis=0)
        return Knowledge(
            covariances=self.covariances,
            covariance_of=np.repeat(self.covariance_of, times),
            errors=errors,
            lost_readings=np.repeat(self.lost_readings, times),
            mean_square_error=self.mean_square_error,
        )

    def draw_errors(self, rng: np.random.Generator) -> Array:
        """Errors (P, n); drawn from the covariances where there are none yet."""
        if self.errors is not None:
            return self.errors
        normals = rng.standard_normal((self.machines, self.columns))
        return multiply_each(
            symmetric_root(self.covariances), self.covariance_of, normals
        )


#: what is known before a stage: a covariance (n, n), a mixture (P, n, n), or Knowledge
Prior = Array | Knowledge


def make_knowledge(prior: Prior) -> Knowledge:
    """A covariance (n, n) or a mixture of covariances (P, n, n) as Knowledge."""
    if isinstance(prior, Knowledge):
        return prior
    covariances = prior[None] if prior.ndim == 2 else prior
    return Knowledge(
        covariances=covariances,
        covariance_of=np.arange(len(covariances)),
        errors=None,
        lost_readings=np.zeros(len(covariances), dtype=bool),
        mean_square_error=np.asarray(covariances.mean(axis=0)),
    )


def multiply_each(matrices: Array, matrix_of: Index, vectors: Array) -> Array:
    """Products (P, a) of vectors (P, b) with matrices (Q, a, b), `matrix_of` (P,) each."""
    if len(matrices) == 1:
        return np.asarray(vectors @ matrices[0].T)
    products = np.empty((len(vectors), matrices.shape[1]))
    order = np.argsort(matrix_of, kind="stable")
    first = 0
    for matrix, count in zip(matrices, np.bincount(matrix_of), strict=False):
        members = order[first : first + count]
        products[members] = vectors[members] @ matrix.T
        first += count
    return products
