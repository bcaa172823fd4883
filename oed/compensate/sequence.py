"""Several compensators one after the other."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

from oed.base.arrays import Array
from oed.compensate.setpoint import Compensator, Conditions, Setpoint


@dataclasses.dataclass(frozen=True)
class CompensatorSequence:
    """Applies compensators in their order.

    A table that changes commands goes before a compensator that computes joints, so
    that the joints are those of the changed command.
    """

    steps: Sequence[Compensator]

    def apply(self, setpoint: Setpoint, conditions: Conditions) -> Setpoint:
        """The setpoint after all steps. Raises ValueError as the steps do."""
        for step in self.steps:
            setpoint = step.apply(setpoint, conditions)
        return setpoint

    def limits(self, command: Array) -> tuple[str, ...]:
        """What each step leaves, in sentences: a later step may remove some of it."""
        return tuple(
            sentence for step in self.steps for sentence in step.limits(command)
        )
