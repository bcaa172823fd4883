"""Observation model of one set-up: its readings and their slopes, compiled by CasADi."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import casadi as ca

from oed.base.arrays import Array
from oed.mechanism.batch import BatchedFunction
from oed.model.expressions import machine_frame, symbols
from oed.model.instrument import Setup
from oed.model.machine import Machine


class ObservationModel:
    """Reading y = g(x_1, x_2, s) of one set-up, and its slopes.

    A reading sees one pose or two; s are the set-up's nuisances. Where the instrument
    reads the misfit of a redundant machine, `uses_closure` is true. Then g depends on
    the joints of each pose and on the machine's parameters as well: its inputs are
    x_1, x_2, s, q_1, q_2, p.
    """

    def __init__(self, machine: Machine, setup: Setup) -> None:
        instrument = setup.instrument
        p, p_by_name = symbols("p", machine.parameters)
        s, s_by_name = symbols("s", setup.nuisances)
        poses, joints, frames = [], [], []
        for j in range(instrument.arity):
            x, x_by_name = symbols(f"x{j}", machine.pose)
            q, q_by_name = symbols(f"q{j}", machine.joints)
            by_name = x_by_name, q_by_name, p_by_name
            poses.append(x)
            joints.append(q)
            frames.append(machine_frame(machine, x, by_name, ca.DM(setup.tool)))
        y = ca.vertcat(*instrument.observe(frames, s_by_name, setup.settings))
        self.uses_closure = bool(ca.depends_on(y, ca.vertcat(*joints, p)))
        inputs, over = [*poses, s], [*poses, s]
        if self.uses_closure:
            inputs, over = [*poses, s, *joints, p], [*poses, s, p]
        slopes = [ca.jacobian(y, v) for v in over]
        sources = ca.SX(1, 1)
        if instrument.sources is not None:
            slopes_of_errors = instrument.sources(frames, s_by_name, setup.settings)
            sources = ca.substitute(ca.SX(slopes_of_errors), p, machine.nominal)

        self._arity = instrument.arity
        self._channels = len(instrument.channels)
        self._sizes = [v.numel() for v in over]
        self._sources_shape = sources.shape
        self._value = BatchedFunction("read", inputs, [y])
        self._slopes = BatchedFunction("slope", inputs, slopes)
        self._joint_slopes = None
        if self.uses_closure:
            by_joint = [ca.jacobian(y, q) for q in joints]
            self._joint_slopes = BatchedFunction("joint_slope", inputs, by_joint)
        self._sources = BatchedFunction("sources", [*poses, s], [ca.vec(sources)])

    def read(self, inputs: Sequence[Array]) -> Array:
        """Readings (n, channels), SI, at the inputs of g: each (n, size) or (size,)."""
        return self._value(*inputs)[0]

    def sources(self, poses: Sequence[Array], s: Array) -> Array:
        """Slopes (n, channels, sources) over the instrument's independent errors.

        Poses (n, nx), s (ns,). Only for instruments that state their sources.
        """
        rows, columns = self._sources_shape
        flat = self._sources(*poses, s)[0]  # column by column, as CasADi stores
        return flat.reshape(-1, columns, rows).transpose(0, 2, 1)

    def slopes(
        self, inputs: Sequence[Array]
    ) -> tuple[list[Array], Array, Array | None]:
        """Slopes (n, channels, size) over each pose, over s, and over p at fixed poses.

        The last is None unless g uses the closure.
        """
        n = inputs[0].shape[0]
        slopes = [
            slope.reshape(n, self._channels, size)
            for slope, size in zip(self._slopes(*inputs), self._sizes, strict=True)
        ]
        by_pose, by_setup = slopes[: self._arity], slopes[self._arity]
        return by_pose, by_setup, slopes[-1] if self.uses_closure else None

    def joint_slopes(self, inputs: Sequence[Array]) -> list[Array] | None:
        """Slopes (n, channels, nq) over the joints of each pose, at fixed poses.

        None unless g uses the closure.
        """
        if self._joint_slopes is None:
            return None
        n = inputs[0].shape[0]
        slopes = self._joint_slopes(*inputs)
        return [slope.reshape(n, self._channels, -1) for slope in slopes]


@dataclasses.dataclass(frozen=True, slots=True)
class Response:
    """Slopes of n readings of a set-up over changes at the poses they see, SI.

    joints      for each pose of a reading, (n, channels, nq)
    parameters  for each pose of a reading, (n, channels, np)
    nuisances   (n, channels, ns), over the set-up's unknowns at the time of the reading
    """

    joints: tuple[Array, ...]
    parameters: tuple[Array, ...]
    nuisances: Array
