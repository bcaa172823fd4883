"""Cases of the second generator drawn again, with what their labels do not say.

The generator draws a case from its seed alone. Drawn again with an oracle that records, it
gives the exact change of the readings by the acting effects, the slopes of the
geometry, and its own model of the case, from which other effects can be drawn.
"""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from oed.base import Array, Index

#: (f(size), place): an effect's perturbation of the machine, as the generator draws it
EffectDraw = tuple[Any, Mapping[str, Any]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Replay:
    """A case of the generator, its readings in the generator's order.

    case       the generator's model of the case, at its true geometry
    label      what the generator wrote of it
    sigma      (n,) stated noise, mm
    run        (n,) run of each reading
    slopes     (n, p) of the geometry per prior standard deviation, over sigma
    reference  (n, m) of the reference readings' own noise, over sigma
    change     (n,) exact change of the readings by all effects, over sigma; 0 without
    readings   (n,) as the generator wrote them, mm
    """

    case: Any
    label: Mapping[str, Any]
    sigma: Array
    run: Index
    slopes: Array
    reference: Array
    change: Array
    readings: Array


class Generator:
    """The generator's modules, from its folder.

    Raises ModuleNotFoundError where it is not there.
    """

    def __init__(self, folder: Path) -> None:
        with _importable(folder):
            self.make = importlib.import_module("make")
            self.effects = importlib.import_module("effects")
            self.truth = importlib.import_module("truth")
        self.machines = list(self.truth.POSE)

    def kinds(self, seed: int, machine: str, count: int) -> list[tuple[str, str, int]]:
        """Kind, law and severity of each of `count` cases, as `make.py` draws them."""
        make, place = self.make, self.machines.index(machine)
        head = np.random.default_rng([seed, place])
        mix = {
            kind: share
            for kind, share in make.MIX.items()
            if kind != "class" or machine in ("a3", "hexapod")
        }
        kinds = [k for k, v in mix.items() for _ in range(int(np.ceil(v * count)))]
        kinds += ["single"] * (count - len(kinds))
        kinds = [kinds[i] for i in head.permutation(len(kinds))[:count]]
        rows, seen = [], dict.fromkeys(mix, -1)
        for kind in kinds:
            seen[kind] += 1
            turn, laws = seen[kind], make.LAWS
            severity = make.SEVERITY[turn % 5]
            if kind != "single":
                severity = (6, 10, 20)[turn % 3]
            place_of_law = turn % len(laws)
            if kind != "null":
                place_of_law = int(head.integers(len(laws)))
            law = laws[place_of_law]
            rows.append((kind, law, severity))
        return rows

    def replay(
        self, seed: int, machine: str, number: int, kind: tuple[str, str, int]
    ) -> Replay:
        """Case `number` of a machine's set."""
        recorded: list[Any] = []
        make: Any = self.make
        original = make.Oracle

        class Recorder(original):  # type: ignore[misc, valid-type]
            def __init__(self, *arguments: Any) -> None:
                super().__init__(*arguments)
                self.last = np.zeros(self.c.ny)
                recorded.append(self)

            def signature(self, perturbation: Any) -> Array:
                self.last = super().signature(perturbation)
                return self.last

        stream = np.random.default_rng([seed, self.machines.index(machine), number])
        make.Oracle = Recorder
        try:
            case, readings, label = make.make_case(machine, *kind[:2], stream, kind[2])
        finally:
            make.Oracle = original
        change = recorded[0].last if label["effects"] else np.zeros(case.ny)
        return Replay(
            case=case,
            label=label,
            sigma=case.sigma,
            run=case.run[case.row],
            slopes=case.jacobian() / case.sigma[:, None],
            reference=self._reference(case),
            change=change / case.sigma,
            readings=readings,
        )

    def _reference(self, case: Any) -> Array:
        """One column for each channel of a run that is relative to its first reading."""
        relative = np.isin(case.kind, (self.truth.DY, self.truth.DZ))
        keys = np.column_stack([case.ref, case.kind])
        _, group = np.unique(keys, axis=0, return_inverse=True)
        columns = (group[:, None] == np.unique(group[relative])) & relative[:, None]
        return np.asarray(columns, dtype=float)

    def drawn_change(self, replay: Replay, name: str, rng: np.random.Generator) -> Any:
        """Change (n,) of the readings, over sigma, by a fresh draw of an effect.

        Of the effect's typical size and linear in it, with the legs where it sits.
        """
        pool = self.effects.LISTED | self.effects.NEVER
        effect, where = pool[name][0](replay.case, rng)
        change = replay.case.linear(effect(1.0)) / replay.sigma
        return change, tuple(where.get("legs", ()))

    def names(self, machine: str) -> dict[str, float]:
        """Effects that act on a machine, with their shares of the single gaps."""
        make: Any = self.make
        shares: dict[str, float] = {}
        for pool, kind in (
            (self.effects.LISTED, "single"),
            (self.effects.NEVER, "unknown"),
        ):
            names = [n for n, (_, machines) in pool.items() if machine in machines]
            shares |= dict.fromkeys(names, make.MIX[kind] / len(names))
        total = sum(shares.values())
        return {name: share / total for name, share in shares.items()}


@contextlib.contextmanager
def _importable(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
