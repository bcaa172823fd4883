"""What is frozen: the shipped studies, and 40 cases of each generator of blind cases."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

import dataclasses
import json
import tempfile
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.blind import __main__ as blind
from benchmarks.blind import case as blind_case
from benchmarks.frozen.numbers import numbers
from benchmarks.second import adapter
from benchmarks.second import cases as second_cases
from benchmarks.second import run as second_run
from pkm_studies import shipped, stages
from pkm_studies import study as studies
from pkm_studies.base import InputError

#: sets of blind cases, and the seeds that they are drawn with
FOLDER = Path("out/frozen")
BLIND, SECOND = FOLDER / "blind", FOLDER / "second"
SECOND_SEED, CASES, CASES_OF_MACHINE = 60125, 40, 10

STUDIES, OWN, OTHER = "studies", "blind", "second"
KINDS = (STUDIES, OWN, OTHER)


@dataclasses.dataclass(frozen=True, slots=True)
class Source:
    """A document to compute: a shipped study, or a blind case.

    kind    one of KINDS
    name    of the study, or of the case: its number, or machine/number
    """

    kind: str
    name: str


def prepare(kinds: tuple[str, ...]) -> None:
    """Draw the sets of blind cases, where they are not there yet."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    if OWN in kinds and not (BLIND / "set").is_dir():
        out = str(BLIND / "set")
        blind.main(["generate", "--set", "blind", "--cases", str(CASES), "--out", out])
    if OTHER in kinds:
        second_cases.generate(
            SECOND,
            SECOND_SEED,
            CASES_OF_MACHINE,
            adapter.MACHINES,
            second_cases.GENERATOR,
        )


def listing(kinds: tuple[str, ...]) -> list[Source]:
    """All sources of these kinds, the longest first."""
    all_sources = {
        STUDIES: [Source(STUDIES, name) for name in shipped.studies()],
        OWN: [Source(OWN, str(k)) for k in range(CASES)],
        OTHER: [
            Source(OTHER, f"{machine}/{k}")
            for machine in adapter.MACHINES
            for k in range(CASES_OF_MACHINE)
        ],
    }
    return [source for kind in kinds for source in all_sources[kind]]


def compute(source: Source) -> tuple[Source, dict[str, float]]:
    """The numbers of a source; none where its data are not there."""
    compute_kind = {STUDIES: _study, OWN: _blind, OTHER: _second}[source.kind]
    return source, numbers(compute_kind(source.name))


def _study(name: str) -> Any:
    study = studies.load(shipped.find(name, "study").path)
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = stages.run_study(study, Path(folder), report=False)
        except InputError as error:
            return {"refused": 1.0, "verdict": str(error)[:80]}
    return json.loads(msgspec.json.encode(result))


def _blind(name: str) -> Any:
    setting = {"folder": str(BLIND), "part": blind_case.ALL}
    return blind_case.diagnosis(setting, int(name))


def _second(name: str) -> Any:
    machine, number = name.split("/")
    setting = {"folder": str(SECOND), "machine": machine, "law": second_run.ESTIMATED}
    return second_run.diagnosis(setting, int(number))


__all__ = ["KINDS", "Source", "compute", "listing", "prepare"]
