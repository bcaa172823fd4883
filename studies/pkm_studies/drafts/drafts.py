"""Writes a study to start from: its machine, an instrument, and a draft that is sound."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable
from pathlib import Path

from oed.mechanism import AssemblyError
from oed.model import Machine
from pkm_studies import catalogue, files, shipped
from pkm_studies.base import InputError, Location
from pkm_studies.drafts import template, time_budget
from pkm_studies.drafts.axis_lines import SHARES
from pkm_studies.drafts.bodies import families
from pkm_studies.resolve import resolve
from pkm_studies.study import SUFFIX, Study
from pkm_studies.user_code import Origin

#: instruments to draft a study with, the most informative first
DEFAULTS = ("pose_tracker", "pose_tracker_position", "redundancy")


@dataclasses.dataclass(frozen=True)
class StartingModel:
    """A machine to start from.

    name       as a study names its model
    table      numbers of the machine in a study, where they are not the model's
    sentences  on what was read of a file
    """

    name: str
    machine: Machine
    table: str = ""
    sentences: tuple[str, ...] = ()

    @classmethod
    def named(
        cls, machine: str, origin: Origin, loops: Path | None = None
    ) -> StartingModel:
        """The machine of a name, of Python, MJCF or URDF with loops. Raises InputError."""
        if families.is_model_file(machine):
            described = families.described(origin.folder / machine, loops)
            name = described.machine.name
            table = families.study_tables(described)
            return cls(name, described.machine, table, described.sentences)
        location = Location("oed new").key("--machine")
        if loops is not None:
            raise location.error(
                "only URDF needs a table of loops", "leave out --loops", machine
            )
        return cls(machine, catalogue.machine(machine, origin, location))

    def default_instrument(self, origin: Origin) -> tuple[str, list[str]]:
        """An instrument that can read the machine as it stands, and the others that can.

        It is the first of DEFAULTS, or of the catalogue, whose settings all have defaults.
        Raises InputError where none can read it.
        """
        model = self.machine
        location = Location("oed new")
        names = [entry.name for entry in catalogue.listing("instruments")]
        tools = {
            name: catalogue.instrument(name, origin, location).for_machine(model)
            for name in names
        }
        able = [name for name in names if tools[name].unfit(model) is None]
        ready = [
            n for n in able if all(s.default is not None for s in tools[n].settings)
        ]
        chosen = next((name for name in DEFAULTS if name in ready), None)
        if chosen is None and not able:
            raise location.key("--instrument").error(
                f"no instrument of the catalogue can read {model.name}",
                "write one, see the reference, and name its file with --instrument",
            )
        chosen = chosen or [*ready, *able][0]
        return chosen, [name for name in able if name != chosen]


def write_draft(
    name: str | None,
    machine: str | StartingModel,
    instrument: str,
    origin: Origin,
    seconds: float | None = None,
    complete: Callable[[str], str] = str,
) -> Path:
    """Write NAME.study.toml into a folder; its path. Without a name, the machine's.

    origin    the folder, and whether the models' files may run
    seconds   that the readings may take; None: READINGS of them
    complete  makes the text of the study from a draft

    Raises InputError for a bad name, an existing file, an instrument that cannot read
    the machine, and too short a time.
    """
    location = Location("oed new")
    start = (
        StartingModel.named(machine, origin) if isinstance(machine, str) else machine
    )
    model = start.machine
    path = shipped.new_path(model.name if name is None else name, origin.folder)
    listed = catalogue.instrument(instrument, origin, location.key("--instrument"))
    tool = listed.for_machine(model)
    reason = tool.unfit(model)
    if reason is not None:
        raise location.key("--instrument").error(
            f"it cannot read {model.name}: {reason}", "take another", instrument
        )
    if tool.single:
        tool = tool.take_channels([tool.channels[0].name])
    study = path.name.removesuffix(SUFFIX)
    drafts = (
        template.draft_text(
            study, start.name, model, instrument, tool, share, start.table
        )
        for share in SHARES
    )
    draft = first_sound(map(complete, drafts), path, origin)
    if seconds is not None:
        draft = time_budget.with_time(draft, seconds, tool)
    return files.write_whole(path, draft)


def first_sound(drafts: Iterable[str], path: Path, origin: Origin) -> str:
    """The first draft whose poses the machine can take, or whose fault is another.

    A user's machine may reach less than its ranges say. Raises InputError where it does
    not even reach what lies near its home pose.
    """
    problems: list[InputError] = []
    for draft in drafts:
        try:
            # any number will do to check the others
            whole = draft.replace(template.OPEN, "0.0")
            resolve(Study.parse(whole, path, origin.consent), readings=())
        except (InputError, AssemblyError) as error:
            if not isinstance(error, InputError):
                error = InputError(str(error), "")
            problems.append(error)
            continue
        return draft
    problem = problems[0]
    raise InputError(
        f"no draft of a study passes its check: {problem.problem}",
        "check the machine's home pose, the ranges of commands and joints, and guess",
        file=problem.file,
        field=problem.field,
    )
