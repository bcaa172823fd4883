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


def good(blind) -> list:
    """Cases of every kind, all answered right."""
    one = {"split": "whole", "s0": 3.0, "s1": 1.0}
    place = [{"block": "leg 2", "p_value": 0.001, "strength": 1.0}]
    pairs = [
        (case("null", {}, law=law), result(answer())) for law in blind.measures.LAWS
    ]
    for machine in ("a3", "hexapod"):
        label = case("single", {"backlash": 6.0}, machine=machine, blocks=("leg 2",))
        closure = [one, one | {"split": "within"}]
        pairs.append((label, result(answer("backlash"), where=place, closure=closure)))
    pairs.append(
        (
            case("single", {"gravity": 20.0}),
            result(answer("gravity", "unknown"), closure=closure),
        )
    )
    two = case("pair", {"gravity": 10.0, "backlash": 6.0})
    pairs.append((two, result(answer("backlash", "gravity"), closure=closure)))
    exact = answer("bar_length", classes=[["bar_length", "encoder_scale"]])
    pairs.append(
        (case("exact", {"encoder_scale": 6.0}), result(exact, closure=closure))
    )
    pairs.append((case("unknown", {"pump": 10.0}), result(answer("unknown"))))
    pairs.append(
        (
            case("known_unknown", {"gravity": 6.0, "pump": 10.0}),
            result(answer("gravity", "unknown")),
        )
    )
    return entries_of(blind, *pairs)
