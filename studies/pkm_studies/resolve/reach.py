"""Commands that a machine cannot reach, in words."""

from __future__ import annotations

from oed.base import Array
from oed.mechanism import AssemblyError
from oed.model import Machine
from pkm_studies.base import Location
from pkm_studies.quantities import format_value

#: remedy for poses out of reach
REACH_REMEDY = (
    "keep to poses the machine can reach; check tool and units, and well inside the"
    " workspace the model's guess"
)


def check_joint_range(
    machine: Machine,
    command: Array,
    q: Array,
    location: Location,
    remedy: str = "keep to poses within",
) -> None:
    """Raises InputError where joints (n, nq) at commands (n, n_dof) leave their range."""
    outside = machine.joints_out_of_range(q)
    if not outside:
        return
    first = [entry for entry in outside if entry[1] == outside[0][1]]
    row, name, value, lower, upper = max(
        first, key=lambda entry: max(entry[3] - entry[2], entry[2] - entry[4])
    )
    unit = next(joint.unit for joint in machine.joints if joint.name == name)
    needed, low, high = (format_value(v, unit) for v in (value, lower, upper))
    pose = pose_words(machine, command[row])
    raise location.error(
        f"the pose {pose} needs {name} = {needed}, outside the joint's range",
        f"{name} goes from {low} to {high}: {remedy}",
    )


def pose_words(machine: Machine, command: Array) -> str:
    """A command (n_dof,), SI, in the units in which a person writes it."""
    values = zip(machine.command, command, strict=True)
    return ", ".join(f"{c.name} = {format_value(v, c.unit)}" for c, v in values)


def reach_problem(error: AssemblyError, machine: Machine) -> str:
    """How many commands cannot be reached, the first one, and why."""
    if error.first is None:
        return str(error)
    poses = "1 pose" if len(error.indices) == 1 else f"{len(error.indices)} poses"
    first = pose_words(machine, error.first)
    return f"{poses} cannot be reached, the first at {first}: {error.reason}"
