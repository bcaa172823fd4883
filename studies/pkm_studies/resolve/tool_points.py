"""Commands that put the tool on given points of the base frame."""

from collections.abc import Mapping, Sequence

import numpy as np
import scipy  # its parts load when first used

from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Machine
from pkm_studies import quantities
from pkm_studies.base import Location

SAMPLES = 600  #: sampled commands
STEPS = 30  #: steps of the solution, at most
SLOPE_STEP = 1e-6  #: step of a difference quotient, m or rad
MISS = 1e-8  #: miss that is accepted, m
MAX_STEP = 0.2  #: largest step, over a coordinate's range
#: digits of a command, m or rad: less is rounding of the solution
COMMAND_DECIMALS = 12
AXES = "xyz"


class ToolPoints:
    """Tool points of commands, and commands of tool points, of one set-up's tool."""

    def __init__(self, kinematics: Kinematics, tool: Sequence[float]) -> None:
        self._kinematics = kinematics
        self._machine = kinematics.machine
        self._tool = np.array(tool)
        self._workspace = kinematics.machine.workspace(self._tool.tolist())
        self._samples: dict[tuple[float, ...], tuple[Array, Array]] = {}

    def points(self, command: Array) -> Array:
        """Tool points (n, 3) at commands (n, n_dof), m; NaN where out of reach."""
        return self.frames(command)[1]

    def frames(self, command: Array) -> tuple[Array, Array]:
        """The platform's rotations (n, 3, 3) as well; NaN where out of reach."""
        rotations = np.full((len(command), 3, 3), np.nan)
        points = np.full((len(command), 3), np.nan)
        reached = np.arange(len(command))
        while reached.size:
            try:
                x, _ = self._kinematics.inverse(command[reached], None, self._tool)
            except AssemblyError as error:
                reached = np.delete(reached, error.indices)
                continue
            rotations[reached], points[reached], _ = self._kinematics.frames(
                x, self._tool
            )
            break
        return rotations, points

    def commands(
        self, points: Array, fixed: Mapping[str, float], location: Location
    ) -> Array:
        """Commands (n, n_dof) at points (n, 3), m, some given, SI. Raises InputError."""
        free = self._free(fixed, location)
        command = self._starts(points, fixed, free)
        for _ in range(STEPS):
            miss = self.points(command) - points
            if np.nanmax(np.abs(miss), initial=0.0) < MISS:
                break
            slope = self._slope(command, free)
            step = -np.einsum("nij,nj->ni", np.linalg.pinv(slope), miss)
            command[:, free] += self._shortened(np.nan_to_num(step), free)
        missed = np.linalg.norm(self.points(command) - points, axis=1)
        self._check(missed, points, location)
        return command.round(COMMAND_DECIMALS)

    def _free(self, fixed: Mapping[str, float], location: Location) -> list[int]:
        """Columns of the coordinates to solve for, three at most."""
        names = [c.name for c in self._machine.command]
        free = [k for k, name in enumerate(names) if name not in fixed]
        if len(free) > len(AXES):
            free = [k for k in free if names[k] in AXES]
        if free and len(free) <= len(AXES):
            return free
        angles = [
            quantities.column(c.name, c.unit)
            for c in self._machine.command
            if c.name not in fixed and c.name not in AXES
        ]
        raise location.error(
            "the points do not fix the pose", f"give values for some of {angles}"
        )

    def _starts(
        self, points: Array, fixed: Mapping[str, float], free: list[int]
    ) -> Array:
        """Commands (n, n_dof) whose tool points are near the points."""
        home = self._machine.home_command.copy()
        for k, coordinate in enumerate(self._machine.command):
            home[k] = fixed.get(coordinate.name, home[k])
        key = (*home, *free)
        if key not in self._samples:
            self._samples[key] = self._sampled(home, free)
        samples, tips = self._samples[key]
        if not len(samples):
            return np.tile(home, (len(points), 1))
        _, nearest = scipy.spatial.KDTree(tips).query(points)
        return np.asarray(samples[nearest])

    def _sampled(self, home: Array, free: list[int]) -> tuple[Array, Array]:
        """Commands (n, n_dof) over the workspace that are reached, and tool points."""
        samples = np.tile(home, (SAMPLES, 1))
        lower, upper = ranges(self._machine, self._tool.tolist())
        from scipy.stats import qmc  # takes a second to import

        shares = qmc.Halton(len(free), scramble=False).random(SAMPLES)
        samples[:, free] = lower[free] + shares * (upper - lower)[free]
        tips = self.points(samples)
        reached = np.isfinite(tips).all(axis=1)
        return samples[reached], tips[reached]

    def _slope(self, command: Array, free: list[int]) -> Array:
        """d tool point / d free coordinates (n, 3, k), by central differences."""
        columns = []
        for k in free:
            step = np.zeros(command.shape[1])
            step[k] = SLOPE_STEP
            change = self.points(command + step) - self.points(command - step)
            columns.append(change / (2.0 * SLOPE_STEP))
        return np.nan_to_num(np.stack(columns, axis=-1))

    def _shortened(self, step: Array, free: list[int]) -> Array:
        """Steps (n, k), none longer than a share of the coordinates' ranges."""
        lower, upper = ranges(self._machine, self._tool.tolist())
        share = np.abs(step) / (MAX_STEP * (upper - lower)[free])
        return np.asarray(step / np.maximum(1.0, share.max(axis=1))[:, None])

    def _check(self, missed: Array, points: Array, location: Location) -> None:
        lost = np.flatnonzero(~(missed < 100.0 * MISS))
        if lost.size:
            pose_text = ", ".join(
                quantities.format_value(v, "m") for v in points[lost[0]]
            )
            raise location.error(
                f"the tool of {self._machine.name} cannot be put on {lost.size} of"
                f" {len(points)} points, the first at {pose_text}",
                "move the points into the workspace, in coordinates of the base frame",
            )


def ranges(machine: Machine, tool: Sequence[float]) -> tuple[Array, Array]:
    """Lower and upper ends (n_dof,) of the command; about home where there is no end."""
    reach = {"m": machine.lever, "rad": np.pi}
    lower, upper = [], []
    for coordinate in machine.workspace((tool[0], tool[1], tool[2])):
        home = machine.home[coordinate.name]
        half = reach.get(coordinate.unit, 1.0)
        low, high = coordinate.lower, coordinate.upper
        lower.append(low if np.isfinite(low) else home - half)
        upper.append(high if np.isfinite(high) else home + half)
    return np.array(lower), np.array(upper)
