"""Knowledge of a machine between two stages: one covariance, or a mixture of many.

While no reading is lost, one covariance S describes the machine. Where readings can be
lost, machines are drawn, and each of them carries

* its own covariance: what the controller concludes from the readings of this machine;
* its own error: how far its true parameters are from those believed.

A machine loses readings because it is far off. Its error is then larger than its
covariance says, and decides about later losses and about accuracy.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Mask


@dataclasses.dataclass(frozen=True, eq=False)
class Knowledge:
    """Equally likely machines, in units of the parameters' tolerances.

    covariances        (P, n, n), one for each machine
    errors             (P, n) true minus believed parameters; None: N(0, covariance)
    lost_readings      (P,) which machines have lost readings
    mean_square_error  (n, n) over all machines; accuracy is judged by it
    """

    covariances: Array
    errors: Array | None
    lost_readings: Mask
    mean_square_error: Array

    @property
    def columns(self) -> int:
        """Number of parameters n."""
        return int(self.covariances.shape[1])

    def repeat(self, times: int) -> tuple[Array, Array | None, Mask]:
        """Covariances, errors and losses with every machine repeated in place."""
        errors = self.errors
        if errors is not None:
            errors = np.repeat(errors, times, axis=0)
        covariances = np.repeat(self.covariances, times, axis=0)
        return covariances, errors, np.repeat(self.lost_readings, times)

    def draw(self, times: int, rng: np.random.Generator) -> tuple[Array, Array, Mask]:
        """The same, with errors drawn from the covariances where there are none yet."""
        covariances, errors, lost_readings = self.repeat(times)
        if errors is None:
            normals = rng.standard_normal(covariances.shape[:2])
            errors = np.einsum("pnm,pm->pn", square_roots(covariances), normals)
        return covariances, errors, lost_readings


#: what is known before a stage: a covariance (n, n), a mixture (P, n, n), or Knowledge
Prior = Array | Knowledge


def as_knowledge(prior: Prior) -> Knowledge:
    """A covariance (n, n) or a mixture of covariances (P, n, n) as Knowledge."""
    if isinstance(prior, Knowledge):
        return prior
    covariances = prior[None] if prior.ndim == 2 else prior
    none_lost = np.zeros(len(covariances), dtype=bool)
    return Knowledge(covariances, None, none_lost, np.asarray(covariances.mean(axis=0)))


def square_roots(covariances: Array) -> Array:
    """R (P, n, n) with R R^T = covariances, positive semidefinite up to rounding."""
    values, vectors = np.linalg.eigh(covariances)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :])
