"""A result with all sections, which agree, and changes to it."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from typing import Any

import msgspec
import report_fixture
import report_fixture_plan
import report_fixture_view

Change = Callable[[Any], None]


def gap() -> dict[str, Any]:
    """A diagnosis of two channels, as small as it can be."""
    trace = {
        "setup": "short tool",
        "run": "1",
        "base": "1",
        "channel": "length",
        "unit": "um",
        "kind": "circle",
        **{
            name: [0.0, 1.0, 2.0]
            for name in ("at", "before", "explained", "unexplained", "after")
        },
    }
    coefficient = {"effect": "backlash", "name": "play", "label": "leg 1", "unit": "m"}
    closure = dict.fromkeys(("value", "low", "high", "p_worse", "s0", "s1", "s_noise"))
    return {
        "verdict": "effect",
        "answers": [
            {"effects": ["backlash"], "probability": 0.9, "classes": [["backlash"]]}
        ],
        "set95": [{"effects": ["backlash"], "probability": 0.9}],
        "where": [{"block": "leg 1", "p_value": 0.01}],
        "closure": [{**closure, "split": "within", "n": 30}],
        "not_testable": [],
        "confusable": [],
        "selected": ["backlash"],
        "tried": ["backlash", "gravity"],
        "marginal": {"backlash": 0.9, "gravity": 0.05},
        "coefficients": [{**coefficient, "value": 1e-6, "sd": 1e-7, "prior_sd": 1e-5}],
        "sizes": [
            {"effect": "backlash", "rms": {"length": 3.0}, "detectability": 20.0}
        ],
        "units": {"length": "um"},
        "rms_before": {"length": 3.0},
        "rms_after": {"length": 0.5},
        "traces": [trace],
        "spots": [{"at": [0.0, 0.0, 0.0], "before": 1.0, "after": 0.5}],
        "mixture": mixture(),
    }


def mixture() -> dict[str, Any]:
    sample = report_fixture.sample()
    prediction = sample["prediction"]
    value = {"value": 1.0, "sd": 0.2, "within": 0.1, "low": 0.6, "high": 1.4}
    rms = {name: 1.0 for name in prediction["components"]}
    return {
        "answers": [
            {"effects": ["backlash"], "probability": 0.9},
            {"effects": [], "probability": 0.05},
        ],
        "rest": 0.05,
        "parameters": {name: {**value, "unit": "mm"} for name in ("da1y", "da1z")},
        "covariance": [[0.04, 0.0], [0.0, 0.04]],
        "controller": {"da1y": 1.1, "da1z": 0.9},
        "choices": [{"name": n, "rms": rms} for n in ("mixture", "best answer")],
        "prediction": prediction,
        "with_effects": prediction,
        "words": ["The answers disagree.", "The mixture is expected to leave 1 um."],
    }


def corrected() -> dict[str, Any]:
    fitted = report_fixture.sample()["estimate"]
    table = {
        "effect": "backlash",
        "state": "direction",
        "joint_wise": True,
        "values": [-1.0, 1.0],
        "joints": ["q1_mm", "q2_mm"],
        "commands": [{"z_mm": 1.0}, {"z_mm": 2.0}, {"z_mm": 3.0}],
        "table": [[[0.0, 0.0]] * 3] * 2,
    }
    effect = {"value": 1.0, "sd": 0.1, "unit": "um", "effect": "backlash"}
    count = len(fitted["parameters"])
    return {
        "parameters": fitted["parameters"],
        "effects": {"backlash: leg 1": {**effect, "prior_sd": 10.0}},
        "constants": {"backlash": {}},
        "conditions": ["the direction is known"],
        "origin": "diagnosis",
        "rms_after": {"length": 0.5},
        "units": {"length": "um"},
        "readings": 30,
        "chi2": 9.0,
        "dof": 8.0,
        "covariance": [[0.0] * count] * count,
        "tables": [table],
    }


def gap_before() -> dict[str, Any]:
    record = {
        "about": "",
        "columns": 1,
        "detectability": 5.0,
        "low": 4.0,
        "high": 6.0,
        "power": 0.9,
        "visible": True,
        "signature": {"length": 1.0},
        "absorbed": 0.2,
        "least": {"length": 0.5},
        "median": {"length": 0.6},
        "sizes": {},
        "rivals": [],
        "not_testable": None,
    }
    names = ["backlash", "gravity"]
    return {
        "table": {
            "readings": 30,
            "effects": [{"name": name, **record} for name in names],
            "names": names,
            "apart": [[5.0, 1.0], [2.0, 4.0]],
            "angles_deg": [[90.0, 20.0], [20.0, 90.0]],
            "classes": [names],
            "absorbed": [names],
            "exact": [],
        },
        "units": {"length": "um"},
        "chosen": None,
        "words": ["Both can be found."],
    }


def acceptance() -> dict[str, Any]:
    demand = {"promised": 1.0, "limit": 2.0, "power": 0.9, "uncertainty": 0.1}
    return {
        "poses": [{"z_mm": 1.0}, {"z_mm": 2.0}],
        "components": {"z": {**demand, "unit": "um"}},
        "reference": "home",
        "miss": 1.3,
        "false_alarm": 0.05,
    }


def forecast() -> dict[str, Any]:
    return {
        "components": {"z": {"unit": "um", "expected": 60.0, "planned": 5.0}},
        "reference": "home",
        "nodes": [{"z_mm": 1.0}, {"z_mm": 2.0}],
        "setup": "cup",
        "minutes": 12.0,
    }


@functools.cache
def whole_once() -> dict[str, Any]:
    plain = report_fixture_view.sample()
    plain |= {
        "plan": report_fixture_plan.plan(),
        "gap": gap(),
        "gap_before": gap_before(),
        "acceptance": acceptance(),
        "forecast": forecast(),
        "corrected": corrected(),
    }
    decoded: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(plain))
    return decoded


def whole() -> dict[str, Any]:
    """A result with all sections, which agree."""
    return copy.deepcopy(whole_once())


def at(tree: Any, path: str) -> tuple[Any, Any]:
    """Container and key of a dotted path; numbers are indices."""
    *way, last = [int(k) if k.isdigit() else k for k in path.split("/")]
    for key in way:
        tree = tree[key]
    return tree, last


def drop(path: str) -> Change:
    def change(tree: Any) -> None:
        container, key = at(tree, path)
        del container[key]

    return change


def put(path: str, value: Any) -> Change:
    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container[key] = value

    return change


def rename(path: str) -> Change:
    """Another name for an entry of a table."""

    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container["nonsense"] = container.pop(key)

    return change


def twice(path: str) -> Change:
    """The last entry of a list once more."""

    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container[key].append(container[key][-1])

    return change
