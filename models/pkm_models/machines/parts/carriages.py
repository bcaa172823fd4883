"""Struts of fixed length on carriages: what hexapods and tripods of this kind share."""

import dataclasses
import functools
from collections.abc import Callable

from oed.base import Array
from oed.model import Expr, Strut, Values
from pkm_models.machines.parts import legs
from pkm_models.machines.parts.families import point
from pkm_models.rotation import across


@dataclasses.dataclass(frozen=True, eq=False)
class GuidedStruts(legs.FixedStruts):
    """Limbs 1 to n: carriage i at b_i + q_i u_i, its strut to the platform joint."""

    along: Array  #: (n, 3) directions u_i of the guides
    #: (n,) 1 where a carriage is ahead of its platform joint, -1 where behind
    side: Array
    #: (x, p, i) the platform joint (3,) of a limb
    joint: Callable[[Values, Values, int], Expr] = legs.platform_joint

    @functools.cached_property
    def _across(self) -> Array:
        return across(self.along)

    @property
    def limbs(self) -> range:
        """Numbers of the limbs, from 1."""
        return range(1, len(self.along) + 1)

    def axis(self, p: Values, i: int) -> Expr:
        """Direction (3,) of a guide."""
        return legs.direction(p, i, self.along[i - 1], self._across[i - 1])

    def ends(self, x: Values, q: Values, p: Values, i: int) -> Strut:
        """Ends (3,) of a strut, at the carriage and at the platform."""
        carriage = point(p, "b", i) + q[f"q{i}"] * self.axis(p, i)
        return carriage, self.joint(x, p, i)

    def travels(self, x: Values, p: Values) -> list[Expr]:
        """Travel of each carriage for a pose, on its side of the platform joint."""
        travels = []
        for i in self.limbs:
            joint = self.joint(x, p, i)
            foot, axis = point(p, "b", i), self.axis(p, i)
            strut, side = p[f"l{i}"], self.side[i - 1]
            travels.append(legs.travel(joint, foot, axis, strut, side))
        return travels

    def skeleton(self, x: Values, q: Values, p: Values) -> list[list[Expr]]:
        """Carriages, struts, platform and tool."""
        carriages, joints = zip(*self.struts(x, q, p), strict=True)
        return legs.skeleton(carriages, joints, x)
