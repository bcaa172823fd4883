"""Cases of the second generator: made by its own command, read without its labels."""

from __future__ import annotations

import dataclasses
import json
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.second import adapter
from oed import dataset
from oed.gap.data import problem as problem_of
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect
from pkm_studies import study as studies
from pkm_studies.resolve import gap_request, resolve
from pkm_studies.user_code import Consent

#: where the generator lies, beside the project's folder
GENERATOR = Path(__file__).resolve().parents[2].parent / "shared/generators/second"


@dataclasses.dataclass(frozen=True, slots=True)
class Case:
    """A case of a set.

    folder    of the set
    machine   one of `adapter.MACHINES`
    name      `case_KKK`
    """

    folder: Path
    machine: str
    name: str

    @property
    def stem(self) -> Path:
        """Path of its files, without their suffixes."""
        return self.folder / "cases" / self.machine / self.name


def generate(
    folder: Path, seed: int, count: int, machines: Sequence[str], generator: Path
) -> None:
    """Let the generator draw `count` cases of each machine that has none yet.

    Raises FileNotFoundError where there is no generator, CalledProcessError.
    """
    for machine in machines:
        if labels_file(folder, machine).is_file():
            continue
        script = generator / "make.py"
        if not script.is_file():
            raise FileNotFoundError(script)
        out = labels_file(folder, machine).with_name(machine)
        options = ["--seed", str(seed), "--n", str(count), "--machine", machine]
        command = [sys.executable, "-B", str(script), *options, "--out", str(out)]
        subprocess.run(command, check=True)


def labels_file(folder: Path, machine: str) -> Path:
    """Where the generator writes the labels of a machine's cases."""
    return folder / "cases" / f"{machine}.labels.json"


def labels(folder: Path, machine: str) -> dict[str, Any]:
    """The labels of a machine's cases, by name. Raises OSError."""
    text = labels_file(folder, machine).read_text(encoding="utf-8")
    content: dict[str, Any] = json.loads(text)
    return content


def names(folder: Path, machine: str) -> list[str]:
    """Names of the cases of a machine, in order."""
    return sorted(p.stem for p in (folder / "cases" / machine).glob("case_*.json"))


def prepare(case: Case) -> tuple[GapProblem, tuple[Effect, ...]]:
    """The residuals of a case, and the effects to try.

    Raises InputError, ReadingsError, IdentificationError.
    """
    out = case.folder / "studies" / case.machine / case.name
    path, readings = adapter.write_case(case.stem, out)
    study = studies.load(path, Consent.GIVEN)
    resolved = resolve(study, readings=[])
    request = gap_request(study, resolved.machine)
    assert request is not None  # `always` makes one
    measurement = resolved.measurement_with(resolved.setups)
    data = dataset.load(readings, measurement)
    problem = problem_of.prepare(
        measurement, data.series, data.y, data.covariates, gravity=request.gravity
    )
    return problem, request.effects
