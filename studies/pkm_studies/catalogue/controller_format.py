"""What an export holds, and what a format is."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from oed.base import Array
from oed.model import Machine
from oed.result import EffectTable
from oed.text import shorten
from pkm_studies.base import InputError

if TYPE_CHECKING:
    from oed.compensate import CommandGrid, FurtherAxes
    from oed.mechanism import Kinematics
    from pkm_studies.tables import ControllerTable

MAX_COMMENT_LENGTH = 1000  #: characters of a comment, which holds text of results
#: texts of an export by the end of their file names, such as `.cfg`
Texts = Mapping[str, str]


@dataclasses.dataclass(frozen=True)
class Identified:
    """Identified parameters of a machine, SI.

    values      (np,)
    sd          (np,) 0 for parameters that are held
    origin      section of result.json that they come from
    conditions  what they rest on, in sentences
    """

    values: Array
    sd: Array
    origin: str
    conditions: tuple[str, ...] = ()


@dataclasses.dataclass(frozen=True)
class MeasuringPose:
    """A pose to measure: set-up, run, and command (n_dof,), SI."""

    setup: str
    run: str
    command: Array


@dataclasses.dataclass(frozen=True)
class Compensation:
    """What an export writes.

    study       name of the study
    version     of the program
    machine     with the study's nominal numbers: the controller's model so far
    kinematics  of it
    identified  parameters
    command     (n, n_dof) commands over the workspace, SI, at which accuracy counts
    poses       to measure
    notes       sentences that go into every file as comments
    tables      joint corrections of effects by state, for formats that hold them
    grid        of the commands of a table, for formats that hold one
    controller  what the study says of the machine's firmware
    held        what the controller holds so far, as the study names it; "" for nominal
                numbers. The export takes its place
    draws       (n, np) parameters drawn from the posterior, for formats that hold them
    forecast    joints (n, nq) to add at commands, SI, for errors that were measured at
                nodes; None without
    """

    study: str
    version: str
    machine: Machine
    kinematics: Kinematics
    identified: Identified
    command: Array
    poses: tuple[MeasuringPose, ...]
    notes: tuple[str, ...]
    tables: tuple[EffectTable, ...] = ()
    grid: CommandGrid | None = None
    controller: ControllerTable | None = None
    held: str = ""
    draws: Array | None = None
    forecast: Callable[[Array], Array] | None = None

    @property
    def tabled(self) -> Array:
        """Commands (n, n_dof) of the table, SI: the grid's, or those of the workspace."""
        return self.command if self.grid is None else self.grid.commands

    @functools.cached_property
    def further(self) -> FurtherAxes:
        """The motions that no joint of the machine makes; none for most machines."""
        # imported here: light commands list formats without compensation
        from oed.compensate import FurtherAxes

        return FurtherAxes.of(self.kinematics)

    @property
    def comments(self) -> list[str]:
        """Comments that open every file, a line each: what follows would be a command."""
        title = f"pkm-oed {self.version}, study {self.study}"
        machine = f"machine {self.machine.name}"
        return [
            shorten(line, MAX_COMMENT_LENGTH) for line in (title, machine, *self.notes)
        ]

    def commented(self, mark: str, lines: Iterable[str]) -> str:
        """The text of a file: the comments, each behind a mark, then the lines."""
        comments = [f"{mark} {comment}" for comment in self.comments]
        return "\n".join([*comments, *lines, ""])

    def parameter(self, name: str) -> float:
        """An identified parameter, SI. Raises KeyError."""
        return float(self.identified.values[self.machine.index(name)])


@dataclasses.dataclass(frozen=True, kw_only=True)
class ControllerFormat:
    """A file format of a controller.

    name, about, source    for the catalogue
    write(compensation)    texts by the end of their file names
    joints(texts, compensation)
                           joints (n, nq), SI, that the controller drives to for the
                           compensation's commands, by its own formula from these
                           texts; None where the file does not decide them
    notes(compensation)    sentences on what the file is for and does not hold; they go
                           into the file
    versions               whether the file depends on the version of the firmware
    offsets(texts, compensation)
                           offsets (n, m), SI, for the m additional axes of the machine, as
                           these texts hold them at the commands; None where they hold
                           none
    unfit(machine)         why the controller cannot drive a machine, in words; None
                           where it can
    tables                 whether the file holds tables of effects
    table                  whether it holds a table over `compensation.tabled`
    interpolated           whether the controller has the nominal model, and adds joint
                           corrections in straight lines between these commands
    draws                  whether it holds draws of the posterior
    """

    name: str
    about: str
    source: str
    write: Callable[[Compensation], Texts]
    joints: Callable[[Texts, Compensation], Array] | None = None
    offsets: Callable[[Texts, Compensation], Array] | None = None
    unfit: Callable[[Machine], str | None] = lambda machine: None
    notes: Callable[[Compensation], tuple[str, ...]] = lambda compensation: ()
    versions: bool = False
    tables: bool = False
    table: bool = False
    interpolated: bool = False
    draws: bool = False

    def driven_joints(self, texts: Texts, content: Compensation) -> Array:
        """`joints` (n, nq), which the format has. Raises InputError for other shapes."""
        joints = np.asarray(self.joints and self.joints(texts, content))
        shape = len(content.command), len(content.machine.joints)
        if joints.shape != shape or not np.isfinite(joints).all():
            raise InputError(
                f"its joints {joints.shape} are not {shape} finite numbers",
                "mend `joints` of the format: a row a command, a column a joint",
                value=f"--to {self.name}",
            )
        return joints

    def with_others(self, others: Mapping[str, ControllerFormat]) -> ControllerFormat:
        """This format, with others for machines of these names."""

        def chosen(machine: Machine) -> ControllerFormat:
            return others.get(machine.name, self)

        def joints(texts: Texts, content: Compensation) -> Array:
            return chosen(content.machine).driven_joints(texts, content)

        return dataclasses.replace(
            self,
            write=lambda content: chosen(content.machine).write(content),
            joints=joints,
            unfit=lambda machine: chosen(machine).unfit(machine),
            notes=lambda content: chosen(content.machine).notes(content),
        )
