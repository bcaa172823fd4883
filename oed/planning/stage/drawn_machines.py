"""Machines drawn before a stage: which readings they lose, and what is known after.

With d and s the errors of machine and set-up before a stage, S_j the joint covariance
after it, and e the noise of the readings, the stage leaves the error

    d' = S_j ( diag(S^-1, 1) (d, s) - H^T e ).

Machines which lose the same candidates share a pattern, and with it the information.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.arrays import Array, Index, Mask
from oed.planning.option import Option
from oed.planning.stage import travel
from oed.planning.stage.knowledge import Knowledge, square_roots

#: capture probability from which no machines are drawn
CERTAIN = 0.999


@dataclasses.dataclass(frozen=True, eq=False)
class DrawnMachines:
    """Machines (P) before a stage.

    covariances    (P, n, n) of the parameters, in tolerance units
    errors         (P, n) true minus believed parameters; None: N(0, covariance)
    setup_errors   (P, s) of the set-ups' parameters and of errors that runs share
    lost_readings  (P,) which machines have lost readings, up to this stage
    patterns       (G, N) captured candidates, 1 or 0
    pattern_of     (P,) pattern of each machine
    """

    covariances: Array
    errors: Array | None
    setup_errors: Array
    lost_readings: Mask
    patterns: Array
    pattern_of: Index

    def posterior(self, information: Array) -> Array:
        """Covariances (P, w, w) of all unknowns, with information (G, w, w) added."""
        total = self._prior_information(information.shape[1])
        total = total + information[self.pattern_of]
        joint = np.linalg.inv(total)
        return np.asarray(0.5 * (joint + np.swapaxes(joint, 1, 2)))

    def update(self, information: Array, rng: np.random.Generator) -> Knowledge:
        """Knowledge after readings with information (G, w, w) of each pattern."""
        n = self.covariances.shape[1]
        joint = self.posterior(information)
        covariances = joint[:, :n, :n]
        if self.errors is None:
            mean = np.asarray(covariances.mean(axis=0))
            return Knowledge(covariances, None, self.lost_readings, mean)
        gain = joint[:, :n]
        weighted = self._weighted_errors(self.errors, information.shape[1], rng)
        normals = rng.standard_normal(weighted.shape)
        roots = square_roots(information)[self.pattern_of]
        noise = np.einsum("pnm,pm->pn", roots, normals)
        errors = np.einsum("pnm,pm->pn", gain, weighted - noise)
        # A machine without losses has the error of its covariance. One with losses is
        # farther off: its mean square over the noise counts.
        bias = np.einsum("pnm,pm->pn", gain, weighted)
        noise_part = gain @ information[self.pattern_of] @ np.swapaxes(gain, 1, 2)
        with_losses = noise_part + bias[:, :, None] * bias[:, None]
        lost = self.lost_readings[:, None, None]
        mean_square = np.where(lost, with_losses, covariances).mean(axis=0)
        return Knowledge(
            covariances, errors, self.lost_readings, np.asarray(mean_square)
        )

    def _prior_information(self, unknowns: int) -> Array:
        """Information (P, w, w): of the parameters, and 1 about each other unknown."""
        n = self.covariances.shape[1]
        information = np.tile(np.eye(unknowns), (len(self.covariances), 1, 1))
        information[:, :n, :n] = np.linalg.inv(self.covariances)
        return information

    def _weighted_errors(
        self, errors: Array, unknowns: int, rng: np.random.Generator
    ) -> Array:
        """diag(S^-1, 1) (d, s) (P, w), with further unknowns drawn from N(0, 1)."""
        machines, n = errors.shape
        others = rng.standard_normal((machines, unknowns - n))
        others[:, : self.setup_errors.shape[1]] = self.setup_errors
        all_errors = np.hstack([errors, others])
        prior = self._prior_information(unknowns)
        return np.asarray(np.einsum("pnm,pm->pn", prior, all_errors))


def draw_machines(
    option: Option,
    chosen: Index,
    knowledge: Knowledge,
    probability: Array,
    draws: int,
    rng: np.random.Generator,
) -> DrawnMachines:
    """The machines of `knowledge`; where readings can be lost, `draws` drawn from them.

    probability  (N,) that each chosen candidate is captured
    """
    extra = option.unknowns - knowledge.columns
    if option.travel is None or probability.min() >= CERTAIN:
        return _all_captured(knowledge, extra, len(chosen), rng)
    times = max(draws // len(knowledge.covariances), 1)
    covariances, errors, lost_readings = knowledge.draw(times, rng)
    setup_errors = rng.standard_normal((len(covariances), extra))
    of_setups = setup_errors[:, : option.setup_columns]
    captured = travel.is_captured(option, chosen, errors, of_setups)
    patterns, pattern_of = np.unique(captured, axis=0, return_inverse=True)
    return DrawnMachines(
        covariances=covariances,
        errors=errors,
        setup_errors=setup_errors,
        lost_readings=lost_readings | ~captured.all(axis=1),
        patterns=patterns.astype(float),
        pattern_of=pattern_of.ravel(),
    )


def _all_captured(
    knowledge: Knowledge, extra: int, chosen: int, rng: np.random.Generator
) -> DrawnMachines:
    """The machines of `knowledge`, all of which give all chosen candidates."""
    machines = len(knowledge.covariances)
    drawn = machines if knowledge.errors is not None else 0
    return DrawnMachines(
        covariances=knowledge.covariances,
        errors=knowledge.errors,
        setup_errors=rng.standard_normal((drawn, extra)),
        lost_readings=knowledge.lost_readings,
        patterns=np.ones((1, chosen)),
        pattern_of=np.zeros(machines, dtype=np.intp),
    )
