"""A made-up but realistic plan in three stages, with every optional part, as decoded
from result.json.
"""

from __future__ import annotations

from typing import Any

import report_fixture

START = {
    "x_um": 8120.0,
    "y_um": 8090.0,
    "z_um": 8300.0,
    "psi_arcsec": 2400.0,
    "theta_arcsec": 310.0,
    "phi_arcsec": 980.0,
}
#: what each stage leaves of the accuracy before it
LEFT = (0.021, 0.16, 0.55)
STAGES = (
    ("rough tracker", ["tracker"], 12, 0.0, 24.5, 15),
    ("bar 300, cup low", ["short tool"], 18, 24.5, 61.0, 17),
    ("bar 250, cup high", ["long tool"], 24, 61.0, 108.0, 18),
)


def sample(*, wanted: bool = True) -> dict[str, Any]:
    """The report's sample with a plan that was searched for; `wanted`: an accuracy was
    asked for, and missed.
    """
    full = report_fixture.sample()
    full["plan"] = plan(wanted=wanted)
    for k, pose in enumerate(full["design"]["poses"]):
        pose["order"] = k % 15
    return full


def plan(*, wanted: bool = True) -> dict[str, Any]:
    """Every field of a plan."""
    left = _accuracy(3)
    value = 1.24 if wanted else 0.00187
    told = {
        "stages": [_stage(k) for k in range(len(STAGES))],
        "cost": 108.0,
        "budget_min": 120.0,
        "price": 40.0,
        "value": value,
        "goal": (
            {
                "z_um": left["z_um"] / 1.24,
                "theta_arcsec": left["theta_arcsec"] / 1.1,
            }
            if wanted
            else {}
        ),
        "reached": not wanted,
        "start_accuracy": START,
        "accuracy": left,
        "best_reachable": {key: 0.97 * v for key, v in left.items()},
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
    }
    return told | {
        "alternatives": _alternatives(value),
        "front": _front(value),
        "compared": _compared(value),
    }


def _accuracy(count: int) -> dict[str, float]:
    """After so many stages; angles gain less."""
    made = dict(START)
    for k in range(count):
        made = {
            n: v * LEFT[k] ** (1.0 - 0.06 * i) for i, (n, v) in enumerate(made.items())
        }
    return made


def _stage(k: int) -> dict[str, Any]:
    name, setups, readings, begin, end, seen = STAGES[k]
    names = report_fixture.LENGTHS + report_fixture.TILTS
    gains = {n: 1.0 + (i * 7 + 3) % 11 * (k + 1) for i, n in enumerate(names)}
    sds = {
        n: {
            "sd": (10.0 if n in report_fixture.TILTS else 1.0) / gains[n],
            "unit": "mrad" if "beta" in n else "mm",
        }
        for n in names
    }
    return {
        "measurement": name,
        "setups": setups,
        "readings": readings,
        "identifies": seen,
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
        "parameters": sds,
        "held": [["da1y", "0.71 db2x - 0.71 db3x", "db1y"], ["db1y"], []][k],
        "accuracy": _accuracy(k + 1),
        "realised": {
            n.rpartition("_")[0]: 0.93 + 0.03 * i + 0.02 * k
            for i, n in enumerate(START)
        },
        "realised_lost": (0.0, 0.81, 0.04)[k],
        "coverage": (0.947, 0.953, 0.949)[k],
    }


def _way(
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
        _way(bars, [24, 24], 84.0, 21.0 * value, why),
        _way(
            ["rough tracker", *bars[::-1]],
            [12, 24, 12],
            106.0,
            1.07 * value,
            "7 % less accurate in the same time",
        ),
        _way(
            ["rough tracker", "length gauge"],
            [24, 48],
            71.0,
            9.1 * value,
            "reaches z only to 45 um",
        ),
    ]


def _front(value: float) -> list[dict[str, Any]]:
    first = [
        _way(["rough tracker"], [n], m, v * value)
        for n, m, v in ((6, 19.0, 60.0), (12, 24.5, 42.0))
    ]
    both = [
        _way(["rough tracker", "bar 300, cup low"], [12, n], m, v * value)
        for n, m, v in ((6, 46.0, 8.2), (12, 53.0, 4.1), (18, 61.0, 2.4))
    ]
    all_three = [name for name, *_ in STAGES]
    return [
        *first,
        *both,
        *[
            _way(all_three, [12, 18, n], m, v * value)
            for n, m, v in ((12, 92.0, 1.3), (24, 108.0, 1.0))
        ],
    ]


def _compared(value: float) -> list[dict[str, Any]]:
    rows = [
        ("RM 5", ["bar 250, cup high"], 61.0, 45.0, 16),
        ("RM 4 → RM 5", [n for n, *_ in STAGES[1:]], 93.0, 6.0, 18),
    ]
    return [
        {
            "name": name,
            "way": _way(names, [24] * len(names), minutes, value * worse),
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
            "plan": _way(
                ["rough tracker", "bar 300, cup low"], [12, 18], minutes, value * 1.4
            ),
            "gain": {n: worse / 1.4 for n in START},
            "bound": 1.3 * value,
            "words": "In the same time a rough stage makes it far more accurate.",
        }
        for name, names, minutes, worse, rank in rows
    ]
