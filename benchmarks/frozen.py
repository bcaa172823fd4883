"""Freeze the numbers of results, and compare a changed tree with them.

    python -m benchmarks.frozen make
    python -m benchmarks.frozen compare
    python -m benchmarks.frozen compare --kinds studies --names a3_ball_bar micro_cmm

`make` writes the numbers of all shipped studies and of 40 cases of each of two worlds of
blind cases as they are now; `compare` computes them again and lists what differs: by
more than 1e-9 where nothing is drawn, by more than 1e-3 standard deviations elsewhere.
Numbers are made from a named commit, whose name they hold.
"""

from __future__ import annotations

import argparse
import dataclasses
import gzip
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import msgspec

from benchmarks.harness import cases
from benchmarks.second import world as second_world
from pkm_studies import shipped, stages
from pkm_studies import study as studies
from pkm_studies.base import InputError

# -- numbers of a document -------------------------------------------------------------


#: relative difference of numbers that nothing draws, and difference of drawn ones in
#: standard deviations, or relative where the document states none
COMPUTED, DRAWN = 1e-9, 1e-3
#: below this share of the largest number of its list, a number is rounding
NOTHING = 1e-12
#: sections whose numbers rest on random draws
DRAWN_SECTIONS = re.compile(
    r"^(posterior|prediction|held_out|gap|corrected|estimate|goodness\.noise"
    r"|plan|design\.robust|where|closure|answers|set95|marginal|noise)\b"
)
#: run times, versions, and the study's text
IGNORED = re.compile(r"(^|\.)(seconds|version|versions|study_text|traceback)(\.|\[|$)")


@dataclasses.dataclass(frozen=True, slots=True)
class Difference:
    """A number that is not what it was.

    path     of the number in its document
    before   frozen value; None where the number is new
    after    value now; None where the number is gone
    size     over its tolerance
    """

    path: str
    before: float | None
    after: float | None
    size: float


def numbers(document: Any) -> dict[str, float]:
    """Numbers of a JSON document by path, such as `estimate.parameters.R.sd`.

    Names of answers count as well: each is a number 1 under its own path.
    """
    return {p: v for p, v in _walk(document, "") if not IGNORED.search(p)}


def differences(
    before: Mapping[str, float], after: Mapping[str, float]
) -> list[Difference]:
    """Numbers that differ by more than their tolerance, the largest first."""
    found = []
    for path in sorted(before.keys() | after.keys()):
        old, new = before.get(path), after.get(path)
        if old is None or new is None:
            found.append(Difference(path, old, new, math.inf))
            continue
        size = _size(path, old, new, before)
        if size > 1.0:
            found.append(Difference(path, old, new, size))
    return sorted(found, key=lambda d: -d.size)


def _size(path: str, old: float, new: float, before: Mapping[str, float]) -> float:
    """Difference over its tolerance."""
    if old == new or (math.isnan(old) and math.isnan(new)):
        return 0.0
    if not (math.isfinite(old) and math.isfinite(new)):
        return math.inf
    magnitude = max(abs(old), abs(new))
    tolerance = COMPUTED * magnitude
    if DRAWN_SECTIONS.match(path):
        sd = before.get(f"{path.rpartition('.')[0]}.sd", 0.0)
        tolerance = max(DRAWN * magnitude, DRAWN * sd)
    return abs(new - old) / max(tolerance, NOTHING)


def _walk(value: Any, path: str) -> Iterator[tuple[str, float]]:
    if isinstance(value, Mapping):
        for name, inner in value.items():
            yield from _walk(inner, f"{path}.{name}" if path else str(name))
    elif isinstance(value, list):
        yield f"{path}.length", float(len(value))
        for k, inner in enumerate(value):
            yield from _walk(inner, f"{path}[{k}]")
    elif isinstance(value, bool | int | float):
        yield path, float(value)
    elif isinstance(value, str) and re.search(r"(verdict|effects\[\d+\])$", path):
        yield f"{path}={value}", 1.0


# -- what is frozen --------------------------------------------------------------------


#: set of the second generator, and the seed that it is drawn with
FOLDER = Path("out/frozen")
SECOND = FOLDER / "second"
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
    """Draw the set of the second generator, where it is not there yet."""
    FOLDER.mkdir(parents=True, exist_ok=True)
    if OTHER in kinds:
        second_world.generate(SECOND, SECOND_SEED, CASES_OF_MACHINE)


def listing(kinds: tuple[str, ...]) -> list[Source]:
    """All sources of these kinds, the longest first."""
    all_sources = {
        STUDIES: [Source(STUDIES, name) for name in shipped.studies()],
        OWN: [Source(OWN, str(k)) for k in range(CASES)],
        OTHER: [
            Source(OTHER, f"{machine}/{k}")
            for machine in second_world.MACHINES
            for k in range(CASES_OF_MACHINE)
        ],
    }
    return [source for kind in kinds for source in all_sources[kind]]


def compute(source: Source) -> tuple[Source, dict[str, float]]:
    """The numbers of a source; none where its data are not there."""
    compute_kind = {STUDIES: _study, OWN: _blind, OTHER: _second}[source.kind]
    return source, numbers(compute_kind(source.name))


def _study(name: str) -> Any:
    study = studies.Study.load(shipped.find(name, "study"))
    with tempfile.TemporaryDirectory() as folder:
        try:
            result = stages.run_study(study, Path(folder), report=False)
        except InputError as error:
            return {"refused": 1.0, "verdict": str(error)[:80]}
    return json.loads(msgspec.json.encode(result))


def _blind(name: str) -> Any:
    return _case({"world": "blind", "set": "blind", "set_seed": 1}, int(name))


def _second(name: str) -> Any:
    machine, number = name.split("/")
    setting = {"world": "second", "folder": str(SECOND), "machine": machine}
    return _case(setting, int(number))


def _case(setting: dict[str, Any], number: int) -> Any:
    """The diagnosis of a case, without its label."""
    row = cases.diagnosis({**setting, "observer": cases.ESTIMATED}, number)
    return {name: value for name, value in row.items() if name != "label"}


# -- command ---------------------------------------------------------------------------


FILE = FOLDER / "frozen.json.gz"
#: differences that are printed of a source
PRINTED = 8


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 equal or made, 1 different, 2 bad input."""
    options = _parser().parse_args(arguments)
    return int(options.run(options))


def _make(options: argparse.Namespace) -> int:
    documents = {f"{s.kind}:{s.name}": n for s, n in _computed(options)}
    record = {"commit": _commit(), "documents": documents}
    text = json.dumps(record, sort_keys=True).encode()
    options.file.write_bytes(gzip.compress(text, 9, mtime=0))
    print(f"{len(documents)} documents in {options.file}")
    return 0


def _compare(options: argparse.Namespace) -> int:
    record = json.loads(gzip.decompress(options.file.read_bytes()))
    print(f"frozen at {record['commit']}")
    changed = 0
    for source, after in _computed(options):
        label = f"{source.kind}:{source.name}"
        before = record["documents"].get(label)
        if before is None:
            print(f"{label}: not frozen", flush=True)
            continue
        apart = differences(before, after)
        changed += bool(apart)
        _print_differences(label, apart, len(before))
    print(f"{changed} documents differ" if changed else "equal")
    return int(changed > 0)


def _print_differences(label: str, apart: list[Difference], count: int) -> None:
    verdict = f"{len(apart)} of {count} numbers differ" if apart else "equal"
    print(f"{label}: {verdict}", flush=True)
    for difference in apart[:PRINTED]:
        before, after = difference.before, difference.after
        print(f"    {difference.path}: {before} -> {after}", flush=True)


def _computed(options: argparse.Namespace) -> Iterator[tuple[Source, dict[str, float]]]:
    kinds = tuple(options.kinds)
    prepare(kinds)
    wanted = listing(kinds)
    if options.names:
        wanted = [source for source in wanted if source.name in options.names]
    with ProcessPoolExecutor(options.workers) as pool:
        yield from pool.map(compute, wanted)


def _commit() -> str:
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.frozen", description=__doc__
    )
    commands = parser.add_subparsers(dest="command", required=True)
    for name, run, text in (
        ("make", _make, "compute and write the numbers"),
        ("compare", _compare, "compute the numbers again and compare"),
    ):
        command = commands.add_parser(name, help=text)
        command.add_argument("--file", type=Path, default=FILE)
        command.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
        command.add_argument("--names", nargs="+", default=[])
        command.add_argument("--workers", type=int, default=2)
        command.set_defaults(run=run)
    return parser


if __name__ == "__main__":
    sys.exit(main())
