"""One set-up's reading and its slopes, compiled: what an instrument sees of a machine's
poses.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca

from oed.arrays import Array
from oed.batch import BatchedFunction
from oed.instrument import Frame, Setup
from oed.kinematics import closure_misfit, symbols
from oed.machine import Machine


class ObservationModel:
    """One set-up's observation g(x_1, x_2, s) and its slopes, compiled.

    Where the instrument reads what the poses alone do not tell (a redundant machine's
    misfit), `inner` is true and g depends on the joints of each pose and the machine's
    parameters as well: inputs x_1, x_2, s, q_1, q_2, p.
    """

    def __init__(self, machine: Machine, setup: Setup) -> None:
        p, ps = symbols("p", machine.parameters)
        poses, joints, frames = [], [], []
        for j in range(setup.instrument.arity):
            x, xs = symbols(f"x{j}", machine.pose)
            q, qs = symbols(f"q{j}", machine.joints)
            rotation, point = machine.platform(xs)
            gap = closure_misfit(ca.vertcat(*machine.closure(xs, qs, ps)), x)
            poses.append(x)
            joints.append(q)
            frames.append(Frame(rotation, point + rotation @ ca.DM(setup.tool), gap))
        s, ss = symbols("s", setup.nuisances)
        y = ca.vertcat(*setup.instrument.observe(frames, ss, setup.settings))
        self.uses_closure = bool(ca.depends_on(y, ca.vertcat(*joints, p)))
        known = [*poses, s, *joints, p] if self.uses_closure else [*poses, s]
        slopes = [
            ca.jacobian(y, v)
            for v in ([*poses, s, p] if self.uses_closure else [*poses, s])
        ]
        self._arity, self._channels = (
            setup.instrument.arity,
            len(setup.instrument.channels),
        )
        self._sizes = [len(machine.pose)] * self._arity + [
            len(setup.nuisances),
            len(machine.parameters),
        ]
        sources = setup.instrument.sources
        spread = ca.SX(1, 1) if sources is None else sources(frames, ss, setup.settings)
        self._sources = BatchedFunction("sources", [*poses, s], [ca.vec(spread)])
        self._spread = spread.shape
        self._value = BatchedFunction("read", known, [y])
        self._slope = BatchedFunction("slope", known, slopes)

    def read(self, known: Sequence[Array]) -> Array:
        """Channels (n, channels) at the poses (n, nx), s, and what else it depends on."""
        return self._value(*known)[0]

    def sources(self, frames: Sequence[Array], s: Array) -> Array:
        """Slopes (n, channels, sources) from the instrument's independent errors."""
        rows, columns = self._spread
        return (
            self._sources(*frames, s)[0].reshape(-1, columns, rows).transpose(0, 2, 1)
        )

    def slopes(self, known: Sequence[Array]) -> tuple[list[Array], Array, Array | None]:
        """Slopes (n, channels, .) over each pose, over s, and over p beside what the
        poses carry.
        """
        n = known[0].shape[0]
        shaped = [
            b.reshape(n, self._channels, size)
            for b, size in zip(self._slope(*known), self._sizes, strict=False)
        ]
        return (
            shaped[: self._arity],
            shaped[self._arity],
            shaped[-1] if self.uses_closure else None,
        )
