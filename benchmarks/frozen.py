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
import gzip
import json
import math
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple

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


class Difference(NamedTuple):
    """A number that is not what it was; None where there is none."""

    path: str
    before: float | None
    after: float | None
    size: float  #: over its tolerance


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
    for path in before.keys() | after.keys():
        old, new = before.get(path), after.get(path)
        missing = old is None or new is None
        size = math.inf if missing else _size(path, old, new, before)
        if size > 1.0:
            found.append(Difference(path, old, new, size))
    return sorted(found, key=lambda d: (-d.size, d.path))


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


def names_of(kind: str) -> list[str]:
    """Names of shipped studies, or of blind cases: a number, or machine/number."""
    if kind == "studies":
        return list(shipped.studies())
    if kind == "blind":
        return [str(k) for k in range(CASES)]
    second_world.generate(SECOND, SECOND_SEED, CASES_OF_MACHINE)
    machines = second_world.MACHINES
    return [f"{m}/{k}" for m in machines for k in range(CASES_OF_MACHINE)]


def compute(label: str) -> tuple[str, dict[str, float]]:
    """The numbers of what a label `kind:name` names, beside it."""
    kind, _, name = label.partition(":")
    return label, numbers(KINDS[kind](name))


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


KINDS: dict[str, Callable[[str], Any]] = {
    "studies": _study,
    "blind": _blind,
    "second": _second,
}


# -- command ---------------------------------------------------------------------------
FILE = FOLDER / "frozen.json.gz"
PRINTED = 8  #: differences that are printed of a document


def main(arguments: list[str] | None = None) -> int:
    """Exit code: 0 equal or made, 1 different, 2 bad input."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.frozen", description=__doc__
    )
    parser.add_argument("command", choices=("make", "compare"))
    parser.add_argument("--file", type=Path, default=FILE)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=KINDS)
    parser.add_argument("--names", nargs="+", help="these studies or cases alone")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(arguments)
    options.file.parent.mkdir(parents=True, exist_ok=True)
    labels = [
        f"{kind}:{name}"
        for kind in options.kinds
        for name in names_of(kind)
        if not options.names or name in options.names
    ]
    with ProcessPoolExecutor(options.workers) as pool:
        documents = pool.map(compute, labels)
        if options.command == "make":
            return _make(options.file, documents)
        return _compare(options.file, documents)


def _make(file: Path, documents: Iterable[tuple[str, dict[str, float]]]) -> int:
    record = {"commit": _commit(), "documents": dict(documents)}
    text = json.dumps(record, sort_keys=True).encode()
    file.write_bytes(gzip.compress(text, 9, mtime=0))
    print(f"{len(record['documents'])} documents in {file}")
    return 0


def _compare(file: Path, documents: Iterable[tuple[str, dict[str, float]]]) -> int:
    record = json.loads(gzip.decompress(file.read_bytes()))
    print(f"frozen at {record['commit']}")
    changed = 0
    for label, after in documents:
        before = record["documents"].get(label)
        if before is None:
            print(f"{label}: not frozen", flush=True)
            continue
        apart = differences(before, after)
        changed += bool(apart)
        words = f"{len(apart)} of {len(before)} numbers differ" if apart else "equal"
        print(f"{label}: {words}", flush=True)
        for d in apart[:PRINTED]:
            print(f"    {d.path}: {d.before} -> {d.after}", flush=True)
    print(f"{changed} documents differ" if changed else "equal")
    return int(changed > 0)


def _commit() -> str:
    command = ["git", "describe", "--always", "--dirty", "--abbrev=12"]
    return subprocess.run(command, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
