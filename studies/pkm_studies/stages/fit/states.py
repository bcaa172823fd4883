"""States in which a machine is used: as the study states them, else as recorded."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from oed.base import Array
from oed.dataset import ReadingsColumn, temperature_body

if TYPE_CHECKING:
    import pandas as pd


#: beginnings of the names of a machine's own bodies; a bar is none
OWN_BODIES = ("leg", "frame")
#: covariates of which every recorded value is one of use
VALUES = ("direction", "payload")


def recorded_states(covariates: pd.DataFrame | None) -> dict[str, Array]:
    """States of use that readings recorded, by covariate, SI.

    Both directions and all payloads, where several were recorded, and each body of the
    machine as cold and as warm as it was. Empty where nothing is recorded.
    """
    if covariates is None:
        return {}
    states = {}
    for name in map(str, covariates.columns):
        body = temperature_body(name)
        warms = body is not None and body.startswith(OWN_BODIES)
        if not warms and name not in VALUES:
            continue
        values = np.unique(covariates[name].dropna().to_numpy(dtype=float))
        if len(values) > 1:
            states[name] = values[[0, -1]] if warms else values
    return states


def extrapolated_states(
    used: Mapping[str, Array], covariates: pd.DataFrame
) -> list[str]:
    """Sentences on values in use, SI, that lie outside what the readings recorded."""
    sentences = []
    for name, values in used.items():
        if name not in covariates:
            continue
        ends = np.array([covariates[name].min(), covariates[name].max()])
        if not ((values < ends[0]) | (values > ends[1])).any():
            continue
        ((column, shown),) = displayed_states({name: values}).items()
        low, high = displayed_states({name: ends})[column]
        sentences.append(
            f"the prediction is for {column} {' and '.join(f'{v:g}' for v in shown)},"
            f" beyond the readings ({low:g} to {high:g}): what effects do there is"
            " extrapolated"
        )
    return sentences


def displayed_states(states: Mapping[str, Array]) -> dict[str, list[float]]:
    """States by column of the readings file, in its unit."""
    shown = {}
    for name, values in states.items():
        column = ReadingsColumn.of_covariate(name)
        if column is not None:
            shown[column.name] = [float(value) / column.factor for value in values]
    return shown
