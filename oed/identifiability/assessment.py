"""Assessment of planned readings: what they determine, how well, and what would remedy it.

The assessment needs no reading, only the Jacobian H of the readings over the parameters.
`oed.identifiability.identifiability` finds its rank and null directions, and the
posterior covariance; `oed.identifiability.sentences`
puts the result into sentences.

Remedies for lost directions are additional readings, tried on the Jacobian H. Each trial
adds readings to the plan and counts the directions that no reading determines afterwards:
the same poses with a longer tool, with the tool's position or axis read as well, with
sensors on the machine's passive joints, or with another set-up of the study.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed import units
from oed.base import Array, Index
from oed.identifiability import identifiability
from oed.identifiability.identifiability import Identifiability, Scaling
from oed.instrument import Channel, Cost, Frame, Instrument, mount
from oed.measurement import Measurement, Series
from oed.model import Expr, Parameter, Values

#: readings as a machine with its set-ups, and their series
Readings = tuple[Measurement, Sequence[Series]]
TOOL_EXTENSION = 0.100  #: length (m) by which the trial's tool is longer


@dataclasses.dataclass(frozen=True)
class Assessment:
    """What a set of readings determines. All arrays are over the n free parameters."""

    measurement: Measurement  #: machine and set-ups
    series: tuple[Series, ...]  #: the readings
    #: rank, combinations and null directions of the scaled H
    identifiability: Identifiability
    scale: Array  #: (n,) factor by which each column of H was multiplied
    shrinkage: Array  #: (n,) posterior over prior standard deviation
    covariance: Array  #: (n, n) posterior covariance, in units of the tolerances

    @property
    def names(self) -> tuple[str, ...]:
        """Names (n,) of the free parameters."""
        return self.identifiability.names

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        series: Sequence[Series],
        scaling: Scaling = "length",
    ) -> "Assessment":
        """Assess readings of the nominal machine.

        Parameters of set-ups that `series` does not use are left out. `scaling` holds for
        the rank; shrinkage and covariance always use the tolerances. Raises AssemblyError
        where a pose cannot be assembled or is singular.
        """
        theta = measurement.nominal
        free = free_parameters(measurement, series)
        jacobian = measurement.jacobian(series, theta)
        h = identifiability.scaled_jacobian(measurement, series, jacobian, scaling)
        whitened = identifiability.scaled_jacobian(
            measurement, series, jacobian, "tolerance"
        )
        scale = identifiability.column_scale(measurement, scaling)[free]
        covariance = identifiability.posterior_covariance(whitened[:, free])
        names = [measurement.names[k] for k in free]
        return cls(
            measurement=measurement,
            series=tuple(series),
            identifiability=identifiability.analyse(h[:, free], names, scale),
            scale=scale,
            shrinkage=np.sqrt(np.diag(covariance)),
            covariance=covariance,
        )


def free_parameters(measurement: Measurement, series: Sequence[Series]) -> Index:
    """Indices of the free parameters of the machine and of the set-ups in use."""
    setups = {measurement.setups[s.setup].owner for s in series}
    indices = []
    for k, name in enumerate(measurement.names):
        setup, _, _ = name.rpartition(".")
        if measurement.free[k] and (not setup or setup in setups):
            indices.append(k)
    return np.array(indices, dtype=np.intp)


#: additional readings in words, and the number of directions lost with them
Trial = tuple[str, int]


def recoveries(
    assessment: Assessment, alternatives: Mapping[str, Readings]
) -> list[str]:
    """Phrases on trials, and `alternatives`, that recover lost directions."""
    lost = len(assessment.names) - assessment.identifiability.rank
    trials = [
        *_longer_tool(assessment),
        *_more_pose_components(assessment),
        *_passive_sensors(assessment),
        *_alternatives(assessment, alternatives),
    ]
    return [
        f"{readings} recovers {_recovered(lost, remaining)}"
        for readings, remaining in trials
        if remaining < lost
    ]


def _recovered(before: int, after: int) -> str:
    if after > 0:
        return f"{before - after} of {before} lost directions"
    return "all lost directions" if before > 1 else "the lost direction"


def _lost_directions(
    measurement: Measurement, series: Sequence[Series], further: Array | None = None
) -> int:
    """Number of directions that readings, and further rows (N, n) of H, do not determine."""
    rows = measurement.jacobian(series, measurement.nominal)
    rows *= measurement.reading_length_factors(series)[:, None]
    if further is not None:
        rows = np.vstack([rows, further])
    free = free_parameters(measurement, series)
    singular_values = np.linalg.svd(
        (rows / measurement.length_factors)[:, free], compute_uv=False
    )
    threshold = identifiability.RANK_TOLERANCE * singular_values[0]
    return int(len(free) - np.count_nonzero(singular_values > threshold))


def _longer_tool(assessment: Assessment) -> list[Trial]:
    """The same joint positions with a longer tool, in set-ups of their own."""
    if not _rotates(assessment):
        return []
    names = dict.fromkeys(s.setup for s in assessment.series)
    setups = [assessment.measurement.setups[name] for name in names]
    extended = []
    for setup in setups:
        x, y, z = setup.tool
        tool = (x, y, z + TOOL_EXTENSION)
        extended.append(
            dataclasses.replace(setup, name=_extended_name(setup.name), tool=tool)
        )
    repeated = [
        dataclasses.replace(s, setup=_extended_name(s.setup)) for s in assessment.series
    ]
    trial = assessment.measurement.with_setups([*setups, *extended])
    lost = _lost_directions(trial, [*assessment.series, *repeated])
    extension = f"{units.number(TOOL_EXTENSION, 'mm'):.0f} mm"
    return [(f"a second tool, {extension} longer, in a set-up of its own", lost)]


def _extended_name(setup: str) -> str:
    return f"{setup}, longer tool"


def _rotates(assessment: Assessment) -> bool:
    pose = assessment.measurement.machine.pose
    return any(coordinate.unit == "rad" for coordinate in pose)


def _more_pose_components(assessment: Assessment) -> list[Trial]:
    """The same poses with more of the pose read, by a tracker in a known frame."""
    measurement, series = assessment.measurement, assessment.series
    position, axis, pose = _pose_jacobians(assessment)

    def lost_with(jacobian: Array) -> int:
        unrelated = len(measurement.names) - jacobian.shape[1]
        padded = np.hstack([jacobian, np.zeros((len(jacobian), unrelated))])
        return _lost_directions(measurement, series, padded)

    frame = "in a known frame,"
    trials = [(f"reading the tool's position too, {frame}", lost_with(position))]
    if _rotates(assessment):
        trials += [
            (f"reading the tool axis' direction too, {frame}", lost_with(axis)),
            (f"reading all six pose components, {frame}", lost_with(pose)),
        ]
    return trials


def _pose_jacobians(assessment: Assessment) -> tuple[Array, Array, Array]:
    """Slopes (rows, n_machine) of tool position, tool axis and full pose, all poses."""
    measurement = assessment.measurement
    kinematics = measurement.kinematics
    nominal = measurement.nominal[: len(measurement.machine.parameters)]
    position, axis, pose = [], [], []
    for s in assessment.series:
        tool = np.array(measurement.setups[s.setup].tool)
        x = measurement.poses(s, measurement.nominal)
        rotation, _, twist = kinematics.frames(x, tool)
        jacobian = twist @ kinematics.slopes.pose_by_parameter(x, s.q, nominal)
        in_tool_frame = np.swapaxes(rotation, 1, 2) @ jacobian[:, 3:]
        parameters = jacobian.shape[2]
        position.append(jacobian[:, :3].reshape(-1, parameters))
        axis.append(in_tool_frame[:, :2].reshape(-1, parameters))
        pose.append(jacobian.reshape(-1, parameters))
    return np.vstack(position), np.vstack(axis), np.vstack(pose)


def _passive_sensors(assessment: Assessment) -> list[Trial]:
    """The same joint positions with every passive joint read; zeros are unknown."""
    measurement = assessment.measurement
    joints = measurement.machine.passive_joints()
    if not joints:
        return []
    names = [joint.name for joint in joints]

    def observe(frames: Sequence[Frame], s: Values, k: Values) -> list[Expr]:
        return [frames[0].passive[name] + s[name] for name in names]

    sensors = Instrument(
        name="sensors on passive joints",
        source="",
        channels=tuple(Channel(j.name, j.unit, 1.0) for j in joints),
        settings=(),
        nuisances=tuple(Parameter(j.name, 0.0, 1.0, j.unit) for j in joints),
        cost=Cost(0.0, 0.0),
        observe=observe,
    )
    setup = mount(sensors, sensors.name)
    trial = measurement.with_setups([*measurement.setups.values(), setup])
    series = [*assessment.series]
    # the readings' own poses, without a reference
    series += [
        dataclasses.replace(s, setup=setup.name, index=s.index[:, :1])
        for s in assessment.series
    ]
    lost = _lost_directions(trial, series)
    return [(f"sensors on the passive joints, {', '.join(names)},", lost)]


def _alternatives(
    assessment: Assessment, alternatives: Mapping[str, Readings]
) -> list[Trial]:
    """The plan together with each of the study's other readings."""
    trials = []
    for name, (measurement, series) in alternatives.items():
        together = [*assessment.series, *series]
        setups = {**measurement.setups, **assessment.measurement.setups}
        used = {s.setup for s in together}
        chosen = [setup for key, setup in setups.items() if key in used]
        joint = measurement.with_setups(chosen)
        lost = _lost_directions(joint, together)
        trials.append((f"adding the readings of {name}", lost))
    return trials
