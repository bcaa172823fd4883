"""A machine that does not assemble, as it is drawn: where its equations are met best."""

import dataclasses

from oed.base import Array


@dataclasses.dataclass(frozen=True)
class MachineShape:
    """A machine at a pose and joints, whether it assembles there or not; m."""

    equations: Array  #: (k,) values of the closure, m or rad
    lines: tuple[Array, ...]  #: polylines of points (n, 3), as the machine draws itself
    struts: Array  #: (nq, 2, 3) ends of the strut of each joint; none where it has none
    tool: Array  #: (3,) tool point
    axes: Array  #: (3, 3) of the platform, in columns


@dataclasses.dataclass(frozen=True)
class ClosestClosure:
    """A machine at the guess for a command, and where its equations are met best."""

    #: the machine there
    guess: MachineShape
    nearest: MachineShape
    joints: tuple[tuple[str, ...], ...]  #: names of the joints in each equation
    #: names of the joints that move each line of the drawing
    line_joints: tuple[tuple[str, ...], ...]
    still_open: tuple[int, ...]  #: equations, from 0, that are not met at the nearest
