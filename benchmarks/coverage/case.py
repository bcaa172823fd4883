"""Cases of the campaigns `coverage` and `ranks`: one virtual machine each."""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # before NumPy is loaded

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.coverage import cell, measure, ranks
from benchmarks.coverage.configurations import configuration

if TYPE_CHECKING:
    import pandas as pd

#: columns of the table that are no ranks
NO_RANKS = ("seed", "error")


def intervals(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Which intervals hold the truth of machine `seed`, see `measure.Outcome`.

    setting  configuration, law of the noise, and stream, the seed of all machines
    """
    bench = configuration(setting["configuration"])
    outcome = measure.one_machine(bench, setting["law"], seed, setting["stream"])
    return outcome.as_json()


def coverage(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """Shares of intervals that hold the truth, of one cell of the table."""
    figures = cell.summarise(cases.to_dict("records"))
    shares = {"combinations": figures.combinations, "bands": figures.bands}
    row: dict[str, Any] = {}
    for name, share in shares.items():
        row |= {f"{name} mean": share.mean, f"{name} half": share.half}
        row |= {f"{name} worst": share.worst, f"{name} lowest": share.lowest}
    return {**row, "nees": figures.nees, "nees half": figures.nees_half}


def truth_ranks(setting: Mapping[str, Any], seed: int) -> dict[str, int]:
    """Rank of each truth of machine `seed` among posterior draws.

    setting  configuration, sampler, and stream, the seed of all machines
    """
    bench = configuration(setting["configuration"])
    return ranks.one_machine(bench, seed, setting["stream"], setting["sampler"])


def calibration(cases: pd.DataFrame, setting: Mapping[str, Any]) -> ranks.Calibration:
    """The test of a combination's ranks; other combinations' quantities are empty."""
    names = [c for c in cases.columns if c not in setting and c not in NO_RANKS]
    own = cases[names].dropna(axis="columns")
    values = own.to_numpy(dtype=np.int64)
    return ranks.calibration([*own.columns], values, setting["stream"])


def uniformity(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """Probability that all ranks are uniform, and their counts in bins."""
    result = calibration(cases, setting)
    row: dict[str, Any] = {"quantities": len(result.names), "joint p": result.joint}
    return row | {f"bin {k + 1}": int(n) for k, n in enumerate(result.counts)}
