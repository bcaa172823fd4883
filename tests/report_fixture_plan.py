"""A made-up but realistic plan in three stages, with every optional part."""

from __future__ import annotations

from typing import Any

import report_fixture
from report_fixture_machine import LENGTHS, TILTS

START = {
    "x_um": 8120.0,
    "y_um": 8090.0,
    "z_um": 8300.0,
    "psi_arcsec": 2400.0,
    "theta_arcsec": 310.0,
    "phi_arcsec": 980.0,
}
#: share of the error that each stage leaves
SHARES = (0.021, 0.16, 0.55)
STAGES = (
    ("rough tracker", ["tracker"], 12, 0.0, 24.5, 15),
    ("bar 300, cup low", ["short tool"], 18, 24.5, 61.0, 17),
    ("bar 250, cup high", ["long tool"], 24, 61.0, 108.0, 18),
)


def sample(*, wanted: bool = True) -> dict[str, Any]:
    """The report's sample with a plan in stages; `wanted`: it misses a wanted accuracy."""
    full = report_fixture.sample()
    full["plan"] = plan(wanted=wanted)
    for k, pose in enumerate(full["design"]["poses"]):
        pose["order"] = k % 15
    return full


def plan(*, wanted: bool = True) -> dict[str, Any]:
    """Every field of a plan."""
    accuracy = _accuracy(3)
    value = 1.24 if wanted else 0.00187
    goal = {
        "z_um": accuracy["z_um"] / 1.24,
        "theta_arcsec": accuracy["theta_arcsec"] / 1.1,
    }
    return {
        "stages": [_stage(k) for k in range(len(STAGES))],
        "cost": 108.0,
        "budget_min": 120.0,
        "price": 40.0,
        "value": value,
        "goal": goal if wanted else {},
        "reached": not wanted,
        "start_accuracy": START,
        "accuracy": accuracy,
        "best_reachable": {name: 0.97 * rms for name, rms in accuracy.items()},
        "needs": [
            "half the noise of bar 300 reaches z to 11.2 um",
            "a budget of 240 min reaches it in 151 min",
        ],
        "bound": value / 1.043,
        "loss": 0.043,
        "lines": 17,
        "stop": (
            "a fourth stage (bar 150, cup low) would gain 2.1 %, less than the 5 % that"
            " are worth it"
        ),
        "after": "12 readings of a first day, 33 min",
        "virtual_machines": 200,
        "alternatives": _alternatives(value),
        "front": _front(value),
        "compared": _compared(value),
    }


def _accuracy(count: int) -> dict[str, float]:
    """Accuracy after so many stages; angles gain less."""
    accuracy = dict(START)
    for share in SHARES[:count]:
        for i, name in enumerate(accuracy):
            accuracy[name] *= share ** (1.0 - 0.06 * i)
    return accuracy


def _stage(k: int) -> dict[str, Any]:
    name, setups, readings, begin, end, rank = STAGES[k]
    components = [component.rpartition("_")[0] for component in START]
    return {
        "measurement": name,
        "setups": setups,
        "readings": readings,
        "identifies": rank,
        "cost": end - begin,
        "kappa": 812.0 + 1000.0 * k,
        "predicted": _accuracy(k + 1),
        "chosen": readings,
        "begin_min": begin,
        "end_min": end,
        "price": 40.0 if k == 0 else 0.0,
        "operator": "metrologist" if k == 0 else "",
        "available": {"least": (1.0, 0.83, 0.991)[k], "mean": (1.0, 0.96, 0.998)[k]},
        "lost": (0.0, 0.72, 0.05)[k],
        "cut_off_um": (412.0, 3.1, 0.04)[k],
        "rank": (15, 17, 18)[k],
        "parameters": _standard_deviations(k),
        "held": [["da1y", "0.71 db2x - 0.71 db3x", "db1y"], ["db1y"], []][k],
        "accuracy": _accuracy(k + 1),
        "realised": {n: 0.93 + 0.03 * i + 0.02 * k for i, n in enumerate(components)},
        "realised_lost": (0.0, 0.81, 0.04)[k],
        "coverage": (0.947, 0.953, 0.949)[k],
    }


def _standard_deviations(k: int) -> dict[str, Any]:
    """Of each parameter after the k-th stage."""
    sds = {}
    for i, name in enumerate(LENGTHS + TILTS):
        gain = 1.0 + (i * 7 + 3) % 11 * (k + 1)
        tilt = name in TILTS
        sd = (10.0 if tilt else 1.0) / gain
        sds[name] = {"sd": sd, "unit": "mrad" if tilt else "mm"}
    return sds


def _plan(
    names: list[str], readings: list[int], minutes: float, value: float, why: str = ""
) -> dict[str, Any]:
    accuracy = {n: v * value / 130.0 for n, v in START.items()}
    return {
        "names": names,
        "readings": readings,
        "minutes": minutes,
        "value": value,
        "accuracy": accuracy,
        "why": why,
    }


def _alternatives(value: float) -> list[Any]:
    bars = ["bar 300, cup low", "bar 250, cup high"]
    why = "a rough stage is missing: 68 % of the readings would be lost"
    return [
        _plan(bars, [24, 24], 84.0, 21.0 * value, why),
        _plan(
            ["rough tracker", *bars[::-1]],
            [12, 24, 12],
            106.0,
            1.07 * value,
            "7 % less accurate in the same time",
        ),
        _plan(
            ["rough tracker", "length gauge"],
            [24, 48],
            71.0,
            9.1 * value,
            "reaches z only to 45 um",
        ),
    ]


def _front(value: float) -> list[dict[str, Any]]:
    tracker, low = ["rough tracker"], ["rough tracker", "bar 300, cup low"]
    every = [name for name, *_ in STAGES]
    return [
        _plan(tracker, [6], 19.0, 60.0 * value),
        _plan(tracker, [12], 24.5, 42.0 * value),
        _plan(low, [12, 6], 46.0, 8.2 * value),
        _plan(low, [12, 12], 53.0, 4.1 * value),
        _plan(low, [12, 18], 61.0, 2.4 * value),
        _plan(every, [12, 18, 12], 92.0, 1.3 * value),
        _plan(every, [12, 18, 24], 108.0, 1.0 * value),
    ]


def _compared(value: float) -> list[dict[str, Any]]:
    both = [name for name, *_ in STAGES[1:]]
    return [
        _sequence("RM 5", ["bar 250, cup high"], 61.0, 45.0, 16, value),
        _sequence("RM 4 → RM 5", both, 93.0, 6.0, 18, value),
    ]


def _sequence(
    name: str, names: list[str], minutes: float, worse: float, rank: int, value: float
) -> dict[str, Any]:
    best = ["rough tracker", "bar 300, cup low"]
    return {
        "name": name,
        "way": _plan(names, [24] * len(names), minutes, value * worse),
        "rank": rank,
        "parameters": 18,
        "kappa": 5210.0 / len(names),
        "weakest": 0.00124 * len(names),
        "observability": {
            "O1": 0.0173,
            "O2": 1.9e-4,
            "O3": 0.00124,
            "O4": 3.2e-7,
            "O5": 0.0044,
        },
        "lost": 15.2 / len(names),
        "plan": _plan(best, [12, 18], minutes, value * 1.4),
        "gain": {component: worse / 1.4 for component in START},
        "bound": 1.3 * value,
        "words": "In the same time a rough stage makes it far more accurate.",
    }
