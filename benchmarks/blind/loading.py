"""Loading of what a diagnosis may read: cases, studies, readings, the library.

Labels and truth are no business of this module; the runner has no other way to a case.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from pathlib import Path

from oed import dataset
from oed.gap.data import problem as problem_of
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement
from oed.model.effect import Effect
from pkm_studies import study
from pkm_studies.resolve import gap_request, resolve

HERE = Path(__file__).resolve().parent


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """A case as the manifest names it.

    id          of the case
    study       name of the study file, in this module's folder
    readings    path of the readings, relative to the set's folder
    """

    id: str
    study: str
    readings: str

    @property
    def machine(self) -> str:
        """Machine in the study's name."""
        return self.plan.rpartition("_")[0]

    @property
    def plan(self) -> str:
        """Machine and plan: the study's name."""
        return self.study.removesuffix(".study.toml")


@dataclasses.dataclass(frozen=True)
class Bench:
    """A study's measurement with the library of effects.

    measurement    machine and set-ups
    effects        the library
    gravity        its direction in the base frame
    """

    measurement: Measurement
    effects: tuple[Effect, ...]
    gravity: tuple[float, float, float]


def manifest(folder: Path) -> list[Case]:
    """Cases of a set, in the manifest's order.

    Raises ValueError for a line that is none; OSError.
    """
    file, cases = folder / "manifest.jsonl", []
    lines = file.read_text(encoding="utf-8").splitlines()
    for number, line in enumerate(lines, start=1):
        try:
            entry = json.loads(line)
            cases.append(Case(entry["id"], entry["study"], entry["readings"]))
        except (json.JSONDecodeError, KeyError, TypeError) as error:
            raise ValueError(
                f"{file}, line {number}: {error!r}; make the set again with `generate`"
            ) from None
    return cases


def numbered(folder: Path, number: int) -> Case:
    """A case of a set by its number, from 0, in the order in which they were drawn.

    More cases in the set do not change the numbers. Raises ValueError beyond them,
    OSError.
    """
    names = (folder / "order.txt").read_text(encoding="utf-8").split()
    if number >= len(names):
        raise ValueError(
            f"the set has {len(names)} cases: draw more with `generate`, or give the"
            f" campaign --seeds {len(names)} ({folder})"
        )
    return next(c for c in manifest(folder) if c.id == names[number])


@functools.cache
def bench(name: str) -> Bench:
    """The bench of a study file in this module's folder.

    Once in a process, for it compiles the machine.
    """
    stated = study.load(HERE / name)
    resolved = resolve(stated, readings=[])
    request = gap_request(stated, resolved.machine)
    assert request is not None  # `always` makes one
    measurement = resolved.measurement_with(resolved.setups)
    return Bench(measurement, request.effects, request.gravity)


def prepare(folder: Path, case: Case) -> GapProblem:
    """The residuals of a case. Raises ReadingsError, IdentificationError."""
    at = bench(case.study)
    data = dataset.load(folder / case.readings, at.measurement)
    return problem_of.prepare(
        at.measurement, data.series, data.y, data.covariates, gravity=at.gravity
    )


def write(path: Path, text: str) -> None:
    """Write a file, whole or not at all. Raises OSError."""
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8", newline="")
        part.replace(path)
    finally:
        part.unlink(missing_ok=True)
