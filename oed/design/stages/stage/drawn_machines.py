"""Machines drawn before a stage: which readings they lose, and what is known after.

With d and u the errors of machine and set-up before a stage, and e the noise of its
readings, all unknowns but d profiled out (`profiled`), the stage leaves the error

    d' = S' (S^-1 d - K u - v),    S' = (S^-1 + M)^-1,    v ~ N(0, M - K K^T).

v holds the noise, and unknowns that have no part in which readings are lost. Machines
which lose the same candidates share a pattern, and with it M and K. Machines of one
pattern and one covariance S are a group: they share S' as well.
"""

from __future__ import annotations

import dataclasses
from functools import cached_property

import numpy as np

from oed.base import Array, Index, Mask
from oed.design.stages.option import Option
from oed.design.stages.stage import travel
from oed.design.stages.stage.knowledge import Knowledge, multiply_each
from oed.design.stages.stage.profiled import ProfiledInformation
from oed.linear_algebra import symmetric_root

#: capture probability from which no machines are drawn
CERTAIN = 0.999


@dataclasses.dataclass(frozen=True, eq=False)
class DrawnMachines:
    """Machines (P) before a stage.

    knowledge     before the stage; `lost_readings` are those up to this stage
    setup_errors  (P, s) of the set-ups' parameters and of errors that runs share
    patterns      (G, N) captured candidates, 1 or 0
    pattern_of    (P,) pattern of each machine
    """

    knowledge: Knowledge
    setup_errors: Array
    patterns: Array
    pattern_of: Index

    @property
    def group_of(self) -> Index:
        """Group (P,) of each machine."""
        return self._groups[1]

    def joint_posterior(self, information: Array, groups: Index) -> Array:
        """Covariances (K, w, w) of all unknowns in some groups (K,).

        information  (G, w, w) of each pattern
        """
        covariance_of, pattern_of = self._groups[0]
        total = information[pattern_of[groups]] + np.eye(information.shape[1])
        n = self.knowledge.covariances.shape[1]
        total[:, :n, :n] += self._prior_information[covariance_of[groups]] - np.eye(n)
        return _inverses(total)

    def update(
        self, information: ProfiledInformation, rng: np.random.Generator
    ) -> Knowledge:
        """Knowledge after readings with this information of each pattern."""
        covariance_of, pattern_of = self._groups[0]
        prior = self._prior_information[covariance_of]
        covariances = _inverses(prior + information.machine[pattern_of])
        before, lost = self.knowledge.errors, self.knowledge.lost_readings
        no_loss = ~lost
        errors = None
        if before is None:
            no_loss = np.ones(len(self.group_of), dtype=bool)
        total = self._sum(covariances, no_loss)
        if before is not None:
            noise = information.noise
            known = self._known_part(before, information)
            normals = rng.standard_normal(before.shape)
            drawn = multiply_each(symmetric_root(noise), self.pattern_of, normals)
            errors = multiply_each(covariances, self.group_of, known - drawn)
            # A machine without losses has the error of its covariance. One with losses
            # is farther off: its mean square over the noise counts.
            bias = multiply_each(covariances, self.group_of[lost], known[lost])
            scatter = covariances @ noise[pattern_of] @ covariances
            total = total + self._sum(scatter, lost) + bias.T @ bias
        return Knowledge(
            covariances=covariances,
            covariance_of=self.group_of,
            errors=errors,
            lost_readings=lost,
            mean_square_error=total / len(self.group_of),
        )

    @cached_property
    def _groups(self) -> tuple[tuple[Index, Index], Index]:
        """Covariance and pattern (K,) of each group, and each machine's group (P,)."""
        patterns = len(self.patterns)
        number = self.knowledge.covariance_of * patterns + self.pattern_of
        groups, group_of = np.unique(number, return_inverse=True)
        return (groups // patterns, groups % patterns), group_of

    @cached_property
    def _prior_information(self) -> Array:
        """S^-1 (Q, n, n)."""
        return np.asarray(np.linalg.inv(self.knowledge.covariances))

    def _known_part(self, errors: Array, information: ProfiledInformation) -> Array:
        """S^-1 d - K u (P, n) for errors d (P, n)."""
        of_machine = multiply_each(
            self._prior_information, self.knowledge.covariance_of, errors
        )
        by_setup = information.by_setup
        return of_machine - multiply_each(by_setup, self.pattern_of, self.setup_errors)

    def _sum(self, matrices: Array, of: Mask) -> Array:
        """Sum (n, n) of the groups' matrices (K, n, n) over some machines (P,)."""
        counts = np.bincount(self.group_of[of], minlength=len(matrices))
        return np.tensordot(counts, matrices, 1)


def _inverses(matrices: Array) -> Array:
    """Inverses of symmetric matrices (K, n, n), made exactly symmetric."""
    inverted = np.linalg.inv(matrices)
    return np.asarray(0.5 * (inverted + np.swapaxes(inverted, 1, 2)))


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
    if not option.limits_travel or probability.min() >= CERTAIN:
        return _all_captured(knowledge, extra, len(chosen), rng)
    drawn = knowledge.repeat(max(draws // knowledge.machines, 1))
    errors = drawn.draw_errors(rng)
    setup_errors = rng.standard_normal((drawn.machines, extra))
    of_setups = setup_errors[:, : option.setup_columns]
    captured = travel.is_captured(option, chosen, errors, of_setups)
    lost = drawn.lost_readings | ~captured.all(axis=1)
    patterns, pattern_of = np.unique(captured, axis=0, return_inverse=True)
    return DrawnMachines(
        knowledge=dataclasses.replace(drawn, errors=errors, lost_readings=lost),
        setup_errors=setup_errors,
        patterns=patterns.astype(float),
        pattern_of=pattern_of.ravel(),
    )


def _all_captured(
    knowledge: Knowledge, extra: int, chosen: int, rng: np.random.Generator
) -> DrawnMachines:
    """The machines of `knowledge`, all of which give all chosen candidates."""
    drawn = knowledge.machines if knowledge.errors is not None else 0
    return DrawnMachines(
        knowledge=knowledge,
        setup_errors=rng.standard_normal((drawn, extra)),
        patterns=np.ones((1, chosen)),
        pattern_of=np.zeros(knowledge.machines, dtype=np.intp),
    )
