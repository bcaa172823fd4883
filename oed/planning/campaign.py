"""A plan carried out on virtual machines, exactly: what its prediction is worth.

A machine with true parameters drawn from the tolerances goes through the stages. In
each, the controller believes in the parameters p_hat identified so far and sends the
joints q = q(command, p_hat). Readings are those of the exact closure at the true
parameters, with noise; they are lost where they lie farther from what p_hat lets expect
than the instrument's travel. All readings taken so far are then fitted together from
the tolerances on, which to first order is handing the posterior on. What identification
leaves is the pose error between the true and the believed machine,

    e = x(q, p) - x(q, p_hat) ~ A delta,        delta ~ N(0, S')        (`known` of `oed.predict`),

compared with the covariance S' that the planner foresaw after the stage.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed import compensate, predict, simulate
from oed.arrays import Array, Index, Mask
from oed.compensate import NO_TOOL, ErrorModel
from oed.instrument import Setup
from oed.kinematics import Kinematics
from oed.measurement import Measurement, Series
from oed.planning.known import roots
from oed.planning.refit import refit
from oed.planning.stage import Stage

#: standard deviations to either side of a 95 % interval
SIDES = 1.959964
#: share of a component's widest interval below which one is not looked at
STILL = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class Checked:
    """One stage, over all virtual machines.

    name                    of the option
    predicted, realised     (K,) root mean square of each pose component over workspace
                            and machines, SI
    lost_predicted, lost    share of the planned candidates that could not be read
    held                    share of the true machine parameters within the 95 %
                            intervals of their estimates
    held_poses              share of the true pose errors within their 95 % intervals
    """

    name: str
    predicted: Array
    realised: Array
    lost_predicted: float
    lost: float
    held: float
    held_poses: float

    @property
    def ratio(self) -> Array:
        """Realised over predicted (K,); NaN for a component that nothing moves."""
        moved = self.predicted > 0.0
        return np.asarray(
            np.where(
                moved, self.realised / np.where(moved, self.predicted, 1.0), np.nan
            )
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Campaign:
    """A plan's stages on `machines` virtual machines; `names` (K,) of the pose
    components.
    """

    names: tuple[str, ...]
    machines: int
    stages: tuple[Checked, ...]


def carry_out(
    stages: Sequence[Stage],
    command: Array,
    machines: int,
    rng: np.random.Generator,
    *,
    reference: predict.Reference = "home",
    compensated: bool = True,
    start: Array | None = None,
    progress: Callable[[float], None] | None = None,
) -> Campaign:
    """Virtual machines through the stages, looked at over workspace commands (n,
    n_dof), SI.

    compensated  whether the controller is told what was identified after each stage;
                 else it stays nominal, and so do the values expected of an instrument
                 with travel
    start        (n, n) covariance of the machine's free parameters before, in units of
                 their tolerances; those alone where it is not told. Machines are drawn
                 from it about the nominal one

    Raises ValueError where there is no stage or no machine, IdentificationError where a
    fit does not converge.
    """
    if not stages or machines < 1:
        raise ValueError(
            f"{len(stages)} stages and {machines} machines: at least one of each is"
            " needed"
        )
    work = _Work(
        _steps(stages),
        _Workspace.of(stages[0].option.measurement, command, reference),
        compensated,
        start,
    )
    looked = []
    for k in range(machines):
        looked.append(work.machine(rng))
        if progress is not None:
            progress((k + 1) / machines)
    told = []
    for k, stage in enumerate(stages):
        each = [machine[k] for machine in looked]
        told.append(
            Checked(
                name=stage.option.name,
                predicted=work.space.predicted(stage.covariance),
                realised=np.sqrt(np.mean([e.square for e in each], axis=0)),
                lost_predicted=float(1.0 - stage.available.mean()),
                lost=float(np.mean([e.lost for e in each])),
                held=float(np.mean([e.held for e in each])),
                held_poses=float(np.mean([e.held_poses for e in each])),
            )
        )
    return Campaign(work.space.maps.names, machines, tuple(told))


# -- the workspace: what is left there -------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Looked:
    """One machine after one stage: mean square (K,) of its errors, and shares."""

    square: Array
    lost: float
    held: float
    held_poses: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Workspace:
    """Commands at which errors are looked at; `tolerance` (np,) of the machine's
    parameters, SI.
    """

    kinematics: Kinematics
    tolerance: Array
    maps: predict.ErrorMaps
    about: tuple[ErrorModel, ErrorModel]
    reference: predict.Reference

    @classmethod
    def of(
        cls, measurement: Measurement, command: Array, reference: predict.Reference
    ) -> _Workspace:
        kinematics = measurement.kinematics
        maps = predict.error_maps(kinematics, command, reference)
        home = kinematics.machine.home_command[None]
        about = (
            compensate.error_model(kinematics, command),
            compensate.error_model(kinematics, home),
        )
        return cls(
            kinematics,
            measurement.tolerance[: len(kinematics.machine.parameters)],
            maps,
            about,
            reference,
        )

    def predicted(self, covariance: Array) -> Array:
        """Root mean square (K,), SI, with a covariance (n, n) of the free parameters in
        units of their tolerances.
        """
        free = np.flatnonzero(self.tolerance > 0.0)
        full = np.zeros((len(self.tolerance), len(self.tolerance)))
        full[np.ix_(free, free)] = covariance * np.outer(
            self.tolerance[free], self.tolerance[free]
        )
        return np.asarray(np.sqrt(np.mean(self.variance(full), axis=0)))

    def variance(self, covariance: Array) -> Array:
        """Variance (n, K) of the components at each command, from a covariance (np,
        np), SI.
        """
        told = np.einsum(
            "nkp,pq,nkq->nk", self.maps.raw, covariance, self.maps.raw, optimize=True
        )
        return np.asarray(np.maximum(told, 0.0))

    def errors(self, controller: Array, believed: Array, truth: Array) -> Array:
        """Components (n, K) of the exact pose error between true and believed machine
        (np,), by the controller's joints.
        """
        twists, about = [], []
        for model in self.about:
            start, q = self.kinematics.inverse(model.command, controller)
            rotation, point, _ = self.kinematics.frames(
                self.kinematics.forward(q, believed, start), NO_TOOL
            )
            other, other_point, _ = self.kinematics.frames(
                self.kinematics.forward(q, truth, start), NO_TOOL
            )
            twists.append(compensate.twist_between(rotation, point, other, other_point))
            # a lost turn at home is zeroed about the axes of the believed machine, not
            # of the nominal one
            about.append(dataclasses.replace(model, rotation=rotation, point=point))
        lever = self.kinematics.machine.lever
        told = predict.referenced(
            twists[0], twists[1], about[0], about[1], self.reference, lever
        )
        return self.kinematics.components(self.maps.command, told)

    def look(
        self,
        controller: Array,
        believed: Array,
        truth: Array,
        covariance: Array,
        lost: float,
    ) -> _Looked:
        """What is left, and whether the intervals of a covariance (np, np), SI, hold
        it.
        """
        errors = self.errors(controller, believed, truth)
        half = SIDES * np.sqrt(self.variance(covariance))
        # what hardly moves, as at home itself, has an interval and an error of rounding
        moved, free = half > STILL * half.max(axis=0), self.tolerance > 0.0
        held = (
            np.abs(truth - believed)[free] <= SIDES * np.sqrt(np.diag(covariance))[free]
        )
        poses = (np.abs(errors) <= half)[moved]
        return _Looked(
            np.mean(errors**2, axis=0), lost, float(held.mean()), float(poses.mean())
        )


# -- the stages ------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Step:
    """A stage. measurement: all set-ups up to it, so that its parameters begin with
    those of the stage before.

    series planned; candidate of each of their readings' numbers (N,), as all channels
    lie in `measurement.readings`; first: those that are a reading's first channel,
    which the travel is about
    """

    measurement: Measurement
    series: tuple[Series, ...]
    candidate: Index
    first: Mask
    travel: float | None

    def taken(
        self,
        truth: Array,
        believed: Array,
        controller: Array | None,
        rng: np.random.Generator,
    ) -> _Taken:
        """Readings of a machine with parameters `truth` where those of `believed` are
        expected (n,).
        """
        measurement = self.measurement
        sent = [self._sent(s, controller) for s in self.series]
        exact = measurement.try_readings(sent, truth)
        y = exact + measurement.noise(sent).draw(rng, exact.shape)
        # a pose that cannot be assembled cannot be read
        bad = np.isnan(exact)
        if self.travel is not None:
            off = np.abs(exact - measurement.try_readings(sent, believed))
            bad |= self.first & ~(off <= self.travel)
        whole = np.bincount(self.candidate, bad) == 0
        keep = whole[self.candidate]
        series, start = [], 0
        for s in sent:
            channels = len(measurement.setups[s.setup].sigma)
            mine = keep[start : start + channels * len(s) : channels]
            start += channels * len(s)
            if mine.any():
                series.append(s.take(np.flatnonzero(mine)))
        return _Taken(tuple(series), y[keep], float(1.0 - whole.mean()))

    def _sent(self, series: Series, controller: Array | None) -> Series:
        """The same readings with the joints that the controller sends; recorded joints
        stay as they are.
        """
        if controller is None or np.isnan(series.command).any():
            return series
        tool = np.array(self.measurement.setups[series.setup].tool)
        x, q = self.measurement.kinematics.inverse(series.command, controller, tool)
        return dataclasses.replace(series, q=q, start=x)


@dataclasses.dataclass(frozen=True, eq=False)
class _Taken:
    """Series with readings y, SI, and the share of the planned candidates that is lost."""

    series: tuple[Series, ...]
    y: Array
    lost: float


def _steps(stages: Sequence[Stage]) -> tuple[_Step, ...]:
    setups: list[Setup] = []
    steps = []
    for k, stage in enumerate(stages):
        mounted = stage.option.measurement
        # a set-up mounted in two stages stands elsewhere in each: it has its own name
        # and unknowns
        setups += [
            dataclasses.replace(s, name=_named(k, s.name))
            for s in mounted.setups.values()
        ]
        chosen = np.sort(stage.chosen)
        taken = stage.option.taken(chosen)
        channels = np.concatenate(
            [np.full(len(s), len(mounted.setups[s.setup].sigma)) for s in taken]
        )
        reading = np.repeat(
            np.arange(len(chosen)), stage.option.candidates.members[chosen, 1]
        )
        first = np.zeros(channels.sum(), dtype=bool)
        first[np.cumsum(channels) - channels] = True
        series = tuple(dataclasses.replace(s, setup=_named(k, s.setup)) for s in taken)
        measurement = Measurement(mounted.machine, setups)
        steps.append(
            _Step(
                measurement,
                series,
                np.repeat(reading, channels),
                first,
                stage.option.travel,
            )
        )
    return tuple(steps)


def _named(stage: int, setup: str) -> str:
    return f"{stage + 1}. {setup}"


@dataclasses.dataclass(frozen=True, eq=False)
class _Work:
    steps: tuple[_Step, ...]
    space: _Workspace
    compensated: bool
    start: Array | None

    def root(self, measurement: Measurement) -> Array | None:
        """R (free, free) with R R^T what is known of machine and set-ups before; None
        for the tolerances alone.
        """
        if self.start is None:
            return None
        made, n = np.eye(int(measurement.free.sum())), len(self.start)
        made[:n, :n] = roots(self.start[None])[0]
        return made

    def drawn(self, measurement: Measurement, rng: np.random.Generator) -> Array:
        """True parameters (n,) of a machine and of all set-ups."""
        truth, root = simulate.draw(measurement, rng), self.root(measurement)
        if root is not None:
            free, nominal, tolerance = (
                measurement.free,
                measurement.nominal,
                measurement.tolerance,
            )
            truth[free] = nominal[free] + tolerance[free] * (
                root @ ((truth - nominal)[free] / tolerance[free])
            )
        return truth

    def before(self, measurement: Measurement) -> Array:
        """Covariance (n, n) before, SI."""
        root, free = self.root(measurement), measurement.free
        made = np.diag(measurement.tolerance**2)
        if root is not None:
            scaled = measurement.tolerance[free, None] * root
            made[np.ix_(free, free)] = scaled @ scaled.T
        return made

    def machine(self, rng: np.random.Generator) -> list[_Looked]:
        """One virtual machine through all stages."""
        truth = self.drawn(self.steps[-1].measurement, rng)
        keep = len(self.space.tolerance)
        nominal = theta = self.space.kinematics.machine.nominal
        series: tuple[Series, ...] = ()
        y: list[Array] = []
        looked = []
        for step in self.steps:
            measurement = step.measurement
            # the unknowns of the set-ups mounted now are believed nominal
            believed = np.concatenate([theta, measurement.nominal[len(theta) :]])
            expected = believed if self.compensated else measurement.nominal
            controller = believed[:keep] if self.compensated else None
            taken = step.taken(truth[: len(believed)], expected, controller, rng)
            series, y = series + taken.series, [*y, taken.y]
            theta, covariance = believed, self.before(measurement)
            if series:
                found = refit(
                    measurement,
                    series,
                    np.concatenate(y),
                    believed,
                    self.root(measurement),
                )
                theta, covariance = found.theta, found.covariance
            sends = theta[:keep] if self.compensated else nominal
            looked.append(
                self.space.look(
                    sends,
                    theta[:keep],
                    truth[:keep],
                    covariance[:keep, :keep],
                    taken.lost,
                )
            )
        return looked
