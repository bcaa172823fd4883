"""Draws mutants over the rooms of `oed`, each room's share by its lines of code."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from benchmarks.mutants.mutations import Mutation, code_lines, is_valid, mutations

PACKAGE = "oed"


@dataclasses.dataclass(frozen=True, slots=True)
class Mutant:
    """A mutation of a module of a room.

    room        folder of `oed`
    path        of the module, from the root of the tree
    mutation    the changed line
    """

    room: str
    path: str
    mutation: Mutation


def rooms_of(root: Path) -> list[str]:
    """The rooms of `oed`: its folders that hold modules, sorted."""
    folders = sorted((root / PACKAGE).iterdir())
    return [folder.name for folder in folders if any(folder.glob("*.py"))]


def draw(
    root: Path, rooms: list[str], count: int, rng: np.random.Generator
) -> list[Mutant]:
    """`count` mutants: at most one a line, the kind drawn before the mutation.

    A room gives fewer than its share where it has fewer lines to mutate.
    """
    numbers = [_number_of_lines(root, room) for room in rooms]
    mutants = []
    for room, number in zip(rooms, shares(numbers, count), strict=True):
        mutants += _draw_in_room(root, room, number, rng)
    return mutants


def shares(sizes: list[int], count: int) -> list[int]:
    """`count` in whole parts proportional to the sizes, by largest remainders."""
    exact = count * np.array(sizes) / sum(sizes)
    whole = np.floor(exact).astype(int)
    order = np.argsort(whole - exact, kind="stable")
    whole[order[: count - whole.sum()]] += 1
    return whole.tolist()


def _draw_in_room(
    root: Path, room: str, count: int, rng: np.random.Generator
) -> list[Mutant]:
    texts = {
        path.relative_to(root).as_posix(): path.read_text(encoding="utf-8")
        for path in _modules(root, room)
    }
    by_line: dict[tuple[str, int], list[Mutation]] = {}
    for name, text in texts.items():
        for mutation in mutations(text):
            by_line.setdefault((name, mutation.line), []).append(mutation)
    lines = sorted(by_line)
    mutants: list[Mutant] = []
    for k in rng.permutation(len(lines)):
        if len(mutants) == count:
            break
        name, _ = lines[k]
        mutation = _draw_mutation(by_line[lines[k]], rng)
        if is_valid(texts[name], mutation):
            mutants.append(Mutant(room, name, mutation))
    return mutants


def _draw_mutation(choices: list[Mutation], rng: np.random.Generator) -> Mutation:
    kinds = sorted({choice.kind for choice in choices})
    kind = kinds[rng.integers(len(kinds))]
    of_kind = [choice for choice in choices if choice.kind == kind]
    return of_kind[rng.integers(len(of_kind))]


def _number_of_lines(root: Path, room: str) -> int:
    texts = (path.read_text(encoding="utf-8") for path in _modules(root, room))
    return sum(len(code_lines(text)) for text in texts)


def _modules(root: Path, room: str) -> list[Path]:
    return sorted((root / PACKAGE / room).rglob("*.py"))
