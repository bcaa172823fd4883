"""Labels, oracles and results of the blind benchmark made by hand, for the tests of
what reads them.
"""

from __future__ import annotations

from types import SimpleNamespace

LIBRARY = ("backlash", "friction", "gravity", "bar_length", "encoder_scale", "step")


def case(
    kind: str,
    effects: dict[str, float],
    *,
    machine: str = "a3",
    law: str = "white",
    blocks: tuple[str, ...] = (),
) -> dict:
    effects_stated = [
        {
            "name": n,
            "unknown": n not in LIBRARY,
            "target": s,
            "sqrt_lambda": s,
            "blocks": list(blocks),
        }
        for n, s in effects.items()
    ]
    exact = ["encoder_scale", "bar_length"] if kind == "exact" else []
    return {
        "id": "x",
        "machine": machine,
        "kind": kind,
        "noise": {"name": law},
        "effects": effects_stated,
        "class": exact,
    }


def known(
    label: dict,
    *,
    apart: float = 10.0,
    beyond: float = 10.0,
    by_library: float = 2.0,
    testable: tuple[str, ...] = LIBRARY,
) -> dict:
    figures = [
        {"name": e["name"], "apart": apart, "beyond": beyond, "own": by_library}
        for e in label["effects"]
    ]
    square = {"value": 0.9, "s0": 3.0, "s1": 1.0, "n": 100}
    closure = [
        {"split": s, "expected_gain": 50.0, "same_law": square}
        for s in ("within", "whole")
    ]
    return {"testable": list(testable), "effects": figures, "closure": closure}


def answer(
    *effects: str, p: float = 0.96, classes: list[list[str]] | None = None
) -> dict:
    named = [[e] for e in effects if e != "unknown"]
    return {
        "effects": list(effects),
        "probability": p,
        "classes": named if classes is None else classes,
    }


def result(*answers: dict, baseline: list[str] | None = None, **more: object) -> dict:
    record: dict = {
        "answers": list(answers),
        "set95": list(answers[:1]),
        "where": [],
        "closure": [],
    }
    if baseline is not None:
        record["baselines"] = {"harmonic": baseline, "stepwise": baseline}
    return record | more


def entries_of(blind: SimpleNamespace, *cases: tuple[dict, dict]) -> list:
    return [blind.entries.entry(label, known(label), said) for label, said in cases]


def by_key(rows) -> dict:
    return {r.key: r for r in rows}
