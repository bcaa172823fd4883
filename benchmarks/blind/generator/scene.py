"""A plan on a true machine: nominal motion (rates, forces), exact readings under any
disturbance, slopes.

Disturbances are told by a `Push`: what it adds, row by row, to joints, parameters, tool
point, state of the set-up and readings. Readings are the exact ones; `response` is
their first order, for what only needs that.
"""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np

from benchmarks.blind.generator.machines import (
    Array,
    Pose,
    leg_direction,
    nearby,
    settle,
    slope,
    tip,
)
from benchmarks.blind.generator.plans import READ, STATE, Index, Plan


@dataclasses.dataclass(frozen=True, kw_only=True)
class Push:
    """Additions: dq (n, legs), dp (n, np + extras), dtip (n, 3), ds (n, STATE), dy
    (N,); None: nothing. SI.
    """

    dq: Array | None = None
    dp: Array | None = None
    dtip: Array | None = None
    ds: Array | None = None
    dy: Array | None = None

    def times(self, factor: float) -> Push:
        """The same, larger."""
        parts = self._parts()
        return Push(**{k: v if v is None else factor * v for k, v in parts.items()})

    def plus(self, other: Push) -> Push:
        """Both at once."""
        mine, its = self._parts(), other._parts()
        return Push(**{k: _sum(mine[k], its[k]) for k in mine})

    def peak(self) -> float:
        """Largest addition, whatever it is added to."""
        parts = [v for v in self._parts().values() if v is not None]
        return max((float(np.abs(v).max()) for v in parts), default=0.0)

    def _parts(self) -> dict[str, Array | None]:
        return {f.name: getattr(self, f.name) for f in dataclasses.fields(self)}


def _sum(a: Array | None, b: Array | None) -> Array | None:
    return b if a is None else a if b is None else a + b


class Layout:
    """Of each of N readings its row, the row it is read against, its channel's sigma."""

    def __init__(self, plan: Plan) -> None:
        self.rows: list[Index] = []
        row, channel, sigma = [], [], []
        for k, setup in enumerate(plan.setups):
            here = np.flatnonzero((plan.setup == k) & (plan.kind == READ))
            count = len(setup.instrument.channels)
            self.rows.append(here)
            row.append(np.repeat(here, count))
            channel.append(np.tile(np.arange(count), len(here)))
            sigma.append(np.tile([s for _, s in setup.instrument.channels], len(here)))
        self.row = np.concatenate(row)
        self.ref = plan.ref[self.row]
        self.channel = np.concatenate(channel)
        self.sigma = np.concatenate(sigma)
        self.size = len(self.row)


class Motion:
    """Nominal motion along the rows: joints, rates (m/s), tool points, directions."""

    def __init__(self, plan: Plan) -> None:
        machine = plan.machine
        self.pose: Pose = machine.inverse(plan.command, plan.tool)
        self.q = self.pose.q
        self.tip = tip(machine, self.pose.x, self.pose.R0, plan.tool)
        self.axis = self.pose.R0[:, :, 2]
        self.leg = leg_direction(machine, self.pose)
        self.rate, self.acceleration = np.zeros_like(self.q), np.zeros_like(self.q)
        self.arc = np.zeros(len(self.q))
        for here, closed in zip(plan.runs, plan.closed, strict=True):
            self._along(here, closed, float(plan.feed[here[0]]))
        self.lift, self.lift_com = self._lifts(plan)

    def _along(self, here: Index, closed: bool, feed: float) -> None:
        ring = np.concatenate([here[-2:], here, here[:2]]) if closed else here
        steps = np.linalg.norm(np.diff(self.tip[ring], axis=0), axis=1)
        s = np.concatenate([[0.0], np.cumsum(steps)])
        rate = np.gradient(self.q[ring], s, axis=0)
        bend = np.gradient(rate, s, axis=0)
        keep = slice(2, -2) if closed else slice(None)
        self.rate[here] = feed * rate[keep]
        self.acceleration[here] = feed**2 * bend[keep]
        self.arc[here] = s[keep] - s[keep][0]

    def _lifts(self, plan: Plan) -> tuple[Array, Array]:
        """dz/dq (n, legs) of tool point and moving mass: forces by virtual work."""
        machine, pose = plan.machine, self.pose
        p = np.tile(machine.full, (len(pose.q), 1))
        by_x = slope(lambda v: machine.closure(v, pose.R0, pose.q, p), pose.x)
        by_q = slope(lambda v: machine.closure(pose.x, pose.R0, v, p), pose.q)
        dx = -np.linalg.solve(by_x, by_q)
        lifts = []
        for tool in (plan.tool, plan.tool * 0 + machine.com):
            up = slope(lambda v, t=tool: tip(machine, v, pose.R0, t)[:, 2:], pose.x)  # type: ignore[misc]
            lifts.append((up @ dx)[:, 0])
        return lifts[0], lifts[1]


class Scene:
    """A plan and a true machine.

    theta    what a calibration would identify: free parameters, then each set-up's
             unknowns; true values (m,)
    prior    their tolerances (m,)
    y        readings without any effect and noise (N,);  J: their slopes (N, m)
    """

    def __init__(self, plan: Plan, error: Array, state: Array) -> None:
        """error (np,) of the parameters, state (set-ups, STATE) of the set-ups; SI."""
        self.plan, self.layout, self.motion = plan, Layout(plan), Motion(plan)
        machine = plan.machine
        p = machine.full
        p[: len(error)] += error
        self.p = np.tile(p, (len(plan.command), 1))
        self.s = state[plan.setup]
        pose = self.motion.pose
        self.x, self.inverse = settle(machine, pose.x, pose.R0, pose.q, self.p)
        self.tip = tip(machine, self.x, pose.R0, plan.tool)
        self.y = self._observe(self.tip, self.s)
        self._slopes()
        self._theta(error, state)

    def read(self, push: Push | None = None) -> Array:
        """Exact readings (N,) with a disturbance."""
        if push is None:
            return self.y
        machine, pose = self.plan.machine, self.motion.pose
        at = self.tip
        if push.dq is not None or push.dp is not None:
            q = pose.q if push.dq is None else pose.q + push.dq
            p = self.p if push.dp is None else self.p + push.dp
            x = nearby(machine, self.x, self.inverse, pose.R0, q, p)
            at = tip(machine, x, pose.R0, self.plan.tool)
        if push.dtip is not None:
            at = at + push.dtip
        y = self._observe(at, self.s if push.ds is None else self.s + push.ds)
        return np.asarray(y if push.dy is None else y + push.dy)

    def response(self, push: Push) -> Array:
        """First order of `read(push) - y`, (N,)."""
        moved = np.zeros((len(self.tip), 3))
        if push.dq is not None:
            moved += np.einsum("nij,nj->ni", self.by_q, push.dq)
        if push.dp is not None:
            moved += np.einsum("nij,nj->ni", self.by_p, push.dp)
        if push.dtip is not None:
            moved += push.dtip
        row, ref = self.layout.row, self.layout.ref
        dy = (self.at_tip * moved[row]).sum(-1) + (self.at_ref * moved[ref]).sum(-1)
        if push.ds is not None:
            own = (self.at_s * push.ds[row]).sum(-1)
            dy += own + (self.at_sref * push.ds[ref]).sum(-1)
        return np.asarray(dy if push.dy is None else dy + push.dy)

    def _observe(self, at: Array, s: Array) -> Array:
        parts = []
        for setup, rows in zip(self.plan.setups, self.layout.rows, strict=True):
            ref, read = self.plan.ref[rows], setup.instrument.read
            values = read(at[rows], at[ref], s[rows], s[ref], setup.settings)
            parts.append(values.ravel())
        return np.concatenate(parts)

    def _slopes(self) -> None:
        machine, pose, tool = self.plan.machine, self.motion.pose, self.plan.tool
        by_x = slope(lambda v: tip(machine, v, pose.R0, tool), self.x)
        carry = by_x @ -self.inverse
        x, R0, q, p = self.x, pose.R0, pose.q, self.p
        self.by_q = carry @ slope(lambda v: machine.closure(x, R0, v, p), q)
        self.by_p = carry @ slope(lambda v: machine.closure(x, R0, q, v), p)
        parts: list[list[Array]] = [[], [], [], []]
        for setup, rows in zip(self.plan.setups, self.layout.rows, strict=True):
            ref = self.plan.ref[rows]
            known = [self.tip[rows], self.tip[ref], self.s[rows], self.s[ref]]
            for k in range(4):

                def one(
                    v: Array, k: int = k, known: Any = known, at: Any = setup
                ) -> Array:
                    points = [*known[:k], v, *known[k + 1 :]]
                    return at.instrument.read(*points, at.settings)

                parts[k].append(slope(one, known[k]).reshape(-1, known[k].shape[1]))
        self.at_tip, self.at_ref, self.at_s, self.at_sref = (
            np.concatenate(v) for v in parts
        )

    def _theta(self, error: Array, state: Array) -> None:
        """Names, true values, tolerances and slopes of what a calibration identifies."""
        machine, row, ref = self.plan.machine, self.layout.row, self.layout.ref
        free = np.flatnonzero(machine.tolerance > 0)
        J = [np.einsum("ni,nij->nj", self.at_tip, self.by_p[row][:, :, free])]
        J[0] += np.einsum("ni,nij->nj", self.at_ref, self.by_p[ref][:, :, free])
        names, values = [machine.parameters[k] for k in free], list(error[free])
        prior = list(machine.tolerance[free])
        for k, setup in enumerate(self.plan.setups):
            here = self.plan.setup[row] == k
            for column, tolerance in setup.instrument.nuisances.items():
                both = self.at_s[:, column] + self.at_sref[:, column]
                J.append((here * both)[:, None])
                names.append(f"{setup.name}.s{column}")
                values.append(state[k, column])
                prior.append(tolerance)
        self.names, self.theta = tuple(names), np.array(values)
        self.prior, self.J = np.array(prior), np.hstack(J)


def draw(rng: np.random.Generator, plan: Plan) -> Scene:
    """A true machine and set-ups, drawn from their tolerances."""
    machine = plan.machine
    error = rng.normal(size=len(machine.tolerance)) * machine.tolerance
    state = np.zeros((len(plan.setups), STATE))
    for k, setup in enumerate(plan.setups):
        for column, tolerance in setup.instrument.nuisances.items():
            state[k, column] = tolerance * rng.normal()
    return Scene(plan, error, state)
